"""The attentive sampler: what it keeps, how uniform it draws, and TorchRL's own checks."""

import copy
from functools import partial

import pytest
import torch
from hypothesis import given, settings, strategies as st
from scipy import stats
from tensordict import TensorDict
from torch import nn
from torchrl.data import (
    LazyMemmapStorage,
    LazyTensorStorage,
    ListStorage,
    RandomSampler,
    TensorDictReplayBuffer,
)
from torchrl.data.replay_buffers.scheduler import LinearScheduler

from modpush.replay import (
    AttentiveSampler,
    ReplayConfig,
    cosine,
    make_replay_buffer,
)

WIDTH = 4


def transitions(*size: int, seed: int = 0, key="observation") -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    data = TensorDict({}, batch_size=size)
    data[key] = torch.randn(*size, WIDTH, generator=generator)
    data["next", "done"] = torch.zeros(*size, 1, dtype=torch.bool)
    return data


def make_buffer(sampler, storage=None, batch_size=8, **kwargs):
    storage = LazyTensorStorage(100) if storage is None else storage
    return TensorDictReplayBuffer(storage=storage, sampler=sampler, batch_size=batch_size, **kwargs)


class Recording(AttentiveSampler):
    """Keeps the candidates it drew, for brute force."""

    def _draw(self, storage, size):
        self.drawn = super()._draw(storage, size)
        return self.drawn


def brute_force(similarity: str, candidates, query):
    if similarity == "cosine":
        return nn.functional.cosine_similarity(candidates, query.expand_as(candidates), dim=-1)
    return -(candidates - query).square().sum(-1).sqrt()


@pytest.mark.parametrize("similarity", ["cosine", "negative_l2"])
@pytest.mark.parametrize("k", [1, 2, 3.5])
def test_keeps_the_most_similar_candidates(similarity, k):
    sampler = Recording(k, similarity=similarity)
    buffer = make_buffer(sampler)
    data = transitions(60)
    buffer.extend(data)
    query = torch.randn(WIDTH)
    sampler.set_query(query)
    for _ in range(10):
        sample = buffer.sample()
        candidates = sampler.drawn.flatten()
        assert len(candidates) == 8 * k
        scores = brute_force(similarity, data["observation"][candidates], query)
        best = scores.sort(descending=True).values[:8]
        torch.testing.assert_close(sample["similarity"].sort(descending=True).values, best)
        kept = brute_force(similarity, sample["observation"], query)
        torch.testing.assert_close(sample["similarity"], kept)
        # A stored row is kept at most as often as it was drawn.
        drawn = candidates.bincount(minlength=60)
        assert (sample["index"].bincount(minlength=60) <= drawn).all()


@pytest.mark.parametrize("similarity", ["cosine", "negative_l2"])
def test_each_query_keeps_the_best_of_its_own_candidates(similarity):
    sampler = Recording(4, similarity=similarity)
    buffer = make_buffer(sampler, batch_size=6)
    data = transitions(90)
    buffer.extend(data)
    queries = torch.randn(3, WIDTH)
    sampler.set_query(queries)
    for _ in range(5):
        sample = buffer.sample()
        expected = []
        # Two entries for each query, of eight candidates each, one query's after the other's.
        for query, candidates in zip(queries, sampler.drawn.flatten().split(8), strict=True):
            scores = brute_force(similarity, data["observation"][candidates], query)
            expected += candidates[scores.topk(2).indices].tolist()
        assert sorted(sample["index"].tolist()) == sorted(expected)


def test_remainders_rotate_among_queries():
    sampler, chosen = AttentiveSampler(1), torch.zeros(3)
    buffer = make_buffer(sampler, batch_size=1)
    buffer.extend(transitions(50))
    sampler.similarity = partial(_count, chosen)
    sampler.set_query(torch.eye(3, WIDTH))
    for _ in range(300):
        buffer.sample()
    assert stats.chisquare(chosen.numpy()).pvalue > 1e-4


def _count(chosen, candidates, queries):
    chosen += queries[:, :3].sum(0)
    return cosine(candidates, queries)


def test_k_of_one_draws_what_the_uniform_sampler_draws():
    samples = []
    for sampler in (AttentiveSampler(1), RandomSampler()):
        buffer = make_buffer(sampler)
        buffer.extend(transitions(50))
        buffer.set_rng(torch.Generator().manual_seed(3))
        samples.append(buffer.sample()["index"].sort().values)
    assert torch.equal(*samples)


@pytest.mark.parametrize("written", [40, 100, 170])
def test_candidates_are_uniform_over_the_valid_part(written):
    """Also when full and wrapped around, and across the episode ends in between."""
    torch.manual_seed(0)
    sampler = Recording(2)
    buffer = make_buffer(sampler, batch_size=10)
    for part in transitions(written).split(7):
        part["next", "done"][-1] = True
        buffer.extend(part)
    valid = min(written, 100)
    counts = torch.zeros(100)
    for _ in range(500):
        buffer.sample()
        drawn = sampler.drawn.flatten()
        counts += torch.bincount(drawn, minlength=100)
    assert not counts[valid:].any()
    assert stats.chisquare(counts[:valid]).pvalue > 1e-3


def test_default_query_is_the_newest_entry_also_after_wrap_around():
    sampler = AttentiveSampler(4, similarity="negative_l2")
    buffer = make_buffer(sampler, LazyTensorStorage(50))
    for part in transitions(120).split(13):
        buffer.extend(part)
        if len(buffer) >= 32:
            newest = part["observation"][-1:]
            torch.testing.assert_close(sampler._queries(buffer.storage), newest)
            assert buffer.sample()["age"].max() < 50
    assert torch.equal(buffer[int(buffer._writer._cursor) - 1]["observation"], newest[0])


def test_age_counts_writes():
    buffer = make_buffer(AttentiveSampler(1), LazyTensorStorage(30), batch_size=25)
    for step in range(70):
        row = transitions(1, seed=step)
        row["step"] = torch.tensor([step])
        buffer.extend(row)
    sample = buffer.sample()
    assert torch.equal(sample["age"], 69 - sample["step"])


def test_torchrl_s_scheduler_anneals_k():
    sampler = AttentiveSampler(5)
    annealing = LinearScheduler(sampler, "k", 1.0, 4)
    buffer = make_buffer(sampler)
    buffer.extend(transitions(60))
    seen = []
    for _ in range(6):
        seen.append(sampler.k)
        buffer.sample()
        annealing.step()
    assert seen == [5, 4, 3, 2, 1, 1]


STORAGES = {
    "tensor": lambda path: LazyTensorStorage(40),
    "memmap": lambda path: LazyMemmapStorage(40, scratch_dir=path / "memmap"),
}


@pytest.mark.parametrize("storage", STORAGES)
def test_every_storage(storage, tmp_path):
    sampler = AttentiveSampler(2, similarity="negative_l2")
    buffer = make_buffer(sampler, STORAGES[storage](tmp_path), batch_size=5, collate_fn=collate)
    data = transitions(90)
    for part in data.split(10):
        buffer.extend(part)
    for transition in transitions(3, seed=1):
        buffer.add(transition)
    sample, info = buffer.sample(return_info=True)
    newest = transitions(3, seed=1)["observation"][-1]
    expected = -(sample["observation"] - newest).norm(dim=-1)
    torch.testing.assert_close(info["similarity"], expected)
    assert (info["age"] >= 0).all()
    assert (info["age"] < 40).all()


def collate(data):
    return torch.stack(data) if isinstance(data, list) else data


def test_a_renamed_nested_key():
    sampler = AttentiveSampler(3, key=("agent", "state"), similarity="negative_l2")
    buffer = make_buffer(sampler)
    buffer.extend(transitions(40, key=("agent", "state")))
    sample = buffer.sample()
    query = transitions(40, key=("agent", "state"))["agent", "state"][-1]
    expected = -(sample["agent", "state"] - query).norm(dim=-1)
    torch.testing.assert_close(sample["similarity"], expected)


def draw_often(buffer):
    for _ in range(50):
        buffer.sample()


def test_nan_in_what_is_stored():
    buffer = make_buffer(AttentiveSampler(2))
    data = transitions(30)
    data["observation"][3, 1] = float("nan")
    buffer.extend(data)
    with pytest.raises(
        ValueError, match="the similarity to 'observation' of a stored entry must be finite"
    ):
        draw_often(buffer)
    data["observation"][-1] = float("nan")
    buffer.extend(data)
    with pytest.raises(
        ValueError, match="the query, 'observation' of the newest entries, must be finite"
    ):
        buffer.sample()


@settings(deadline=None, max_examples=60)
@given(
    queries=st.integers(1, 12),
    batch_size=st.integers(1, 20),
    k=st.floats(1, 4),
    written=st.integers(1, 60),
    given_query=st.booleans(),
)
def test_what_can_be_sampled_is_sampled(queries, batch_size, k, written, given_query):
    sampler = Recording(k, num_queries=queries)
    buffer = make_buffer(sampler, batch_size=batch_size)
    buffer.extend(transitions(written))
    if given_query:
        sampler.set_query(torch.randn(queries, WIDTH))
    num_candidates = sampler.num_candidates(buffer.storage, batch_size)
    assert num_candidates >= k * batch_size - 1e-9
    assert buffer.can_sample() == (num_candidates <= written)
    if buffer.can_sample():
        assert len(buffer.sample()) == batch_size
        assert len(sampler.drawn) == num_candidates
    else:
        with pytest.raises(ValueError, match="must be <= the entries stored"):
            buffer.sample()


def test_the_newest_are_one_per_environment():
    """As the docstring promises for `[time, env].reshape(-1)`."""
    data = transitions(3, 10)  # 3 environments, 10 steps
    sampler, served = AttentiveSampler(2, num_queries=3), []
    buffer = make_buffer(sampler)
    buffer.extend(data.transpose(0, 1).reshape(-1))
    sampler.similarity = lambda c, q: served.append(q) or cosine(c, q)
    buffer.sample()
    queries, expected = torch.cat(served), data["observation"][:, -1]
    assert {tuple(row) for row in queries.tolist()} == {tuple(row) for row in expected.tolist()}


def test_storages_that_it_cannot_read_are_refused():
    buffer = make_buffer(AttentiveSampler(2), ListStorage(40), batch_size=2)
    buffer.extend(transitions(30))
    with pytest.raises(TypeError, match="must be a TensorStorage of tensordicts, got ListStorage"):
        buffer.sample()
    buffer = make_buffer(AttentiveSampler(2), LazyTensorStorage(60, ndim=2))
    with pytest.raises(ValueError, match="the storage must have one dimension, got 2"):
        buffer.extend(transitions(3, 10))


@pytest.mark.parametrize("where", ["state_dict", "files"])
def test_a_buffer_that_was_written_to_takes_a_state_s_newest_entry_over(where, tmp_path):
    def numbered(count, first):
        value = torch.arange(first, first + count).float()[:, None]
        flags = torch.zeros(count, 1, dtype=torch.bool)
        after = {"observation": value + 0.5, "reward": value, "done": flags, "terminated": flags}
        return TensorDict({"observation": value, "action": value, "next": after}, [count])

    config = ReplayConfig(capacity=100, batch_size=8, similarity="negative_l2")
    buffer = make_replay_buffer(config)
    buffer.extend(numbered(60, 0))
    if where == "files":
        buffer.dumps(tmp_path)
    else:
        state = copy.deepcopy(buffer.state_dict())
    buffer.extend(numbered(30, 500))
    if where == "files":
        buffer.loads(tmp_path)
    else:
        buffer.load_state_dict(state)
    sampler = buffer.sampler
    for _ in range(2):
        assert sampler._queries(buffer.storage)[0, 0] == 59
        sample = buffer.sample()
        assert torch.equal(sample["age"], 59 - sample["observation"][:, 0].long())
    buffer.extend(numbered(2, 700))
    assert sampler._queries(buffer.storage)[0, 0] == 701
