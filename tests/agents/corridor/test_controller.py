"""The corridor controller: episodes in a kinematic world, its state, keys and inputs."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, InitTracker, TransformedEnv, check_env_specs

from modpush.agents import CorridorConfig, PushingCorridorController, faithful_config
from tests.agents.point_pusher import PointPusher

GAP = [(0.44, 0.50, -0.40, -0.06), (0.44, 0.50, 0.06, 0.40)]


def run(world, controller, steps=200):
    """Push until done; returns success by scene and the last tensordict."""
    state, success = None, torch.zeros(len(world.object), dtype=torch.bool)
    for _ in range(steps):
        tensordict = world.observe()
        if state is not None:
            tensordict["corridor"] = state
        tensordict = controller(tensordict)
        state = tensordict["next", "corridor"]
        action = torch.where(success[:, None], 0.0, tensordict["action"])
        assert action.abs().max() <= 1
        world.step(action)
        success |= world.reached()
        if success.all():
            break
    return success, tensordict


def random_world(count, seed, boxes=()):
    generator = torch.Generator().manual_seed(seed)
    y = torch.rand(count, 2, generator=generator) * 0.3 - 0.15
    start = torch.stack([torch.full((count,), 0.34), y[:, 0]], -1)
    goal = torch.stack([torch.full((count,), 0.62), y[:, 1]], -1)
    angle = torch.rand(count, generator=generator) * 2 * math.pi
    tool = start + 0.1 * torch.stack([angle.cos(), angle.sin()], -1)
    return PointPusher(start, goal, tool, boxes)


@pytest.mark.parametrize(("config", "scenes"), [(CorridorConfig(), 6), (faithful_config(), 2)])
def test_pushes_a_disc_to_its_goal_in_free_space(config, scenes):
    success, _ = run(random_world(scenes, 0), PushingCorridorController(config))
    assert success.all()


def test_pushes_a_disc_through_a_gap():
    world = random_world(4, 1, GAP)
    success, tensordict = run(world, PushingCorridorController())
    assert success.float().mean() >= 0.75
    path = tensordict["next", "corridor", "path"]
    crossing = (path[..., 0] > 0.44) & (path[..., 0] < 0.50)
    assert path[crossing][:, 1].abs().max() < 0.06


def test_learns_only_from_straighter_pushes():
    world = random_world(4, 2)
    _, tensordict = run(world, PushingCorridorController(), steps=40)
    state = tensordict["next", "corridor"]
    count = state["alpha_count"][:, 0].long()
    assert (count > 0).all()
    assert (count < state["gamma_count"][:, 0]).all()
    for b in range(4):
        assert (state["alphas"][b, count[b] :] == 0).all()


def two_steps(controller):
    world = random_world(3, 3)
    first = controller(world.observe())
    world.step(first["action"])
    second = world.observe().set("corridor", first["next", "corridor"])
    return world, second


def test_a_batch_gives_what_its_scenes_give_alone():
    controller = PushingCorridorController()
    _, second = two_steps(controller)
    together = controller(second.clone())
    for b in range(3):
        alone = PushingCorridorController()(second[b : b + 1].clone())
        torch.testing.assert_close(alone["action"][0], together["action"][b])
        one = PushingCorridorController()(second[b].clone())
        torch.testing.assert_close(one["action"], together["action"][b])


@pytest.mark.parametrize("how", ["is_init", "zero state", "other goal"])
def test_a_new_episode_resets_its_scene_and_no_other(how):
    controller = PushingCorridorController()
    world, second = two_steps(controller)
    kept = controller(second.clone())["next", "corridor"]
    assert (kept["gamma_count"] + kept["still"] + kept["started"]).sum() > 0
    world.object[1] = torch.tensor([0.40, 0.1])
    new = world.observe().set("corridor", kept.clone())
    if how == "is_init":
        new["is_init"] = torch.tensor([[False], [True], [False]])
    elif how == "zero state":
        new["corridor"][1] = kept[1].clone().zero_()
    else:
        new["goal_position"][1] += 0.01
    out = controller(new.clone())["next", "corridor"]
    fresh = controller(new.exclude("corridor"))["next", "corridor"]
    for key in set(fresh.keys()):
        torch.testing.assert_close(out[key][1], fresh[key][1], msg=str(key))
    torch.testing.assert_close(out["path"][1, 0], world.object[1], atol=1e-4, rtol=0)
    for b in (0, 2):
        assert torch.equal(out["path"][b], kept["path"][b])


def test_inputs_and_the_old_state_are_not_changed():
    controller = PushingCorridorController()
    _, second = two_steps(controller)
    before, state = second.clone(), second["corridor"]
    controller(second)
    for key in set(before.keys()) - {"corridor"}:
        assert torch.equal(before[key], second[key]), key
    for key in set(state.keys()):
        assert torch.equal(before["corridor", key], state[key]), key


class PusherEnv(EnvBase):
    """Two scenes of the kinematic world; an episode lasts eight steps in the first one."""

    def __init__(self):
        super().__init__(batch_size=torch.Size([2]))
        images = {"depth": torch.float32, "segmentation": torch.uint8}
        spec = {key: Unbounded((2, 1, 256, 256), dtype=kind) for key, kind in images.items()}
        sizes = {"object_pose": 3, "ee_pose": 3, "goal_position": 2, "object_radius": 1}
        spec |= {key: Unbounded((2, size), dtype=torch.float32) for key, size in sizes.items()}
        self.observation_spec = Composite(spec, shape=(2,))
        self.action_spec = Bounded(-1, 1, (2, 3), dtype=torch.float32)
        self.reward_spec = Unbounded((2, 1), dtype=torch.float32)
        flags = {key: Binary(1, (2, 1), dtype=torch.bool) for key in ("done", "terminated")}
        self.done_spec = Composite(flags, shape=(2,))
        self.world, self.age = random_world(2, 5), torch.zeros(2, 1)

    def _reset(self, tensordict=None, **kwargs):
        mask = torch.ones(2, 1).bool() if tensordict is None else tensordict.get("_reset", None)
        mask = torch.ones(2, 1).bool() if mask is None else mask
        self.world.object = torch.where(mask, torch.tensor([0.34, 0.0]), self.world.object)
        self.world.tool = torch.where(mask, torch.tensor([0.25, 0.02]), self.world.tool)
        self.age = torch.where(mask, 0.0, self.age)
        return self.world.observe()

    def _step(self, tensordict):
        self.world.step(tensordict["action"])
        self.age += 1
        done = self.age >= torch.tensor([[8.0], [99.0]])
        out = self.world.observe().set("reward", torch.zeros(2, 1))
        return out.set("done", done).set("terminated", done.clone())

    def _set_seed(self, seed):
        pass


@pytest.mark.parametrize("how", ["primer", "tracker", "bare"])
def test_rollouts_carry_the_state_and_restart_it(how):
    controller = PushingCorridorController()
    env = PusherEnv()
    if how == "primer":
        env = TransformedEnv(env, controller.make_tensordict_primer())
        check_env_specs(env)
    elif how == "tracker":
        env = TransformedEnv(env, InitTracker())
    rollout = env.rollout(14, controller, break_when_any_done=False)
    state = rollout["next", "corridor"]
    assert (state["path"][1] == state["path"][1, 0]).all()
    assert (rollout["next", "done"][0, :, 0].nonzero()[:, 0] == 7).all()
    assert state["gamma_count"][0, 7] > 0
    assert (state["gamma_count"][0, 8] == 0).all()  # a first step has nothing to learn from
    assert torch.equal(rollout["action"][0, 8], rollout["action"][0, 0])


def test_nested_keys():
    world = random_world(2, 4)
    plain = world.observe()
    nested = TensorDict(
        {
            "camera": {"depth": plain["depth"], "labels": plain["segmentation"]},
            "pose": {"object": plain["object_pose"], "tool": plain["ee_pose"]},
            "task": {"goal": plain["goal_position"], "radius": plain["object_radius"]},
            "episode": {"first": torch.ones(2, 1, dtype=torch.bool)},
        },
        batch_size=[2],
    )
    out = PushingCorridorController(
        depth_key=("camera", "depth"),
        segmentation_key=("camera", "labels"),
        object_pose_key=("pose", "object"),
        ee_pose_key=("pose", "tool"),
        goal_position_key=("task", "goal"),
        object_radius_key=("task", "radius"),
        is_init_key=("episode", "first"),
        state_key=("agent", "memory"),
        action_key=("agent", "action"),
    )(nested)
    expected = PushingCorridorController()(plain)
    assert set(out.keys(True, True)) >= {("agent", "action"), ("agent", "memory", "path")}
    assert torch.equal(out["agent", "action"], expected["action"])
    assert torch.equal(out["next", "agent", "memory", "path"], expected["next", "corridor", "path"])


def test_the_object_may_be_anywhere():
    # In an obstacle, under the tool, off the image, at the goal: always a finite action.
    spots = torch.tensor([[0.47, 0.2], [0.34, 0.0], [3.0, -3.0], [0.62, 0.0]])
    tool = torch.tensor([[0.47, 0.2], [0.34, 0.0], [0.3, 0.0], [0.61, 0.0]])
    goal = torch.tensor([0.62, 0.0]).expand(4, 2)
    for config in (CorridorConfig(), faithful_config()):
        controller = PushingCorridorController(config)
        observed = PointPusher(spots, goal, tool, GAP).observe()
        for _ in range(3):
            out = controller(observed.clone())
            assert out["action"].isfinite().all()
            observed["corridor"] = out["next", "corridor"]
