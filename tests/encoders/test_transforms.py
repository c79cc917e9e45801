"""EgocentricWindow and Encode as TorchRL transforms: on envs, in workers, on stored data."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, TransformedEnv, check_env_specs
from torchrl.envs.transforms import RenameTransform

from modpush._precision import networks_in
from modpush.encoders import (
    ConvEncoder,
    DepthVAE,
    EgocentricWindow,
    Encode,
    RayScan,
    egocentric_window,
)
from modpush.encoders.window_transform import WindowBytes
from modpush.envs import PushEnv
from modpush.geometry import Camera
from modpush.planners import OccupancyGrid, PlannerSubgoals, StraightLine
from tests.planners.table_scene import TableEnv

SMALL = Camera(height=64, width=64)
SMALL_WINDOW = {"camera": SMALL, "metres_per_pixel": SMALL.cell_size}


def small_transform(**options):
    return Compose(
        EgocentricWindow("base", size=16, **SMALL_WINDOW, **options), Encode(SmallScan())
    )


class SmallScan(RayScan):
    def __init__(self):
        super().__init__(8, window_size=16, pixel_size=SMALL.cell_size)


def make_env(num_envs=None):
    return TransformedEnv(TableEnv(num_envs), small_transform())


def steer(tensordict):
    return tensordict.set("action", torch.tensor([0.3, 1.0]).expand(*tensordict.batch_size, 2))


@pytest.fixture(scope="module")
def push_env():
    env = PushEnv(3, scene="random_clutter", clearance=0.0, seed=0)
    yield env
    env.close()


@pytest.mark.parametrize("make_encoder", [DepthVAE.from_pretrained, ConvEncoder])
def test_latents_of_encoders_in_bfloat16_are_float32_and_close(make_encoder):
    encoder, seen = Encode(make_encoder()), []
    encoder.encoder.register_forward_hook(lambda _, __, latent: seen.append(latent.dtype))
    window = torch.zeros(6, 1, 64, 64)
    window[:, :, 20:30, 10:40] = torch.rand(6, 1, 1, 1)
    exact = encoder(TensorDict(window=window))["latent"]
    with networks_in("bfloat16"):
        rounded = encoder(TensorDict(window=window))["latent"]
    again = encoder(TensorDict(window=window))["latent"]
    assert seen == [torch.float32, torch.bfloat16, torch.float32]
    assert rounded.dtype == torch.float32
    assert torch.equal(again, exact)
    assert 0 < (rounded - exact).abs().max() < 0.03 * exact.abs().max()


def test_fixed_weights_are_cast_once_and_anew_in_the_next_context():
    encoder = Encode(ConvEncoder())
    window = TensorDict(window=torch.rand(6, 1, 64, 64))

    def latent(**options):
        with networks_in("bfloat16", **options):
            return encoder(window.clone())["latent"]

    usual = latent()
    with networks_in("bfloat16", fixed_weights=True):
        assert torch.equal(encoder(window.clone())["latent"], usual)
        with torch.no_grad():  # which it does not notice: none may change within
            encoder.encoder.layers[0].weight.mul_(2.0)
        assert torch.equal(encoder(window.clone())["latent"], usual)
    assert not torch.equal(latent(), usual)
    assert torch.equal(latent(fixed_weights=True), latent())
    assert not torch.is_autocast_enabled("cpu")


@pytest.mark.parametrize("encoder", [DepthVAE, RayScan, ConvEncoder])
def test_specs_hold_on_a_push_env(push_env, encoder):
    env = TransformedEnv(push_env, Compose(EgocentricWindow(), Encode(encoder())))
    check_env_specs(env)
    assert env.reset()["latent"].shape == (3, 32)


@pytest.mark.parametrize("frame", ["object", "path", "base"])
def test_every_step_shows_that_step(push_env, frame):
    plan = Compose(
        OccupancyGrid(object_radius_key="object_radius"), PlannerSubgoals(StraightLine())
    )
    env = TransformedEnv(push_env, Compose(plan, EgocentricWindow(frame)))
    rollout = env.rollout(4, break_when_any_done=False)
    for data in (rollout, rollout["next"]):
        flat = data.reshape(-1)
        pose = flat["object_pose"].clone()
        if frame == "path":
            way = flat["subgoal"] - pose[:, :2]
            pose[:, 2] = torch.atan2(way[:, 1], way[:, 0])
        elif frame == "base":
            pose[:, 2] = 0.0
        expected = egocentric_window(flat["depth"][:, 0], flat["segmentation"][:, 0], pose)
        assert torch.equal(flat["window"], expected)
        assert (expected > 0).any()


def test_in_the_path_frame_the_sub_goal_is_up():
    depth = torch.full((1, 1, 64, 64), 1.1)
    bar = SMALL.project(torch.tensor([0.60, 0.10])).round().long()
    depth[0, 0, bar[1], bar[0]] = 1.05
    data = TensorDict(
        depth=depth,
        object_pose=torch.tensor([[0.60, 0.0, 2.0]]),
        subgoal=torch.tensor([[0.60, 0.2]]),
        batch_size=[1],
    )
    transform = EgocentricWindow("path", 16, segmentation_key=None, **SMALL_WINDOW, upright=False)
    row, column = transform(data)["window"][0, 0].nonzero().double().mean(0)
    assert row < 3
    assert column == pytest.approx(7.5, abs=1)


def test_partial_resets_leave_the_other_scenes_alone(push_env):
    env = TransformedEnv(push_env, Compose(EgocentricWindow(), Encode(RayScan())))
    before = env.rollout(2, break_when_any_done=False)[:, -1]["next"]
    mask = torch.tensor([[False], [True], [False]])
    after = env.reset(TensorDict({"_reset": mask}, batch_size=[3]).update(before))
    for key in ("window", "latent"):
        for scene in (0, 2):
            assert torch.equal(after[key][scene], before[key][scene])
    expected = egocentric_window(
        after["depth"][1], after["segmentation"][1], after["object_pose"][1:2]
    )
    assert torch.equal(after["window"][1:2], expected)


def test_keys_can_be_renamed_and_nested():
    env = TransformedEnv(
        TableEnv(2),
        Compose(
            RenameTransform(
                ["depth", "segmentation", "object_pose"],
                [("eye", "depth"), ("eye", "seg"), ("state", "pose")],
            ),
            EgocentricWindow(
                "base",
                size=16,
                **SMALL_WINDOW,
                depth_key=("eye", "depth"),
                segmentation_key=("eye", "seg"),
                object_pose_key=("state", "pose"),
                window_key=("eye", "window"),
            ),
            Encode(SmallScan(), window_key=("eye", "window"), latent_key=("agent", "latent")),
        ),
    )
    assert torch.equal(env.reset()["agent", "latent"], make_env(2).reset()["latent"])
    check_env_specs(env)


def test_the_mirrored_window_is_encoded_as_well():
    window = torch.rand(3, 1, 64, 64)
    encoder = RayScan()
    encoded = Encode(encoder, mirrored_key=("other", "latent"))(
        TensorDict({"window": window}, batch_size=[3])
    )
    assert torch.equal(encoded["latent"], encoder(window))
    assert torch.equal(encoded["other", "latent"], encoder(window.flip(-1)))


def test_encoding_is_in_eval_mode_and_leaves_the_mode_as_it_was():
    vae = DepthVAE().train()
    data = TensorDict(window=torch.rand(4, 1, 64, 64), batch_size=[4])
    together = Encode(vae)(data.clone())["latent"]
    alone = Encode(vae)(data[:1].clone())["latent"]
    torch.testing.assert_close(together[:1], alone)  # no statistics of the batch
    assert vae.training
    assert all(module.training for module in vae.modules())


def test_gradients_flow_only_if_asked():
    data = TensorDict(window=torch.rand(2, 1, 64, 64), batch_size=[2])
    conv = ConvEncoder(8)
    assert not Encode(conv)(data.clone())["latent"].requires_grad
    latent = Encode(conv, grad=True)(data.clone())["latent"]
    latent.square().sum().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in conv.parameters())


def test_an_encoder_of_your_own_needs_no_base_class():
    class Mean(torch.nn.Module):
        latent_dim = 1
        window_size = 8

        def forward(self, window):
            return window.mean((1, 2, 3))[:, None]

    out = Encode(Mean())(TensorDict(window=torch.ones(2, 1, 8, 8), batch_size=[2]))
    assert out["latent"].tolist() == [[1.0], [1.0]]


@pytest.mark.parametrize("value", [1.2, -0.1, 255.0, float("nan")])
def test_windows_that_bytes_cannot_hold_are_refused(value):
    window = torch.zeros(2, 1, 8, 8)
    window[1, 0, 3, 4] = value
    with pytest.raises(ValueError, match=r"'window' must be finite and in \[0, 1\], got values"):
        WindowBytes()(TensorDict(window=window, batch_size=[2]))


def test_stored_transitions_are_rewritten_in_root_and_next():
    stored = make_env(2).rollout(5, steer, break_when_any_done=False).reshape(-1)
    stale = stored.clone()
    for data in (stale, stale["next"]):
        data["window"].zero_()
        data["latent"].zero_()
    buffer = ReplayBuffer(storage=LazyTensorStorage(10), batch_size=8, transform=small_transform())
    buffer.extend(stale.set("row", torch.arange(10)))
    sample = buffer.sample()
    for key in ("window", "latent"):
        assert torch.equal(sample[key], stored[key][sample["row"]])
        assert torch.equal(sample["next", key], stored["next", key][sample["row"]])
    with pytest.raises(KeyError, match=r"\['depth'\] are missing in 'next'"):
        small_transform()(stored.clone().exclude(("next", "depth")))
    with pytest.raises(KeyError, match=r"\['window'\] are missing in 'next'"):
        Encode(SmallScan())(stored.exclude(("next", "window")))


def test_an_encoder_that_returns_another_width_is_named():
    class Wrong(nn.Module):
        latent_dim = 3

        def forward(self, window):
            return window.flatten(1)[:, :2]

    with pytest.raises(ValueError, match=r"must return \[B, latent_dim\] = \[2, 3\], got \[2, 2\]"):
        Encode(Wrong())(TensorDict(window=torch.zeros(2, 1, 64, 64), batch_size=[2]))


def test_at_a_partial_reset_only_those_scenes_are_encoded():
    """Four images at least, so that the last bits do not depend on how many scenes are reset."""
    encoded = []

    class Counting(DepthVAE):
        def forward(self, window):
            encoded.append(len(window))
            return super().forward(window)

    encoder = Counting.from_pretrained()
    transforms = Compose(EgocentricWindow("object"), Encode(encoder))
    env = TransformedEnv(PushEnv(8, scene="posts", seed=0), transforms)
    td = env.reset()
    before = td["latent"].clone()
    encoded.clear()
    td["_reset"] = torch.zeros(8, 1, dtype=torch.bool)
    td["_reset"][[2, 5]] = True
    after = env.reset(td)
    assert encoded == [4]
    kept = [0, 1, 3, 4, 6, 7]
    assert torch.equal(after["latent"][kept], before[kept])
    fresh = encoder(after["window"])  # of all scenes at once
    assert torch.equal(after["latent"][[2, 5]], fresh[[2, 5]])
    env.close()
