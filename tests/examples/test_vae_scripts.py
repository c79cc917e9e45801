"""The examples that collect windows and train on them run, stop, and go on where they were stopped."""

import csv
import dataclasses

import pytest
import torch

from modpush import load_agent
from modpush.encoders import DepthVAE
from modpush.training import Trainer
from tests.examples import load_example
from tests.training.conftest import SHORT


@pytest.fixture(scope="module")
def collect():
    module = load_example("collect_windows")
    yield module
    module.make_env.cache_clear()


@pytest.fixture(scope="module")
def train():
    return load_example("train_vae")


@pytest.fixture(scope="module")
def config(collect, tmp_path_factory):
    return collect.Config(
        output=tmp_path_factory.mktemp("windows") / "train.safetensors",
        count=70,
        part=30,
        held_out=0.15,
        num_envs=2,
        workers=1,
        steps=2,
    )


@pytest.fixture(scope="module")
def data(collect, config):
    return collect.main(config)


def test_collected_windows_are_as_the_config_says(data, config):
    assert len(data) == 70
    blank = data.windows.flatten(1).amax(1) == 0
    assert blank.sum() == 7
    assert torch.equal(data.family == len(config.families), blank)
    assert data.held_out.nonzero().flatten().tolist() == list(range(60, 70))
    assert data.config["families"] == [*config.families, "blank"]
    assert not list(config.output.parent.glob("*.parts"))
    # The object's own place is free.
    assert (data.windows[:, 30:34, 30:34] == 0).all()


def test_training_stopped_and_resumed_ends_the_same(train, data, config, tmp_path, capsys):
    short = train.Config(
        data=config.output,
        output=tmp_path / "whole",
        images=80,
        batch_size=16,
        eval_every=16,
        eval_windows=4,
        threads=1,
        encoder_widths=(2, 2, 2, 2),
        decoder_widths=(2, 2, 2, 2),
    )
    whole = train.main(short)
    stopped = dataclasses.replace(short, output=tmp_path / "stopped")
    train.main(dataclasses.replace(stopped, stop_at=32))
    resumed = train.main(stopped)
    for key, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[key]), key
    logs = [
        list(csv.DictReader((tmp_path / name / "log.csv").read_text().splitlines()))
        for name in ("whole", "stopped")
    ]
    assert [row["images"] for row in logs[0]] == ["16", "32", "48", "64", "80"]
    for a, b in zip(*logs, strict=True):
        assert {**a, "seconds": ""} == {**b, "seconds": ""}
    back = DepthVAE.from_pretrained(tmp_path / "whole" / "depth_vae.safetensors")
    window = data.floats(slice(0, 2))
    torch.testing.assert_close(back(window), whole.eval()(window))
    with pytest.raises(ValueError, match=r"was made with other \['lr'\]"):
        train.main(dataclasses.replace(short, lr=1e-2))


def test_an_agent_is_trained_on_an_encoder_with_a_latent_of_another_size(
    train, data, config, tmp_path
):
    train.main(
        train.Config(
            data=config.output,
            output=tmp_path / "vae",
            images=32,
            batch_size=16,
            eval_windows=4,
            threads=1,
            latent_dim=8,
        )
    )
    file = str(tmp_path / "vae" / "depth_vae.safetensors")
    trained = dataclasses.replace(SHORT, env=dataclasses.replace(SHORT.env, encoder=file))
    trainer = Trainer(trained, tmp_path / "run")
    trainer.run()
    assert trainer.specs.columns["latent"] == slice(0, 8)
    env = load_agent(tmp_path / "run" / "best_agent.safetensors").make_env(1)
    assert env.reset()["latent"].shape == (1, 8)
    env.close()


def test_the_report_is_written(data, config, tmp_path, capsys):
    report = load_example("report_vae")
    seen = dataclasses.replace(data, config={**data.config, "families": ["a", "blank"]})
    seen.save(tmp_path / "unseen.safetensors")
    DepthVAE(4, (2, 2, 2, 2), (2, 2, 2, 2)).save(tmp_path / "vae.safetensors")
    metrics = report.main(
        report.Config(
            weights=str(tmp_path / "vae.safetensors"),
            train=config.output,
            unseen=tmp_path / "unseen.safetensors",
            output=tmp_path / "report",
            probe_windows=40,
            probe_epochs=1,
        )
    )
    names = {path.name for path in (tmp_path / "report").iterdir()}
    pictures = {"reconstructions.png", "prior_samples.png", "traversals.png", "kl_per_latent.png"}
    assert names == {"metrics.json", *pictures}
    assert set(metrics["clearance along 16 rays, R²"]) == {"vae", "pca", "random projection"}


def test_probes_find_what_is_there():
    quality = load_example("vae_quality")
    torch.manual_seed(0)
    x = torch.randn(3000, 4)
    linear, bent = x @ torch.randn(4, 2), x[:, :2].abs()

    def parts(y):
        return (x[:2000], y[:2000]), (x[2000:], y[2000:])

    assert quality.linear_probe(*parts(linear)) == pytest.approx(1.0, abs=1e-6)
    assert quality.linear_probe(*parts(bent)) < 0.2
    assert quality.linear_probe(*parts(torch.randn(3000, 2))) < 0.05
    assert quality.r_squared(torch.zeros(3, 1), torch.tensor([[-1.0], [0.0], [1.0]])) == 0.0
