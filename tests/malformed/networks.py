"""Encoders, their data and their loss, with right arguments."""

import math

import torch
from tensordict import TensorDict
from torch import nn

from modpush import encoders
from tests.malformed.target import BELOW_1, KEYS, NOT_FINITE, NOT_POSITIVE, UNKNOWN, Target


def targets() -> list[Target]:
    """All of them."""
    window = torch.rand(2, 1, 64, 64)
    windows = [
        window[0],
        window[:, :, :32],
        window * 255,
        -window,
        window.double(),
        window.long(),
        window * math.nan,
        None,
        window.numpy(),
    ]
    made = {
        "RayScan": encoders.RayScan(),
        "ConvEncoder": encoders.ConvEncoder(4, 2),
        "DepthVAE": encoders.DepthVAE(2, (2, 3, 4, 5), (5, 4, 3, 2)),
    }
    return [
        *(
            Target(
                name=f"{name}.forward",
                call=encoder,
                given=lambda: {"window": window.clone()},
                bad={"window": windows},
                only=["window"],
            )
            for name, encoder in made.items()
        ),
        *_makers(),
        *_data(window),
        *_loss(window, made["DepthVAE"]),
    ]


def _makers() -> list[Target]:
    return [
        Target(
            name="RayScan",
            call=encoders.RayScan,
            given=lambda: {
                "num_rays": 8,
                "max_range": 0.1,
                "min_height": 0.013,
                "max_height": 0.08,
                "window_size": 16,
                "pixel_size": 0.003,
            },
            bad={
                "num_rays": BELOW_1,
                "max_range": NOT_POSITIVE,
                "min_height": [-1.0, 1.0, *NOT_FINITE],
                "max_height": NOT_POSITIVE,
                "window_size": BELOW_1,
                "pixel_size": NOT_POSITIVE,
            },
        ),
        Target(
            name="ConvEncoder",
            call=encoders.ConvEncoder,
            given=lambda: {"latent_dim": 4, "width": 2, "window_size": 16},
            bad=dict.fromkeys(("latent_dim", "width", "window_size"), BELOW_1),
        ),
        Target(
            name="DepthVAE",
            call=encoders.DepthVAE,
            given=lambda: {
                "latent_dim": 2,
                "encoder_widths": (2, 3, 4, 5),
                "decoder_widths": (5, 4, 3, 2),
                "sample": False,
            },
            bad={
                "latent_dim": BELOW_1,
                "encoder_widths": [(2, 3, 4), (0, 1, 1, 1), (1, 1, 1, 1.5)],
                "decoder_widths": [(2, 3, 4), (0, 1, 1, 1), (1, 1, 1, 1.5)],
            },
        ),
        Target(
            name="Encode",
            call=encoders.Encode,
            given=lambda: {
                "encoder": encoders.RayScan(),
                "window_key": "window",
                "latent_key": "latent",
                "grad": False,
            },
            bad={
                "encoder": [nn.Linear(2, 2), None, "rays", 3],
                "window_key": KEYS,
                "latent_key": KEYS,
            },
            only=["encoder"],
        ),
        Target(
            name="make_encoder",
            call=lambda encoder: encoders.make_encoder("it", encoder),
            given=lambda: {"encoder": "rays"},
            bad={"encoder": [*UNKNOWN, 3, nn.Linear(2, 2), "os:getcwd", list]},
            only=["encoder"],
        ),
        Target(
            name="encoder_sizes",
            call=lambda encoder: encoders.encoder_sizes("it", encoder),
            given=lambda: {"encoder": encoders.RayScan()},
            bad={"encoder": [nn.Linear(2, 2), None, 3, "rays"]},
            only=["encoder"],
        ),
    ]


def _data(window: torch.Tensor) -> list[Target]:
    flags = torch.zeros(2, dtype=torch.uint8)
    data = encoders.WindowData.from_floats(window, flags, flags.bool(), {})
    return [
        Target(
            name="WindowData.from_floats",
            call=encoders.WindowData.from_floats,
            given=lambda: {
                "windows": window.clone(),
                "family": flags.clone(),
                "held_out": flags.bool(),
                "config": {"seed": 1},
            },
            bad={
                "windows": [window * 2, -window, window * math.nan, window[:, 0], window.double()],
                "family": [flags[:1], flags.float(), None],
                "held_out": [flags, flags[:1].bool(), None],
                "config": [3, "text", None],
            },
            only=["windows", "family", "held_out", "config"],
            also={"windows": ["window"]},
        ),
        Target(
            name="WindowData.where",
            call=data.where,
            given=lambda: {"mask": torch.tensor([True, False])},
            bad={"mask": [torch.ones(3, dtype=torch.bool), None, "text", torch.ones(2)]},
            only=["mask"],
        ),
        Target(
            name="WindowData.join",
            call=encoders.WindowData.join,
            given=lambda: {"parts": [data]},
            bad={"parts": [[], 3, [3], [data, None]]},
            only=["parts"],
        ),
        Target(
            name="augment_windows",
            call=encoders.augment_windows,
            given=lambda: {"windows": window.clone(), "others": window.clone(), "overlay": 0.5},
            bad={
                "windows": [window[:1], window[:, :, :3], None, "text"],
                "others": [window[:1], window[:, :, :3], None, "text"],
                "overlay": [-0.1, 1.1, *NOT_FINITE],
            },
            only=["windows", "others"],
        ),
    ]


def _loss(window: torch.Tensor, vae: encoders.DepthVAE) -> list[Target]:
    loss = encoders.VAELoss(vae)
    latents = (torch.rand(8, 3), torch.rand(8, 2))
    probes = [
        (torch.rand(8, 3), torch.rand(7, 2)),
        (torch.rand(8), torch.rand(8)),
        (torch.rand(8, 3),),
        None,
        3,
    ]
    return [
        Target(
            name="VAELoss",
            call=encoders.VAELoss,
            given=lambda: {"vae": vae, "kl_weight": 0.5},
            bad={"kl_weight": [-1.0, *NOT_FINITE], "vae": [None, 3, nn.Linear(2, 2)]},
            only=["vae"],
        ),
        Target(
            name="VAELoss.forward",
            call=lambda window: loss(TensorDict(window=window)),
            given=lambda: {"window": window.clone()},
            bad={
                "window": [
                    window[0],
                    window[:, :, :32],
                    window * 255,
                    window * math.nan,
                    window.double(),
                ]
            },
            only=["window"],
        ),
        Target(
            name="vae_quality",
            call=encoders.vae_quality,
            given=lambda: {"vae": vae, "windows": lambda rows: window[rows], "count": 2},
            bad={"count": BELOW_1, "windows": [None, 3], "vae": [None, 3]},
            only=["windows", "vae"],
        ),
        *(
            Target(
                name=function.__name__,
                call=function,
                given=lambda: {"train": latents, "test": latents},
                bad={"train": probes, "test": probes},
                only=["train", "test"],
            )
            for function in (encoders.linear_probe, encoders.mlp_probe)
        ),
        Target(
            name="r_squared",
            call=encoders.r_squared,
            given=lambda: {"predicted": torch.rand(4, 2), "true": torch.rand(4, 2)},
            bad={
                "predicted": [torch.rand(3, 2), torch.rand(4, 1), None, "text"],
                "true": [torch.rand(3, 2), torch.rand(4, 1), None, "text"],
            },
            only=["predicted", "true"],
        ),
    ]
