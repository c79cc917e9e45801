"""PrioritizedSampler: probabilities, weights, and what changes priorities."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.data import (
    LazyTensorStorage,
    PrioritizedSampler as TorchRLPrioritizedSampler,
    TensorDictReplayBuffer,
)

from modpush.replay import PrioritizedSampler, ReplayConfig, make_replay_buffer
from modpush.replay.buffer import buffer_state, load_buffer_state
from tests.replay.test_buffer import trajectory

PRIORITIES = torch.tensor([0.0, 0.1, 5.0, 1.0, 2.0, 0.4, 0.4, 3.0, 0.01, 1.5, 0.7])


def extension_loads():
    try:
        TorchRLPrioritizedSampler(8, alpha=0.6, beta=0.4)
    except RuntimeError:
        return False
    return True


KINDS = [
    PrioritizedSampler,
    pytest.param(
        TorchRLPrioritizedSampler,
        marks=pytest.mark.skipif(not extension_loads(), reason="TorchRL's extension does not load"),
    ),
]


def entries(*values):
    return TensorDict({"x": torch.tensor(values)}, batch_size=[len(values)])


def make_buffer(sampler, size=16, batch_size=64):
    storage = LazyTensorStorage(size)
    return TensorDictReplayBuffer(storage=storage, sampler=sampler, batch_size=batch_size)


def filled(kind=PrioritizedSampler, alpha=0.6, beta=0.4, size=16, batch_size=64):
    """A buffer with the priorities above, partially filled unless `size` says otherwise."""
    np.random.seed(0)  # noqa: NPY002 (TorchRL's sampler draws from it)
    buffer = make_buffer(kind(size, alpha, beta), size, batch_size)
    buffer.extend(entries(*range(len(PRIORITIES))))
    buffer.update_priority(torch.arange(len(PRIORITIES)), PRIORITIES)
    return buffer


def probabilities(alpha, priorities=PRIORITIES):
    raised = (priorities.double() + 1e-8) ** alpha
    return raised / raised.sum()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("alpha", [0.0, 0.6, 1.3])
def test_entries_are_drawn_with_the_probabilities_of_the_definition(kind, alpha):
    draws = 200_000
    index = filled(kind, alpha, batch_size=draws).sample()["index"].flatten()
    counts = torch.bincount(index, minlength=11).double()
    expected = probabilities(alpha) * draws
    deviation = (counts - expected).abs() / expected.clamp_min(1).sqrt()
    assert deviation.max() < 4.5  # standard deviations, of 11 entries


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("beta", [0.0, 0.4, 1.0])
def test_weights_are_those_of_the_definition(kind, beta):
    sample = filled(kind, beta=beta, batch_size=500).sample()
    p = probabilities(0.6)
    weights = (len(p) * p) ** -beta
    expected = (weights / weights.max())[sample["index"].flatten()].float()
    torch.testing.assert_close(sample["priority_weight"], expected, rtol=1e-5, atol=0)


def test_trees_hold_sums_and_minima_of_any_capacity():
    for capacity in (1, 2, 7, 33):
        sampler = PrioritizedSampler(capacity, 1.0, 1.0)
        index = torch.randint(capacity, (60,))
        sampler.update_priority(index, torch.rand(60))  # an entry's last priority counts
        leaves = sampler._sum_tree.leaves
        for left in range(capacity):
            for right in range(left + 1, capacity + 1):
                part = leaves[left:right]
                written = part[part > 0]
                assert sampler._sum_tree.query(left, right) == pytest.approx(part.sum())
                least = written.min() if len(written) else np.inf
                assert sampler._min_tree.query(left, right) == least
        total = leaves.sum()
        mass = torch.linspace(0, 0.999, 50).double() * total
        found = sampler._sum_tree.scan_lower_bound(mass)
        expected = np.searchsorted(np.cumsum(leaves), mass.numpy(), side="right")
        assert found.tolist() == expected.tolist()


def test_new_entries_have_the_largest_priority_also_where_they_overwrite():
    buffer = filled(size=11, alpha=1.0, batch_size=400)
    buffer.extend(entries(100, 101))  # over entries 0 and 1, of priorities 0 and 0.1
    weights = buffer.sampler.state_dict()["weights"]
    torch.testing.assert_close(weights[:3], torch.full((3,), 5.0).double())
    torch.testing.assert_close(weights[3:], PRIORITIES[3:].double())
    assert {100, 101} <= set(buffer.sample()["x"].tolist())


def test_only_written_entries_are_drawn_and_an_emptied_buffer_begins_again():
    buffer = filled(batch_size=2000)
    assert buffer.sample()["index"].max() < 11
    buffer.empty()
    with pytest.raises(RuntimeError, match="empty storage"):
        buffer.sample()
    buffer.extend(entries(7, 8))
    sample = buffer.sample()
    assert set(sample["x"].tolist()) == {7, 8}
    assert (sample["priority_weight"] == 1).all()


@pytest.mark.parametrize("how", ["state_dict", "dumps", "buffer_state"])
def test_a_saved_sampler_draws_the_same(how, tmp_path):
    buffer, other = filled(), make_buffer(PrioritizedSampler(16, 1.0, 1.0))
    if how == "state_dict":
        other.load_state_dict(buffer.state_dict())
    elif how == "dumps":
        buffer.dumps(tmp_path)
        other.extend(entries(*range(11)))
        other.loads(tmp_path)
    else:
        load_buffer_state(other, buffer_state(buffer))
    samples = []
    for one in (buffer, other):
        one.extend(entries(11, 12))  # with the largest priority so far
        np.random.seed(1)  # noqa: NPY002
        samples.append(one.sample())
    assert (samples[0] == samples[1]).all()


def test_with_n_step_returns_and_batches_prepared_ahead():
    config = ReplayConfig(capacity=100, batch_size=8, sampler="prioritized", n_steps=3, prefetch=2)
    buffer = make_replay_buffer(config)
    buffer.extend(trajectory(60))
    for _ in range(4):
        assert buffer.sample()["priority_weight"].dtype == torch.float32
