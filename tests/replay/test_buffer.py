import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, RandomSampler

from modpush.replay import (
    AttentiveSampler,
    PrioritizedSampler,
    ReplayConfig,
    make_replay_buffer,
    update_priorities,
)

SMALL = {"capacity": 100, "batch_size": 8}


def trajectory(steps: int) -> TensorDict:
    observation = torch.randn(steps + 1, 5)
    done = torch.zeros(steps, 1, dtype=torch.bool)
    after = {"observation": observation[1:], "reward": torch.ones(steps, 1)}
    after |= {"done": done, "terminated": done, "truncated": done}
    return TensorDict({"observation": observation[:-1], "next": after}, batch_size=[steps])


@pytest.mark.parametrize(
    ("storage", "cls"),
    [("tensor", LazyTensorStorage), ("memmap", LazyMemmapStorage)],
)
@pytest.mark.parametrize(
    ("sampler", "sampler_cls"),
    [
        ("attentive", AttentiveSampler),
        ("uniform", RandomSampler),
        ("prioritized", PrioritizedSampler),
    ],
)
def test_every_combination_samples(storage, cls, sampler, sampler_cls):
    buffer = make_replay_buffer(ReplayConfig(**SMALL, storage=storage, sampler=sampler))
    assert type(buffer.storage) is cls
    assert type(buffer.sampler) is sampler_cls
    buffer.extend(trajectory(60))
    sample = buffer.sample()
    assert sample["next", "observation"].shape == (8, 5)
    assert ("similarity" in sample) == (sampler == "attentive")
    assert ("priority_weight" in sample) == (sampler == "prioritized")


def test_the_sampler_takes_its_settings_from_the_config():
    config = ReplayConfig(**SMALL, k=3, similarity="negative_l2", num_queries=2)
    sampler = make_replay_buffer(config).sampler
    assert sampler.k == 3
    assert (sampler.similarity.__name__, sampler.num_queries) == ("negative_l2", 2)


class Recorder(RandomSampler):
    """Keeps the priorities that it is told."""

    def __init__(self):
        super().__init__()
        self.told = []

    def update_priority(self, index, priority, **kwargs):
        self.told.append((index, priority))


def recorder(config):
    sampler = Recorder()
    sampler.config = config
    return sampler


def dot_product(candidates, queries):
    return (candidates * queries.unsqueeze(1)).sum(-1)


@pytest.mark.parametrize("where", ["config", "factory", "object"])
def test_own_samplers(where):
    own = {"config": f"{__name__}:recorder", "factory": recorder, "object": Recorder()}[where]
    config = ReplayConfig(**SMALL, sampler=own) if where == "config" else ReplayConfig(**SMALL)
    buffer = make_replay_buffer(config, sampler=None if where == "config" else own)
    assert type(buffer.sampler) is Recorder
    if where != "object":
        assert buffer.sampler.config is config
    buffer.extend(trajectory(60))
    assert len(buffer.sample()) == 8


@pytest.mark.parametrize("where", ["config", "argument"])
def test_own_similarities(where):
    similarity = f"{__name__}:dot_product"
    config = ReplayConfig(**SMALL, **({"similarity": similarity} if where == "config" else {}))
    given = None if where == "config" else dot_product
    buffer = make_replay_buffer(config, similarity=given)
    buffer.extend(trajectory(60))
    query = torch.randn(5)
    buffer.sampler.set_query(query)
    sample = buffer.sample()
    torch.testing.assert_close(sample["similarity"], sample["observation"] @ query)


def test_priorities_are_written_back():
    buffer = make_replay_buffer(ReplayConfig(**SMALL), sampler=Recorder())
    buffer.extend(trajectory(60))
    batch = buffer.sample()
    result = TensorDict({"td_error": torch.arange(1.0, 9.0)}, batch_size=[])
    update_priorities(buffer, batch, result)
    index, priority = buffer.sampler.told[-1]
    assert torch.equal(index, batch["index"])
    assert torch.equal(priority, result["td_error"])
    with pytest.raises(KeyError, match=r"key \W*td_error\W* is missing"):
        update_priorities(buffer, batch, TensorDict())


@pytest.mark.parametrize("sampler", ["attentive", "uniform"])
def test_priorities_are_ignored_by_other_samplers(sampler):
    buffer = make_replay_buffer(ReplayConfig(**SMALL, sampler=sampler))
    buffer.extend(trajectory(60))
    batch = buffer.sample()
    before = str(buffer.sampler.state_dict())
    update_priorities(buffer, batch, TensorDict({"td_error": torch.ones(8)}))
    update_priorities(buffer, batch, TensorDict())  # as of a loss that gives none
    assert str(buffer.sampler.state_dict()) == before
