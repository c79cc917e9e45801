"""A buffer's state as data: what was in it, what is drawn from it, and nothing that runs code."""

import pytest
import torch
from tensordict import TensorDict

from modpush._state import read_state, write_state
from modpush.replay import ReplayConfig, make_replay_buffer
from modpush.replay.buffer import buffer_state, load_buffer_state
from modpush.replay.n_step import extend_rollout


def transitions(start, count, envs=2):
    """`envs` walks that never end, env after env within a step."""
    step = torch.arange(start, start + count).repeat_interleave(envs).unsqueeze(-1).float()
    env = torch.arange(envs).repeat(count).unsqueeze(-1).float()
    flags = torch.zeros(count * envs, 1, dtype=torch.bool)
    following = {
        "observation": torch.cat([step + 1, env], -1),
        "reward": step,
        "done": flags,
        "terminated": flags,
    }
    now = {"observation": torch.cat([step, env], -1), "action": env}
    return TensorDict({**now, "next": following}, [count * envs])


@pytest.mark.parametrize("storage", ["tensor", "memmap"])
@pytest.mark.parametrize("sampler", ["attentive", "uniform"])
@pytest.mark.parametrize("n_steps", [1, 3])
@pytest.mark.parametrize("steps", [10, 90])  # 90 of two environments go around
def test_a_restored_buffer_continues_alike(tmp_path, storage, sampler, n_steps, steps):
    config = ReplayConfig(
        capacity=128, batch_size=4, k=2, storage=storage, sampler=sampler, n_steps=n_steps
    )
    buffer, other = make_replay_buffer(config), make_replay_buffer(config)
    for start in range(0, steps, 5):
        extend_rollout(buffer, transitions(start, 5), 2)
    write_state(tmp_path / "state.safetensors", buffer_state(buffer), "modpush.Test", 1)
    load_buffer_state(other, read_state(tmp_path / "state.safetensors", "modpush.Test", 1))
    for part in (buffer, other):
        extend_rollout(part, transitions(steps, 5), 2)
    assert len(other) == len(buffer)
    assert (other[:] == buffer[:]).all()
    torch.manual_seed(0)
    expected = buffer.sample()
    torch.manual_seed(0)
    assert (other.sample() == expected).all()


def test_what_no_file_can_hold_is_named(tmp_path):
    with pytest.raises(TypeError, match=r"state\['a'\]\[1\] is a set, which no file can hold"):
        write_state(tmp_path / "x", {"a": [1, {2}]}, "modpush.Test", 1)
