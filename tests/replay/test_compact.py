"""The compact storage against the ordinary one: the same samples, bit for bit."""

import pickle

import pytest
import torch
from hypothesis import given, settings, strategies as st
from tensordict import TensorDict
from torch import multiprocessing as mp
from torchrl.data import LazyTensorStorage, RandomSampler, RoundRobinWriter, TensorDictReplayBuffer
from torchrl.envs.transforms import MultiStepTransform

from modpush.replay import AttentiveSampler, CompactStorage, ReplayConfig, make_replay_buffer


def trajectories(num_envs: int, num_steps: int, episode: int, seed: int = 0, width: int = 3):
    """`[num_envs, num_steps]` transitions; an episode ends every `episode` steps of an env."""
    generator = torch.Generator().manual_seed(seed)
    rows = []
    observation = torch.randn(num_envs, width, generator=generator)
    for step in range(1, num_steps + 1):
        following = torch.randn(num_envs, width, generator=generator)
        done = (torch.arange(num_envs) + step).remainder(episode) == 0
        after = {"observation": following, "reward": torch.randn(num_envs, 1, generator=generator)}
        after |= {"done": done.unsqueeze(-1), "terminated": done.unsqueeze(-1)}
        rows.append(TensorDict({"observation": observation, "next": after}, batch_size=[num_envs]))
        restart = torch.randn(num_envs, width, generator=generator)
        observation = torch.where(done.unsqueeze(-1), restart, following)
    return torch.stack(rows, 1)


def pair(capacity: int, sampler=RandomSampler, batch_size: int = 16):
    buffers = []
    for storage in (CompactStorage(capacity), LazyTensorStorage(capacity)):
        buffer = TensorDictReplayBuffer(
            storage=storage, sampler=sampler(), writer=RoundRobinWriter(), batch_size=batch_size
        )
        buffer.set_rng(torch.Generator().manual_seed(0))
        buffers.append(buffer)
    return buffers


def assert_same_contents(compact, ordinary):
    mine, theirs = compact[:], ordinary[:]
    assert set(mine.keys(True, True)) == set(theirs.keys(True, True))
    for key in theirs.keys(True, True):
        assert torch.equal(mine[key].nan_to_num(7e9), theirs[key].nan_to_num(7e9)), key


def assert_links_are_consistent(storage):
    """Successor and predecessor are inverses, and each row of the side table has one owner."""
    successor, predecessor = storage._successor.tolist(), storage._predecessor.tolist()
    for slot, link in enumerate(successor):
        if link >= 0:
            assert predecessor[link] == slot
    for slot, link in enumerate(predecessor):
        if link >= 0:
            assert successor[link] == slot
    used = [-2 - link for link in successor if link < -1]
    rows = used + storage._free_rows
    assert sorted(rows) == list(range(len(storage._side[0]) if storage._side else 0))


LAYOUTS = {
    "step by step": lambda data: [data[:, t] for t in range(data.shape[1])],
    "trajectories, flattened": lambda data: [
        data[:, t : t + 4].reshape(-1) for t in range(0, data.shape[1], 4)
    ],
    "time first, flattened": lambda data: [
        data[:, t : t + 4].transpose(0, 1).reshape(-1) for t in range(0, data.shape[1], 4)
    ],
    "backwards": lambda data: [
        data.reshape(-1)[i : i + 5] for i in range(data.numel() - 5, -1, -5)
    ],
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("num_envs", [1, 3])
@pytest.mark.parametrize("capacity", [7, 32, 1000])
def test_same_contents_in_every_layout_and_through_wrap_around(layout, num_envs, capacity):
    compact, ordinary = pair(capacity)
    for part in LAYOUTS[layout](trajectories(num_envs, 40, episode=9)):
        for buffer in (compact, ordinary):
            buffer.extend(part.clone())
        assert_same_contents(compact, ordinary)
        assert_links_are_consistent(compact.storage)


@settings(deadline=None, max_examples=40)
@given(
    capacity=st.integers(3, 20),
    sizes=st.lists(st.integers(1, 25), min_size=1, max_size=8),
    episode=st.integers(1, 6),
    values=st.integers(1, 4),
    seed=st.integers(0, 999),
)
def test_same_contents_where_observations_repeat(capacity, sizes, episode, values, seed):
    """Few distinct observations: many entries share a next observation, or are their own."""
    compact, ordinary = pair(capacity)
    data = trajectories(1, sum(sizes), episode, seed)[0]
    for key in ("observation", ("next", "observation")):
        data[key] = (data[key] * 10).int().remainder(values).float()
    for part in data.split(sizes):
        for buffer in (compact, ordinary):
            buffer.extend(part.clone())
        assert_same_contents(compact, ordinary)
        assert_links_are_consistent(compact.storage)


@settings(deadline=None, max_examples=25)
@given(writes=st.lists(st.lists(st.integers(0, 9), min_size=1, max_size=4, unique=True)))
def test_same_contents_after_writes_anywhere(writes):
    compact, ordinary = pair(10)
    data = trajectories(1, 10 + 4 * len(writes), episode=5)[0]
    for storage in (compact.storage, ordinary.storage):
        storage.set(range(10), data[:10].clone())
        for number, slots in enumerate(writes):
            start = 10 + 4 * number
            storage.set(slots, data[start : start + len(slots)].clone(), set_cursor=False)
    assert_same_contents(compact.storage, ordinary.storage)
    assert_links_are_consistent(compact.storage)


def test_few_may_wait_for_their_successor_and_nothing_is_lost(monkeypatch):
    """Of eight trajectories written step by step, all but two are forgotten before they go on."""
    monkeypatch.setattr("modpush.replay.compact._MAX_WAITING", 2)
    compact, ordinary = pair(100)
    for part in trajectories(8, 20, episode=9).unbind(1):
        for buffer in (compact, ordinary):
            buffer.extend(part.clone())
        assert len(compact.storage._waiting) == len(compact.storage._awaited) <= 2
        assert_same_contents(compact, ordinary)
        assert_links_are_consistent(compact.storage)


@pytest.mark.parametrize("sampler", [RandomSampler, lambda: AttentiveSampler(3)])
def test_the_very_same_samples(sampler):
    compact, ordinary = pair(60, sampler)
    for part in trajectories(2, 50, episode=7).unbind(1):
        compact.extend(part.clone())
        ordinary.extend(part.clone())
    for _ in range(20):
        mine, theirs = compact.sample(), ordinary.sample()
        assert (mine == theirs).all()


def test_add_one_at_a_time():
    compact, ordinary = pair(12)
    for transition in trajectories(1, 30, episode=4)[0]:
        compact.add(transition.clone())
        ordinary.add(transition.clone())
    assert_same_contents(compact, ordinary)
    assert compact[5]["next", "observation"].shape == (3,)


def test_nan_next_observations_come_back():
    compact, ordinary = pair(20)
    data = trajectories(1, 15, episode=4)[0]
    data["next", "observation"][data["next", "done"].squeeze(-1)] = float("nan")
    compact.extend(data.clone())
    ordinary.extend(data)
    assert compact[:]["next", "observation"].isnan().any()
    assert_same_contents(compact, ordinary)


def test_n_step_transitions_are_linked_too():
    compact, ordinary = pair(100)
    for buffer in (compact, ordinary):
        buffer.append_transform(MultiStepTransform(3, 0.9))
        for part in trajectories(1, 60, episode=100)[0].split(10):
            buffer.extend(part.clone())
    assert_same_contents(compact, ordinary)
    assert int((compact.storage._successor >= 0).sum()) > 40


def test_at_most_230_bytes_a_transition_at_49_values():
    capacity, episode = 20_000, 200
    config = ReplayConfig(
        capacity=capacity, batch_size=8, sampler="uniform", storage="compact", num_queries=8
    )
    buffer = make_replay_buffer(config)
    data = trajectories(8, 2 * capacity // 8, episode, width=49)
    data["action"] = torch.zeros(*data.shape, 3)
    for part in data.split(100, dim=1):
        buffer.extend(part.reshape(-1))
    assert len(buffer) == capacity
    assert buffer.storage.nbytes() / capacity <= 230
    ordinary = sum(t.numel() * t.element_size() for t in data[0, 0].values(True, True))
    assert ordinary > 400


def test_state_dict_is_decoupled():
    compact, _ = pair(20)
    compact.extend(trajectories(1, 30, episode=4)[0])
    before, state = compact[:].clone(), compact.state_dict()
    compact.extend(trajectories(1, 30, episode=4, seed=1)[0])
    other, _ = pair(20)
    other.extend(trajectories(1, 2, episode=4)[0])
    other.load_state_dict(state)
    assert (other[:] == before).all()
    other.extend(trajectories(1, 9, episode=4, seed=2)[0])
    assert_links_are_consistent(other.storage)


def test_dumps_and_loads(tmp_path):
    compact, _ = pair(20)
    compact.extend(trajectories(1, 30, episode=4)[0])
    compact.dumps(tmp_path)
    other, _ = pair(20)
    other.loads(tmp_path)
    assert (other[:] == compact[:]).all()


def test_pickle_keeps_the_contents():
    storage = CompactStorage(20)
    storage.set(range(9), trajectories(1, 9, episode=4)[0])
    assert (pickle.loads(pickle.dumps(storage))[:] == storage[:]).all()


def test_emptying_forgets_everything():
    compact, ordinary = pair(20)
    for seed in range(2):
        for buffer in (compact, ordinary):
            buffer.empty()
            buffer.extend(trajectories(1, 12, episode=4, seed=seed)[0])
    assert_same_contents(compact, ordinary)


def test_missing_keys_are_named():
    storage = CompactStorage(5, keys=["pixels"])
    with pytest.raises(KeyError, match=r"CompactStorage: key .*pixels.* not found, the data has"):
        storage.set(range(2), trajectories(1, 2, 4)[0])


def test_sharing_between_processes_is_refused():
    storage = CompactStorage(5)
    process = mp.get_context("spawn").Process(target=print, args=(storage,))
    with pytest.raises(RuntimeError, match="cannot be shared between processes"):
        process.start()


@pytest.mark.parametrize("index", [9, torch.tensor(9), -1])
def test_reading_one_transition_changes_nothing(index):
    """The newest of ten has its next observation in the side table."""
    compact, ordinary = pair(12)
    data = trajectories(1, 10, episode=50)[0]
    compact.extend(data.clone())
    ordinary.extend(data.clone())
    one = compact.storage.get(index)
    assert one.batch_size == ()
    assert torch.equal(
        one["next", "observation"], ordinary.storage.get(index)["next", "observation"]
    )
    assert_same_contents(compact, ordinary)


@pytest.mark.parametrize("capacity", [50, 200])
@pytest.mark.parametrize("where", ["state_dict", "files"])
def test_a_state_of_another_capacity_is_refused_and_changes_nothing(capacity, where, tmp_path):
    buffer, _ = pair(100)
    buffer.extend(trajectories(2, 20, 10))
    other, _ = pair(capacity)
    other.extend(trajectories(2, 10, 10, seed=1))
    before = other[:].clone()
    buffer.dumps(tmp_path)
    load, given = {
        "files": (other.loads, tmp_path),
        "state_dict": (other.load_state_dict, buffer.state_dict()),
    }[where]
    with pytest.raises(ValueError, match=f"storage of {capacity} transitions, .*, got 100"):
        load(given)
    assert (other[:] == before).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_of_a_write_longer_than_the_storage_the_end_remains(threads):
    data = trajectories(1, 5500, episode=7, width=64)[0]
    storage = CompactStorage(1000)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)  # with several, torch writes to a slot twice in any order
    try:
        storage.set(torch.arange(5500) % 1000, data)
    finally:
        torch.set_num_threads(before)
    assert_links_are_consistent(storage)
    stored = storage.get(torch.arange(4500, 5500) % 1000)
    for key in data.keys(True, True):
        assert torch.equal(stored[key], data[4500:][key]), key


def test_changes_in_place_are_those_of_the_ordinary_storage():
    data = trajectories(2, 9, 4).transpose(0, 1).reshape(-1)
    one, other = (
        make_replay_buffer(
            ReplayConfig(capacity=50, batch_size=4, sampler="uniform", storage=storage)
        )
        for storage in ("compact", "tensor")
    )
    for buffer in (one, other):
        buffer.extend(data.clone())
        buffer.set_at_("observation", torch.full((2, 3), 5.0), torch.tensor([3, 8]))
        buffer.set_at_(("next", "observation"), torch.full((3,), 6.0), 5)
        buffer.set_at_(("next", "reward"), torch.zeros(4, 1), slice(2, 6))
        buffer.update_({"next": {"observation": buffer[:]["next", "observation"] + 1}})
        buffer.set_(("next", "done"), torch.ones(18, 1, dtype=torch.bool))
        buffer[torch.tensor([0, 1])] = buffer[torch.tensor([7, 8])].clone()
    for key in data.keys(True, True):
        assert torch.equal(one[:][key], other[:][key]), key
    assert_links_are_consistent(one.storage)
    with pytest.raises(ValueError, match="indices must differ"):
        one[torch.tensor([1, 1])] = data[:2]
