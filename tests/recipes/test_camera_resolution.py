"""A trained agent behind a camera of another resolution than that of its training."""

from dataclasses import replace
from functools import partial

import pytest
import torch
from torchrl.data import Bounded
from torchrl.envs import Compose, Transform

from modpush.encoders import EgocentricWindow
from modpush.geometry import Camera
from modpush.planners import OccupancyGrid, PlannerSubgoals
from modpush.recipes import load_agent, make_env, make_push_env, planning
from modpush.recipes.agent_file import observed_symmetry

FINE = Camera(height=512, width=512)


class FineImages(Transform):
    """The same view at twice the resolution."""

    def _call(self, next_tensordict):
        for key in ("depth", "segmentation"):
            image = next_tensordict[key].repeat_interleave(2, -1).repeat_interleave(2, -2)
            next_tensordict.set(key, image)
        return next_tensordict

    def _reset(self, tensordict, tensordict_reset):
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec):
        for key in ("depth", "segmentation"):
            spec = observation_spec[key]
            shape = (*spec.shape[:-2], 512, 512)
            observation_spec[key] = Bounded(0, 3, shape, dtype=spec.dtype)
        return observation_spec


def run(scene):
    """Number of solved episodes of 8, and of steps in which anything touches an obstacle."""
    agent = load_agent("small_cube")
    config = replace(agent.config, num_envs=8, symmetry=observed_symmetry(agent.config))
    env = make_push_env(config, scene=scene, seed=0)
    data = env.reset()
    solved, over = torch.zeros(8, dtype=torch.bool), torch.zeros(8, dtype=torch.bool)
    collisions = 0
    with torch.no_grad():
        while not over.all():
            stepped, data = env.step_and_maybe_reset(agent.policy(data))
            after = stepped["next"]
            touched = (after["obstacle_contact"] | after["tool_obstacle_contact"])[:, 0]
            collisions += int((touched & ~over).sum())
            solved |= after["success"][:, 0] & ~over
            over |= after["done"][:, 0]
    env.close()
    return int(solved.sum()), collisions


@pytest.mark.parametrize("scene", ["slot", "posts"])
def test_images_of_512_pixels_are_as_good_as_those_of_the_training(scene, monkeypatch):
    as_trained = run(scene)
    with monkeypatch.context() as patched:
        fine_grid = partial(OccupancyGrid, camera=FINE)
        patched.setattr(
            planning, "OccupancyGrid", lambda **kwargs: Compose(FineImages(), fine_grid(**kwargs))
        )
        patched.setattr(planning, "PlannerSubgoals", partial(PlannerSubgoals, camera=FINE))
        patched.setattr(make_env, "EgocentricWindow", partial(EgocentricWindow, camera=FINE))
        solved, collisions = run(scene)
    assert solved == as_trained[0] == 8
    # A path on the finer map differs a little, and processors round differently. Windows that are not
    # resampled give 16 collisions in `slot` and 12 in `posts`.
    assert max(collisions, as_trained[1]) <= 3
