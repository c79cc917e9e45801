from torchrl.collectors import Collector

from modpush.agents import TQCConfig, make_tqc
from modpush.recipes import PushEnvConfig, make_push_env
from modpush.replay import TRANSITION_KEYS, KeepTransition, ReplayConfig, make_replay_buffer


def nbytes(data) -> float:
    return sum(t.numel() * t.element_size() for t in data.values(True, True)) / data.numel()


def test_a_collector_s_transition_shrinks_and_a_learner_still_learns_from_it() -> None:
    config = PushEnvConfig.preset("cpu", num_envs=2, scene=("free",))
    env = make_push_env(config, seed=0)
    agent = make_tqc(TQCConfig(hidden_sizes=(8,), batch_size=8), env)
    options = {"frames_per_batch": 16, "total_frames": 16}
    (everything,) = Collector(env, agent.exploration_policy, **options)
    env = make_push_env(config, seed=0)
    (kept,) = Collector(env, agent.exploration_policy, **options, postproc=KeepTransition())
    assert set(kept.keys(True, True)) == set(TRANSITION_KEYS)
    before, after = nbytes(everything), nbytes(kept)
    print(f"bytes of a transition: {before:.0f} -> {after:.0f}")
    assert before > 17_000
    assert after < 500
    buffer = make_replay_buffer(ReplayConfig(batch_size=8, sampler="uniform", capacity=100))
    buffer.extend(kept.reshape(-1))
    losses = agent.update(buffer.sample())
    assert all(loss.isfinite().all() for loss in losses.values())
