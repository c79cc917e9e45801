"""The environment that policies are recorded in is a `PushEnv` to them."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs, step_mdp

from modpush import PushEnv, make_push_env
from modpush.data import RecordingEnv
from tests.data.conftest import ENV


@pytest.fixture
def recorder():
    env = RecordingEnv(make_push_env(ENV, keep_images=True, seed=0))
    yield env
    env.close()


def test_it_keeps_torchrls_contract(recorder) -> None:
    check_env_specs(recorder)


def test_it_emits_what_push_env_does(recorder) -> None:
    plain = PushEnv(
        2,
        scene=ENV.scenario.scene,
        difficulty=ENV.scenario.difficulty,
        distance=ENV.scenario.distance,
        seed=0,
    )
    assert recorder.observation_spec == plain.observation_spec
    ours, theirs = recorder.reset(seed=5), plain.reset(seed=5)
    action = torch.tensor([[0.3, -0.2, 0.1], [1.0, 1.0, 0.0]])
    for _ in range(4):
        for key in ("object_pose", "ee_pose", "success", "depth"):
            torch.testing.assert_close(ours[key], theirs[key], rtol=0, atol=1e-6)
        ours = step_mdp(recorder.step(ours.set("action", action)))
        found = recorder.episode(1, policy="p", number=0, seed=0)
        # What was done may be shorter than what was asked for, in its own axes; so is the other's.
        done = [
            recorder.episode(i, policy="p", number=0, seed=0).infos["command"][-1] for i in range(2)
        ]
        theirs = step_mdp(
            plain.step(theirs.set("action", torch.tensor([c.tolist() for c in done])))
        )
    command = found.infos["command"]
    assert len(command) == 4
    cross = command[:, 0] - command[:, 1]
    assert abs(cross).max() < 1e-6  # the direction of (1, 1) is kept
    plain.close()
