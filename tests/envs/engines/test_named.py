"""The choice of an engine, and what belongs to it."""

import functools
import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from modpush import PushEnvConfig, load_agent, make_push_env
from modpush._extras import MissingExtraError
from modpush.envs import PushEnv
from modpush.envs.engines.base import ENGINES, find_engine
from modpush.envs.engines.mujoco.engine import MujocoEngine
from modpush.envs.engines.sapien.engine import SapienEngine
from modpush.envs.push_state import PushState
from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.set_fields import set_fields
from modpush.envs.simulation_config import SimulationConfig
from modpush.evaluation import load_set, run_episodes
from modpush.recipes import environment_fingerprint
from modpush.recipes.fingerprint import fingerprint_differences
from modpush.viewer import PlayConfig

OWN = "modpush.envs.engines.mujoco.engine:MujocoEngine"


@pytest.fixture(scope="module")
def env():
    env = PushEnv(2, engine="mujoco", scene="slot", seed=3)
    yield env
    env.close()


def rollout(env: PushEnv, steps: int = 10) -> torch.Tensor:
    generator, td, poses = torch.Generator().manual_seed(0), env.reset(seed=7), []
    for _ in range(steps):
        td["action"] = torch.rand(*env.batch_size, 3, generator=generator) * 2 - 1
        td = env.step(td)["next"]
        poses.append(torch.cat([td["object_pose"], td["ee_pose"]], -1))
    return torch.stack(poses)


def test_the_shipped_engines_have_the_rates_that_are_said_of_them() -> None:
    for name, engine in (("sapien", SapienEngine), ("mujoco", MujocoEngine)):
        assert (engine.name, engine.default_sim_freq) == (name, ENGINES[name].sim_freq)
    assert (ENGINES["sapien"].sim_freq, ENGINES["mujoco"].sim_freq) == (120, 480)


def test_a_rate_is_the_engine_s_own_unless_one_is_given(env) -> None:
    assert SimulationConfig().sim_freq is None
    assert env.simulation.sim_freq == 480
    authors = SimulationConfig(sim_freq=240)
    (changed,) = set_fields("test", {"engine": "mujoco"}, authors)
    assert changed.sim_freq is None
    (changed,) = set_fields("test", {"engine": "mujoco", "sim_freq": 960}, authors)
    assert changed.sim_freq == 960
    (changed,) = set_fields("test", {"engine": "sapien"}, authors)
    assert changed.sim_freq == 240


def test_an_environment_in_mujoco_keeps_torchrl_s_contract(env) -> None:
    check_env_specs(env, check_dtype=True)
    assert env.engine_name == "mujoco"


def test_an_episode_is_the_same_in_every_batch_and_again(env) -> None:
    first, again = rollout(env), rollout(env)
    torch.testing.assert_close(first, again, rtol=0, atol=0)
    alone = PushEnv(1, engine="mujoco", scene="slot")
    torch.testing.assert_close(rollout(alone)[0, 0, :3], first[0, 0, :3], rtol=0, atol=1e-3)
    alone.close()


def test_a_state_continues_as_the_run_that_was_not_interrupted(env) -> None:
    generator, td = torch.Generator().manual_seed(1), env.reset(seed=2)
    for _ in range(5):
        td["action"] = torch.rand(2, 3, generator=generator) * 2 - 1
        td = env.step(td)["next"]
    state = PushState.from_dict(json.loads(json.dumps(env.get_state().to_dict())))
    actions, ends = torch.rand(10, 2, 3, generator=generator) * 2 - 1, []
    for restored in (False, True):
        if restored:
            td = env.reset(state=state)
        for action in actions:
            td["action"] = action
            td = env.step(td)["next"]
        ends.append([scene.physics for scene in env.get_state().scenes])
    np.testing.assert_array_equal(*ends)


def test_a_state_of_another_engine_is_refused(env) -> None:
    other = PushEnv(2, scene="slot", seed=3)
    other.reset()
    env.reset()
    with pytest.raises(ValueError, match=r"environment with engine='sapien .*expected 'mujoco"):
        env.set_state(other.get_state())
    with pytest.raises(ValueError, match=r"environment with engine='mujoco .*expected 'sapien"):
        other.set_state(env.get_state())
    other.close()


def test_sapien_is_not_imported_for_mujoco() -> None:
    code = (
        "import sys; from modpush import make_push_env\n"
        "env = make_push_env(engine='mujoco', num_envs=1, encoder='none')\n"
        "env.rollout(2); assert not {'sapien', 'mani_skill'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_missing_package_is_named_before_any_work(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "mujoco" else find(name)
    )
    message = (
        r"PushEnv: engine 'mujoco': mujoco not installed; get it with pip install "
        r"'modpush\[mujoco\]'\."
    )
    with pytest.raises(MissingExtraError, match=message):
        PushEnv(1, engine="mujoco")
    with pytest.raises(MissingExtraError, match=message):
        load_agent("small_cube").make_env(1, engine="mujoco")


@pytest.mark.parametrize("wrong", ["bullet", "mujoko", "", 3, None])
def test_an_unknown_engine_is_refused_with_the_known_ones(wrong) -> None:
    known = r"engine must be one of \['mujoco', 'sapien'\] or 'module:name'"
    with pytest.raises(ValueError, match=rf"SimulationConfig: {known}.*got {wrong!r}"):
        PushEnv(1, engine=wrong)
    if wrong is not None:
        with pytest.raises(ValueError, match=r"PlayConfig|EpisodeConditions"):
            PlayConfig(engine=wrong)
    with pytest.raises(ValueError, match="engine"):
        EpisodeConditions(engine=wrong)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sim_freq": 120}, "sim_freq must be at least 240 in MuJoCo.*got 120"),
        ({"control_freq": 7}, "sim_freq must be a multiple of control_freq, got 480 and 7"),
        (
            {"depth": "sapien"},
            r"depth='sapien' is rendered in .* 'sapien' .*got engine=\['mujoco'\]",
        ),
        ({"engine": "modpush.envs:OBJECTS"}, "engine must be an Engine's class or a function"),
        ({"engine": "modpush.envs:nothing"}, "has no attribute 'nothing'"),
        ({"engine": lambda spec: MujocoEngine(spec)}, "sim_freq must be given with the engine"),
    ],
)
def test_what_mujoco_cannot_do_is_said(options, message) -> None:
    with pytest.raises(ValueError, match=message):
        PushEnv(1, **{"engine": "mujoco", **options})


@pytest.mark.parametrize(
    "engine",
    [OWN, MujocoEngine, functools.partial(MujocoEngine)],
    ids=["name", "class", "function"],
)
def test_an_engine_of_your_own_is_used(engine) -> None:
    rate = {} if engine is OWN or engine is MujocoEngine else {"sim_freq": 480}
    env = PushEnv(1, engine=engine, depth=None, **rate)
    env.rollout(2)
    assert (env.engine_name, env.simulation.sim_freq) == ("mujoco", 480)
    env.close()


def test_a_class_that_is_an_engine_is_found_by_name() -> None:
    assert find_engine("mujoco") is MujocoEngine
    assert find_engine(MujocoEngine) is MujocoEngine


@pytest.mark.parametrize("options", [{"tool": "rod"}, {"dynamic_obstacles": True}, {}])
def test_all_that_an_environment_can_be_works_in_mujoco(options) -> None:
    env = PushEnv(
        2,
        engine="mujoco",
        scene=("posts", "bar_across"),
        pushed_object=("fragment", "small_cylinder", "random_2", "random_5"),
        randomize_dynamics=True,
        arm_in_depth=True,
        seed=0,
        **options,
    )
    for _ in range(3):
        td = env.rollout(8, break_when_any_done=False)
        assert td["next", "object_pose"].isfinite().all()
        assert (td["next", "segmentation"] == 1).any()
    picture = env.render()
    assert picture.ndim == 3
    env.close()


def test_a_fingerprint_tells_the_engine_and_lets_an_agent_change_it() -> None:
    agent = load_agent("any_object")
    env = agent.make_env(1, engine="mujoco", scene="free")
    now = environment_fingerprint(env)
    assert env.simulation.sim_freq == 480
    assert now["engine"] == "mujoco"
    assert fingerprint_differences({**now, "engine": "sapien"}, now) == []
    env.rollout(3, agent.policy)
    env.close()


@pytest.mark.parametrize("name", ["obstacles/small_cylinder", "obstacles/fragment"])
def test_the_shipped_agent_pushes_as_well_in_mujoco(name) -> None:
    """With MuJoCo's own cylinder it would solve 7 of 10 of the cylinder's episodes."""
    agent, episodes = (
        load_agent("any_object"),
        load_set(name).first(16).with_conditions(engine="mujoco"),
    )
    options = episodes.conditions.agent_options(agent.config.inflation)
    env = agent.make_env(8, pushed_object=episodes.objects, **options)
    found = list(run_episodes(env, agent.policy, enumerate(episodes)))
    assert sum(episode.metrics.success for episode in found) >= 15
    assert np.mean([episode.metrics.contact_rate for episode in found]) > 0.93
    env.close()


def test_a_set_in_another_engine_has_its_own_name_and_rate(tmp_path) -> None:
    smoke = load_set("smoke")
    assert "engine" not in smoke.conditions.to_dict()
    assert smoke.with_conditions(engine="sapien") is smoke
    other = smoke.with_conditions(engine="mujoco")
    assert other.name == "smoke+mujoco"
    assert (other.conditions.engine, other.conditions.sim_freq) == ("mujoco", None)
    assert smoke.with_conditions(engine=OWN).name == "smoke+MujocoEngine"
    other.save(tmp_path / "set.json.gz")
    assert load_set(tmp_path / "set.json.gz") == other
    own = smoke.with_conditions(engine="evil_module:thing")
    own.save(tmp_path / "own.json.gz")
    with pytest.raises(ValueError, match="evil_module"):
        load_set(tmp_path / "own.json.gz")


def test_a_config_with_an_engine_makes_a_stack_in_it() -> None:
    config = PushEnvConfig.preset("authors", engine="mujoco", encoder="none")
    assert config.simulation.engine == "mujoco"
    env = make_push_env(PushEnvConfig.preset("cpu", engine="mujoco", num_envs=1))
    assert env.engine_name == "mujoco"
    env.close()
