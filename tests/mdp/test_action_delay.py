"""Actions that reach a `PushEnv` late."""

import copy
import pickle

import pytest
import torch
from torchrl.envs import Compose, SerialEnv, Transform, TransformedEnv, check_env_specs

from modpush.envs import PushEnv
from modpush.mdp import ActionDelay, ActionFrame


class Note(Transform):
    """Keeps the actions that reach the environment."""

    def __init__(self) -> None:
        super().__init__(in_keys_inv=["action"], out_keys_inv=["action"])
        self.executed: list[torch.Tensor] = []

    def _inv_call(self, tensordict):
        self.executed.append(tensordict["action"].clone())
        return tensordict


def make(steps, scenes=3, frame="base", **options) -> tuple[TransformedEnv, Note]:
    note = Note()
    base = PushEnv(scenes, scene="free", depth=None, seed=0)
    delay = ActionDelay(steps, **options)
    return TransformedEnv(base, Compose(note, delay, ActionFrame(frame))), note


def act(env: TransformedEnv, steps: int = 12):
    """Random actions, and those that were executed, `[steps, B, 3]`."""
    actions = torch.rand(steps, *env.batch_size, 3, generator=torch.manual_seed(1)) * 2 - 1
    td, stored = env.reset(), []
    for action in actions:
        td, following = env.step_and_maybe_reset(td.set("action", action))
        stored.append(td["action"])
        td = following
    return actions, torch.stack(stored)


def ages(actions: torch.Tensor, executed: torch.Tensor) -> torch.Tensor:
    """Age of each executed action, `[steps, B]`; those of zeros before the first are -1."""
    found = torch.full(executed.shape[:2], -1)
    for t in range(len(actions)):
        for age in range(t + 1):
            found[t][(executed[t] == actions[t - age]).all(-1)] = age
    return found


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_the_executed_action_is_that_of_so_many_steps_ago_and_zero_before(steps: int) -> None:
    env, note = make(steps)
    actions, stored = act(env)
    executed = torch.stack(note.executed)
    assert torch.equal(executed[steps:], actions[: len(actions) - steps])
    assert not executed[:steps].any()
    assert torch.equal(stored, actions)  # the agent's own are what is stored
    env.close()


def test_ages_are_drawn_in_every_step_between_both_limits() -> None:
    env, note = make((1, 3), scenes=8)
    actions, _ = act(env, 60)
    found = ages(actions, torch.stack(note.executed))[3:]
    assert [(found == age).float().mean().item() > 0.25 for age in range(5)] == [
        False,
        True,
        True,
        True,
        False,
    ]
    assert (found[:, 0] != found[:, 1]).any()
    env.close()


def test_the_same_seed_gives_the_same_ages_in_a_batch_of_any_size() -> None:
    executed = []
    for scenes, torch_seed in ((3, 0), (3, 5), (1, 0)):
        torch.manual_seed(torch_seed)
        env, note = make((0, 3), scenes=scenes)
        actions, _ = act(env)
        executed.append(ages(actions, torch.stack(note.executed))[:, 0])
        env.close()
    assert torch.equal(executed[0], executed[1])
    assert torch.equal(executed[0][3:], executed[2][3:])
    for options in ({"seed": 1}, {}):  # another seed of the transform, and of the episodes
        env, note = make((0, 3), scenes=1, **options)
        env.set_seed(0 if options else 9)
        actions, _ = act(env)
        assert not torch.equal(ages(actions, torch.stack(note.executed))[:, 0], executed[2])
        env.close()


def test_an_action_is_delayed_in_the_base_frame() -> None:
    """It was turned when it was sent, and no longer turns with the object."""
    env, note = make(1, scenes=1, frame="object")
    td = env.reset()
    sent = env.transform[2].inv(td.clone().set("action", torch.tensor([[1.0, 0.0, 0.5]])))["action"]
    td = env.step_mdp(env.step(td.set("action", torch.tensor([[1.0, 0.0, 0.5]]))))
    td["object_pose"] = td["object_pose"] + torch.tensor([0.0, 0.0, 1.0])
    after = env.step(td.set("action", torch.tensor([[0.0, 1.0, 0.0]])))
    assert torch.equal(note.executed[1], sent)
    assert torch.equal(after["action"], torch.tensor([[0.0, 1.0, 0.0]]))
    env.close()


def test_a_scene_that_is_reset_alone_begins_with_zeros_and_the_others_continue() -> None:
    env, note = make(2, scenes=2)
    td = env.reset()
    for _ in range(3):
        td = env.step_mdp(env.step(td.set("action", torch.full((2, 3), 0.5))))
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    env.step(td.set("action", torch.full((2, 3), -0.5)))
    assert torch.equal(note.executed[-1], torch.tensor([[0.0] * 3, [0.5] * 3]))
    env.close()


def test_torchrl_s_checks_copies_and_workers() -> None:
    env, _ = make((1, 2))
    check_env_specs(env, break_when_any_done="both")
    env.close()
    serial = SerialEnv(2, lambda: make((0, 2), scenes=1)[0])
    check_env_specs(serial)
    serial.close()
    transform = ActionDelay((1, 2))
    assert pickle.loads(pickle.dumps(transform)).steps == copy.deepcopy(transform).steps == (1, 2)
