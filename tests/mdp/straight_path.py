"""A stand-in for a planner, for tests of what reads its keys: the straight line to the goal."""

import torch
from torchrl.data import Unbounded
from torchrl.envs import Transform


class StraightPath(Transform):
    """Writes `path_length`, `subgoal` and `subgoal_past` as if nothing stood in the way."""

    def __init__(self):
        super().__init__(
            in_keys=["object_pose", "goal_position"],
            out_keys=["path_length", "subgoal", "subgoal_past"],
        )

    def _call(self, next_tensordict):
        goal = next_tensordict["goal_position"]
        way = goal - next_tensordict["object_pose"][..., :2]
        next_tensordict["path_length"] = way.norm(dim=-1, keepdim=True)
        next_tensordict["subgoal"] = goal.clone()
        next_tensordict["subgoal_past"] = goal.unsqueeze(-2).repeat_interleave(2, -2)
        return next_tensordict

    def _reset(self, tensordict, tensordict_reset):
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec):
        lead = observation_spec.shape
        for key, shape in (("path_length", (1,)), ("subgoal", (2,)), ("subgoal_past", (2, 2))):
            observation_spec[key] = Unbounded(shape=(*lead, *shape), dtype=torch.float32)
        return observation_spec
