"""Numbers that no rewriting may change: environments, TQC's losses, shipped agents and their files.

`python -m tests.test_golden` writes `tests/golden.json` anew, after a change that is meant to alter them.
Processors round differently, so that physics is compared to 1e-3 and an evaluation may differ in 2 of
its 120 episodes.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded

from modpush import PushEnvConfig, evaluate, load_agent, make_push_env
from modpush.agents import TQCConfig
from modpush.agents.tqc.build import make_tqc_from_specs
from modpush.evaluation import EvaluationConfig, load_set

FILE = Path(__file__).with_name("golden.json")
PRESETS = ("paper", "authors", "cpu")
AGENTS = {"small_cube": "obstacles/small_cube", "any_object": "obstacles/fragment"}
EPISODES = 120


def environment(preset: str) -> dict[str, list[float]]:
    """Final poses, and means over 50 steps, of two scenes in which the tool runs into the object."""
    config = replace(PushEnvConfig.preset(preset), num_envs=2, scene=("slot", "bar_across"))
    env = make_push_env(config, seed=3)
    generator = torch.Generator().manual_seed(5)

    def act(td: TensorDict) -> TensorDict:
        dx, dy = (td["object_pose"] - td["ee_pose"])[:, :2].unbind(1)
        towards = torch.atan2(dy, dx)
        if config.action_frame is None:  # in the axes of the path
            dx, dy = (td["subgoal"] - td["object_pose"][:, :2]).unbind(1)
            towards = towards - torch.atan2(dy, dx)
        ahead = torch.stack([towards.cos(), towards.sin(), torch.zeros(2)], 1)
        noise = 0.4 * torch.randn(2, 3, generator=generator)
        return td.set("action", (ahead + noise).clamp(-1, 1))

    steps = env.rollout(50, act, break_when_any_done=False)["next"]
    env.close()
    numbers = {key: steps[key][:, -1].flatten() for key in ("object_pose", "ee_pose")}
    for key in ("observation", "reward", "path_length", "joint_position", "latent"):
        numbers[f"mean {key}"] = steps[key].double().mean(1).flatten(1).mean(1)
    for key in ("object_contact", "obstacle_contact", "success", "out_of_bounds", "done"):
        numbers[f"steps with {key}"] = steps[key].sum(1).flatten()
    return {key: value.tolist() for key, value in numbers.items()}


def losses() -> dict[str, float]:
    """Losses of TQC in the paper's sizes before its first update, and of its critics after five."""
    torch.manual_seed(0)
    agent = make_tqc_from_specs(
        TQCConfig(batch_size=64),
        Composite(observation=Unbounded((49,))),
        Bounded(-1.0, 1.0, (3,)),
    )
    batch = TensorDict(
        {
            "observation": torch.randn(64, 49),
            "action": torch.rand(64, 3) * 2 - 1,
            "next": {
                "observation": torch.randn(64, 49),
                "reward": -torch.rand(64, 1),
                "done": torch.arange(64).view(64, 1) % 8 == 0,
                "terminated": torch.arange(64).view(64, 1) % 16 == 0,
            },
        },
        batch_size=[64],
    )
    first = {key: value.item() for key, value in agent.loss(batch).items() if "loss" in key}
    for _ in range(5):
        last = agent.update(batch)
    return {**first, "loss_qvalue after 5 updates": last["loss_qvalue"].item()}


def shipped_agent(name: str) -> dict[str, list[float]]:
    """Actions of a shipped policy for fixed observations."""
    agent = load_agent(name)
    size = next(iter(agent.actor.parameters())).shape[-1]
    observation = torch.linspace(-1.0, 1.0, 3 * size).view(3, size)
    with torch.no_grad():
        action = agent.actor(TensorDict(observation=observation, batch_size=[3]))["loc"]
    return {"loc": action.flatten().tolist()}


def episodes(name: str, folder: Path, count: int = EPISODES) -> dict[str, list[Any]]:
    """Success and number of steps of every eighth episode of a set of clutter."""
    whole = load_set(AGENTS[name])
    part = replace(whole, name=f"golden_{name}", scenarios=whole.scenarios[::8][:count])
    rows = evaluate(load_agent(name), part, folder, config=EvaluationConfig(progress=False))
    return {"success": rows["success"].tolist(), "steps": rows["steps"].tolist()}


def golden(kind: str, name: str) -> dict[str, Any]:
    numbers: dict[str, Any] = json.loads(FILE.read_text("utf-8"))[kind][name]
    return numbers


@pytest.mark.parametrize("preset", PRESETS)
def test_the_environments_of_the_presets(preset: str) -> None:
    new, old = environment(preset), golden("environment", preset)
    assert new.keys() == old.keys()
    for key, numbers in old.items():
        assert new[key] == pytest.approx(numbers, abs=1e-3), key


def test_the_losses_of_tqc() -> None:
    assert losses() == pytest.approx(golden("losses", "paper"), rel=1e-4)


@pytest.mark.parametrize("name", AGENTS)
def test_the_policies_of_the_shipped_files(name: str) -> None:
    assert shipped_agent(name)["loc"] == pytest.approx(golden("agent", name)["loc"], abs=1e-4)


@pytest.mark.parametrize(
    ("count", "differing", "longer"),
    [(24, 1, 0.05), pytest.param(EPISODES, 2, 0.02, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("name", AGENTS)
def test_the_episodes_of_the_shipped_agents(
    name: str, count: int, differing: int, longer: float, tmp_path: Path
) -> None:
    new, old = episodes(name, tmp_path, count), golden("episodes", name)
    pairs = zip(new["success"], old["success"][:count], strict=True)
    assert sum(a != b for a, b in pairs) <= differing
    assert sum(new["steps"]) == pytest.approx(sum(old["steps"][:count]), rel=longer)


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        numbers = {
            "environment": {preset: environment(preset) for preset in PRESETS},
            "losses": {"paper": losses()},
            "agent": {name: shipped_agent(name) for name in AGENTS},
            "episodes": {name: episodes(name, Path(folder) / name) for name in AGENTS},
        }
    FILE.write_text(json.dumps(numbers) + "\n", "utf-8")
