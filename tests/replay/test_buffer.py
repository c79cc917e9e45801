import subprocess
import sys

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, PrioritizedSampler, RandomSampler

from modpush.replay import AttentiveSampler, CompactStorage, ReplayConfig, make_replay_buffer

SMALL = {"capacity": 100, "batch_size": 8}


def trajectory(steps: int) -> TensorDict:
    observation = torch.randn(steps + 1, 5)
    done = torch.zeros(steps, 1, dtype=torch.bool)
    after = {"observation": observation[1:], "reward": torch.ones(steps, 1)}
    after |= {"done": done, "terminated": done, "truncated": done}
    return TensorDict({"observation": observation[:-1], "next": after}, batch_size=[steps])


@pytest.mark.parametrize(
    ("storage", "cls"),
    [("tensor", LazyTensorStorage), ("memmap", LazyMemmapStorage), ("compact", CompactStorage)],
)
@pytest.mark.parametrize(
    ("sampler", "sampler_cls"), [("attentive", AttentiveSampler), ("uniform", RandomSampler)]
)
def test_every_combination_samples(storage, cls, sampler, sampler_cls):
    buffer = make_replay_buffer(ReplayConfig(**SMALL, storage=storage, sampler=sampler))
    assert type(buffer.storage) is cls
    assert type(buffer.sampler) is sampler_cls
    buffer.extend(trajectory(60))
    sample = buffer.sample()
    assert sample["next", "observation"].shape == (8, 5)
    assert ("similarity" in sample) == (sampler == "attentive")


def test_the_sampler_takes_its_settings_from_the_config():
    config = ReplayConfig(
        **SMALL, k=3, k_end=1, k_annealing_samples=7, similarity="negative_l2", num_queries=2
    )
    sampler = make_replay_buffer(config).sampler
    assert (sampler.k, sampler.k_end, sampler.annealing_num_samples) == (3, 1, 7)
    assert (sampler.similarity.__name__, sampler.num_queries) == ("negative_l2", 2)


@pytest.mark.parametrize("storage", ["tensor", "compact"])
def test_n_step_rewards(storage):
    config = ReplayConfig(**SMALL, sampler="uniform", storage=storage, n_steps=3, gamma=0.5)
    buffer = make_replay_buffer(config)
    for part in trajectory(60).split(20):
        buffer.extend(part)
    sample = buffer.sample()
    torch.testing.assert_close(sample["next", "reward"], torch.full((8, 1), 1 + 0.5 + 0.25))
    assert (sample["steps_to_next_obs"] == 3).all()


def extension_loads() -> bool:
    try:
        PrioritizedSampler(8, alpha=0.6, beta=0.4)
    except RuntimeError:
        return False
    return True


@pytest.mark.skipif(not extension_loads(), reason="TorchRL's C++ extension does not load")
def test_prioritized_samples_carry_their_weights():
    buffer = make_replay_buffer(ReplayConfig(**SMALL, sampler="prioritized"))
    buffer.extend(trajectory(60))
    assert "priority_weight" in buffer.sample()


def test_prioritized_without_its_extension_says_what_to_do(monkeypatch):
    def refuse(*args, **kwargs):
        raise RuntimeError("SumSegmentTreeFp32 is not available")

    monkeypatch.setattr("modpush.replay.buffer.PrioritizedSampler", refuse)
    message = r"needs TorchRL's C\+\+ extension, .* \(SumSegmentTreeFp32 is not available\)"
    with pytest.raises(RuntimeError, match=message):
        make_replay_buffer(ReplayConfig(**SMALL, sampler="prioritized"))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"k": 0}, "ReplayConfig: k must be >= 1, got 0."),
        ({"n_steps": 0}, "n_steps must be >= 1, got 0."),
        ({"prefetch": -1}, "prefetch must be >= 0, got -1."),
        ({"sampler": "best"}, r"sampler must be one of \('attentive', .*, got 'best'."),
        ({"storage": "disk"}, r"storage must be one of \('tensor', .*, got 'disk'."),
        ({"similarity": "dot"}, r"similarity must be one of \('cosine', .*, got 'dot'."),
        (
            {"capacity": 100, "batch_size": 26},
            r"k \* batch_size must be <= capacity, got 104 > 100.",
        ),
    ],
)
def test_bad_configs(kwargs, message):
    with pytest.raises(ValueError, match=message):
        ReplayConfig(**kwargs)


def test_learner_imports_without_simulators():
    """`agents` and `replay` know neither `envs` nor what lies below it."""
    program = (
        "import sys; import modpush.agents, modpush.replay; "
        "print([m for m in sys.modules if m.split('.')[0] in ('sapien', 'mani_skill') "
        "or m.startswith('modpush.envs')])"
    )
    output = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout
    assert output.strip() == "[]"
