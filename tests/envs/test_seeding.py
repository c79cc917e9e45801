import pytest

from modpush.envs.push_state import make_generators


@pytest.mark.parametrize("seed", [5, [5], [5, 6, 7]])
def test_scene_i_gets_the_seed_plus_i(seed) -> None:
    numbers = [generator.random() for generator in make_generators(seed, 3)]
    assert numbers == [make_generators(5 + i, 1)[0].random() for i in range(3)]


def test_without_a_seed_the_scenes_differ() -> None:
    assert len({generator.random() for generator in make_generators(None, 4)}) == 4
