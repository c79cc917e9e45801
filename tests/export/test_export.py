"""Exported graphs give the agent's actions on recorded episodes."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import (
    Compose,
    EnvBase,
    ExplorationType,
    InitTracker,
    TransformedEnv,
    set_exploration_type,
)
from torchrl.envs.utils import step_mdp

from modpush.agents import ScriptedPusher, TQCConfig, make_tqc
from modpush.deploy import Limits
from modpush.encoders import EgocentricWindow
from modpush.envs import PushEnv
from modpush.export import export_agent
from modpush.mdp import ActionFrame
from modpush.planners import OccupancyGrid, PlannerSubgoals
from modpush.recipes import (
    PushEnvConfig,
    environment_fingerprint,
    load_agent,
    make_push_env,
    save_agent,
)


@pytest.fixture(scope="module")
def agent():
    return load_agent("any_object")


@pytest.fixture(scope="module")
def folder(agent, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    written = export_agent(agent, folder, ("onnx", "torch_export"))
    graphs = [f"{name}{end}" for name in ("policy", "window_policy") for end in (".onnx", ".pt2")]
    assert sorted(written) == sorted([*graphs, "card.json"])
    return folder


@pytest.fixture(scope="module")
def recorded(agent) -> TensorDict:
    """Three episodes' first 60 steps, with windows."""
    objects = ("small_cube", "fragment", "small_cylinder")
    env = agent.make_env(
        3, scene=("slot", "posts"), pushed_object=objects, keep_images=True, seed=5
    )
    steps = env.rollout(60, agent.actor, break_when_any_done=False).reshape(-1)
    env.close()
    return steps


def run_onnx(path: Path, data: TensorDict) -> list[np.ndarray]:
    session = onnxruntime.InferenceSession(path)
    return session.run(None, {i.name: data[i.name].numpy() for i in session.get_inputs()})


def commands(agent, data: TensorDict) -> torch.Tensor:
    """What the agent's own `ActionFrame` makes of its actions."""
    return ActionFrame(agent.config.frame).inv(data.clone())["action"]


def test_onnx_gives_the_agent_s_actions(agent, folder: Path, recorded: TensorDict) -> None:
    (alone,) = run_onnx(folder / "policy.onnx", recorded)
    action, command = run_onnx(folder / "window_policy.onnx", recorded)
    np.testing.assert_allclose(alone, recorded["action"], atol=1e-5)
    np.testing.assert_allclose(action, recorded["action"], atol=1e-5)
    np.testing.assert_allclose(command, commands(agent, recorded), atol=1e-5)
    print(f"onnx against eager: {np.abs(action - recorded['action'].numpy()).max():.2e}")


def test_torch_export_gives_the_agent_s_actions(folder: Path, recorded: TensorDict) -> None:
    card = json.loads((folder / "card.json").read_text())
    for name in ("policy", "window_policy"):
        graph = torch.export.load(folder / f"{name}.pt2").module()
        inputs = [recorded[entry["name"]] for entry in card["graphs"][name]["inputs"]]
        found = graph(*inputs)
        action = found[0] if isinstance(found, tuple) else found
        torch.testing.assert_close(action, recorded["action"], atol=1e-5, rtol=0)


def test_the_card_says_what_goes_in_and_comes_out(
    agent, folder: Path, recorded: TensorDict
) -> None:
    card = json.loads((folder / "card.json").read_text())
    for name in ("policy", "window_policy"):
        session = onnxruntime.InferenceSession(folder / f"{name}.onnx")
        described = card["graphs"][name]
        assert [i.name for i in session.get_inputs()] == [i["name"] for i in described["inputs"]]
        assert [o.name for o in session.get_outputs()] == [o["name"] for o in described["outputs"]]
        for entry, value in zip(described["inputs"], session.get_inputs(), strict=True):
            assert value.shape == entry["shape"]
            assert list(recorded[entry["name"]].shape[1:]) == entry["shape"][1:]
    last = card["observation"]["entries"][-1]
    assert last["columns"][1] == recorded["observation"].shape[-1]
    assert card["action"]["frame"] == agent.config.frame
    assert card["window"]["size"] == recorded["window"].shape[-1]


def env_of_card(card: dict, num_envs: int, scene: str) -> EnvBase:
    """`PushEnv` with what the card says of planner, sub-goals and window, and no network."""
    planning, window = card["planning"], dict(card["window"])
    settings = {n: window[n] for n in ("size", "outside", "metres_per_pixel")}
    grid = OccupancyGrid(
        **{k: v for k, v in planning["occupancy"].items() if k != "meaning"},
        object_radius_key="object_radius",
        inscribed_radius_key="object_inscribed_radius",
    )
    subgoals = PlannerSubgoals(**planning["subgoals"])
    transforms = InitTracker(), grid, subgoals, EgocentricWindow(window["frame"], **settings)
    pushed = card["environment"]["scenario"]["pushed_object"]
    env = PushEnv(num_envs, scene=scene, pushed_object=pushed, seed=0)
    return TransformedEnv(env, Compose(*transforms))


def test_a_robot_without_torch_in_its_policy_pushes(folder: Path) -> None:
    session = onnxruntime.InferenceSession(folder / "window_policy.onnx")
    names = [entry.name for entry in session.get_inputs()]
    env = env_of_card(json.loads((folder / "card.json").read_text()), 2, "free")
    state, solved = env.reset(), np.zeros((2, 1), dtype=bool)
    for _ in range(200):
        _, command = session.run(None, {name: state[name].numpy() for name in names})
        command[solved[:, 0]] = 0.0
        stepped = env.step(state.set("action", torch.from_numpy(command)))
        solved |= stepped["next", "success"].numpy()
        state = step_mdp(stepped)
        if solved.all():
            break
    env.close()
    assert solved.all()


def test_the_card_says_how_to_plan(agent, folder: Path) -> None:
    card = json.loads((folder / "card.json").read_text())
    ours = env_of_card(card, 6, "bar_along")
    theirs = agent.make_env(6, scene="bar_along", keep_images=True, seed=0)
    one, other = ours.reset(), theirs.reset()
    for key in ("occupancy", "path_length", "subgoal", "subgoal_past", "window"):
        assert torch.equal(one[key], other[key]), key
    ours.close()
    theirs.close()


def test_the_card_says_how_the_tool_moves(agent, folder: Path) -> None:
    control = json.loads((folder / "card.json").read_text())["control"]
    assert control["rate"] == 15
    assert control["tip_height"]["small_cube"] == 0.02
    assert control["tool"] == {
        "name": "2f85",
        "length": 0.163,
        "tip_half_extents": [0.032, 0.011],
        "mass": 0.9,
    }
    assert len(control["robot"]["joint_limits"]) == 6
    # 2 cm along x and along y, 15 times a second.
    assert control["limits"]["speed"] == pytest.approx(0.02 * 2**0.5 * 15)
    assert control["limits"]["turn_speed"] == pytest.approx(0.75)
    guard = Limits()
    for name in ("speed", "turn_speed", "acceleration"):
        assert control["limits"][name] < getattr(guard, name) < 1.1 * control["limits"][name]
    assert (control["limits"]["low"], control["limits"]["high"]) == ([*guard.low], [*guard.high])


def test_the_card_says_what_every_input_means(folder: Path) -> None:
    card = json.loads((folder / "card.json").read_text())
    assert all(i["meaning"] for graph in card["graphs"].values() for i in graph["inputs"])
    assert {card["window"]["frame"], card["action"]["frame"], "base"} <= set(card["frames"])


def test_the_card_says_how_the_agent_recovers(agent, folder: Path, tmp_path: Path) -> None:
    recovery = json.loads((folder / "card.json").read_text())["recovery"]
    assert recovery.pop("meaning")
    assert recovery == {"patience": 4, "duration": 4, "tolerance": 0.01}
    without = replace(agent, config=replace(agent.config, recovery=False))
    export_agent(without, tmp_path, ("torch_export",))
    assert json.loads((tmp_path / "card.json").read_text())["recovery"] is None


def test_what_cannot_be_exported_is_refused(agent, tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"formats\[0\]: Input should be 'onnx' or .*, got 'tflite'"
    ):
        export_agent(agent, tmp_path, ("tflite",))
    blind = replace(agent, actor=agent.actor[0])
    with pytest.raises(
        ValueError, match=r"policy: .*instance of ProbabilisticActor, got TensorDictModule"
    ):
        export_agent(blind, tmp_path)


def test_a_mirrored_observation_is_for_training_alone(tmp_path: Path) -> None:
    agent = load_agent("small_cube", make_env=partial(make_push_env, mirrored=True))
    export_agent(agent, tmp_path, ("torch_export",))
    env = agent.make_env(3, keep_images=True, seed=0)
    steps = env.rollout(4, agent.actor).reshape(-1)
    env.close()
    graph = torch.export.load(tmp_path / "window_policy.pt2").module()
    card = json.loads((tmp_path / "card.json").read_text())
    inputs = [steps[entry["name"]] for entry in card["graphs"]["window_policy"]["inputs"]]
    torch.testing.assert_close(graph(*inputs)[0], steps["action"], atol=1e-5, rtol=0)


def test_an_agent_s_memory_is_an_input_of_the_graph(tmp_path: Path) -> None:
    config = PushEnvConfig.preset("cpu", num_envs=2, encoder="none", scene="free", add=("history",))
    env = make_push_env(config, seed=0)
    actor = make_tqc(TQCConfig(hidden_sizes=(16,)), env).actor
    save_agent(
        tmp_path / "agent.safetensors",
        actor,
        config,
        hidden_sizes=(16,),
        observation_dim=env.observation_spec["observation"].shape[-1],
        fingerprint=environment_fingerprint(env),
    )
    env.close()
    agent = load_agent(tmp_path / "agent.safetensors")
    export_agent(agent, tmp_path / "exported")
    env = agent.make_env(2, seed=0)
    pusher = ScriptedPusher(target_key="subgoal")
    td, seen = env.reset(), []
    for _ in range(25):
        pushed = pusher(td.clone())
        turned = ActionFrame(config.frame).to_agent(pushed)
        seen.append(agent.actor(td.clone()))
        td = step_mdp(env.step(turned))
    env.close()
    recorded = torch.stack(seen).reshape(-1)
    assert recorded["history"].any()
    action, _ = run_onnx(tmp_path / "exported" / "window_policy.onnx", recorded)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        expected = agent.actor(recorded.clone())["action"]
    np.testing.assert_allclose(action, expected, atol=1e-5)
    without = recorded.clone().set("history", torch.zeros_like(recorded["history"]))
    other, _ = run_onnx(tmp_path / "exported" / "window_policy.onnx", without)
    assert np.abs(action - other).max() > 1e-3
    card = json.loads((tmp_path / "exported" / "card.json").read_text())
    inputs = {i["name"]: i for i in card["graphs"]["window_policy"]["inputs"]}
    assert inputs["history"]["shape"] == ["batch", 8, 10]
    assert "newest first" in inputs["history"]["meaning"]
