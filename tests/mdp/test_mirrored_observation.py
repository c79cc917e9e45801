"""The observation of the mirror image of a scene."""

import pytest
import torch
from torchrl.envs import check_env_specs

from modpush.envs import Scenario
from modpush.mdp import ENTRIES, MirroredObservation, PushObservation
from modpush.recipes import PushEnvConfig, make_push_env
from tests.mdp.test_push_observation import make_state

SYMMETRIC = [name for name, entry in ENTRIES.items() if entry.mirrored is not None]
MIRRORED_KEYS = (
    "object_pose",
    "goal_position",
    "ee_pose",
    "subgoal",
    "subgoal_past",
    "path_ahead",
    "goal_pose",
    "pose_error",
    "subgoal_pose",
    "pose_path_ahead",
)


def mirrored_state(state):
    """The state mirrored at the base frame's x axis; the latent is not asked to follow."""
    state = state.clone()
    for key in MIRRORED_KEYS:
        state[key][..., 1:] *= -1
    state["object_dynamics"] = state["object_dynamics"] * torch.tensor([1.0, 1.0, 1.0, -1.0])
    state["history"] = state["history"] * torch.tensor([1.0, -1.0] * 4 + [-1.0, 1.0])
    state["obstacle_motion"] = state["obstacle_motion"] * torch.tensor([1.0, -1.0, 1.0, -1.0])
    # The object's own directions run the other way round, from its own x axis on.
    state["object_support"] = state["object_support"].flip(-1).roll(1, -1)
    state["last_action"] = state["last_action"] * torch.tensor([1.0, -1.0, -1.0])
    return state.set("mirrored_latent", state["latent"])


def mirrored_scenario(scenario):
    """The scenario mirrored at the base frame's x axis, in which the workspace is symmetric."""
    data = scenario.to_dict()
    for part, name in (
        (data, "object_pose"),
        (data, "tool_pose"),
        *((o, "pose") for o in data["obstacles"]),
    ):
        x, y, yaw = part[name]
        part[name] = (x, -y, -yaw)
    x, y = data["goal_position"]
    return Scenario.from_dict({**data, "goal_position": (x, -y)})


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("frame", ["base", "object", "path"])
def test_each_entry_is_what_is_read_in_the_mirrored_state(frame, raw):
    state = make_state(batch=64)
    state["object_pose"] *= 0.5  # into the workspace
    state["object_pose"][:, 0] += 0.475
    plain = PushObservation(frame, entries=SYMMETRIC, raw=raw)
    mirrored = MirroredObservation(frame, entries=SYMMETRIC, raw=raw)
    expected = plain(mirrored_state(state))["observation"]
    found = mirrored(state.set("mirrored_latent", state["latent"]))["mirrored_observation"]
    for name, columns in plain.columns.items():
        torch.testing.assert_close(
            found[:, columns], expected[:, columns], atol=2e-4, rtol=1e-4, msg=name
        )
    assert not torch.allclose(found, plain(state)["observation"])


def test_an_entry_that_cannot_be_mirrored_is_named():
    with pytest.raises(ValueError, match="'joint_position' cannot be mirrored"):
        MirroredObservation("path")
    with pytest.raises(ValueError, match="mirrored: Input should be a valid tuple"):
        type(ENTRIES["goal"])(ENTRIES["goal"].read, mirrored=3)


@pytest.mark.parametrize("encoder", ["vae", "rays"])
def test_in_the_simulator_it_is_the_observation_of_the_mirrored_scene(encoder):
    config = PushEnvConfig.preset(
        "cpu",
        num_envs=4,
        encoder=encoder,
        add=("object_support",),
        path_ahead=(0.1, 0.3),
    )
    env = make_push_env(config, mirrored=True, seed=3)
    check_env_specs(env)
    env.reset()
    scenarios = env.scenarios
    there = env.reset(scenarios=scenarios)
    mirror = env.reset(scenarios=[mirrored_scenario(scenario) for scenario in scenarios])
    env.close()
    torch.testing.assert_close(
        there["mirrored_observation"], mirror["observation"], atol=1e-3, rtol=0
    )
    torch.testing.assert_close(
        mirror["mirrored_observation"], there["observation"], atol=1e-3, rtol=0
    )
    assert (there["observation"] - mirror["observation"]).abs().amax() > 0.1
