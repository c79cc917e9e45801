"""`make_tqc`, its config, and the whole optimisation step."""

import warnings
from dataclasses import fields

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import GymEnv, SerialEnv, TransformedEnv
from torchrl.envs.transforms import RewardSum
from torchrl.objectives import TQCLoss as TorchRLTQCLoss

from modpush.agents import TQCConfig, TQCLoss, TQCUpdate, make_actor, make_tqc
from tests.agents.tqc.tqc_builders import make_batch, make_loss

SMALL = TQCConfig(hidden_sizes=(16, 12), batch_size=8)


@pytest.fixture
def env():
    return GymEnv("Pendulum-v1")


def rollout(env, agent, steps=20):
    with torch.no_grad():
        return env.rollout(steps, agent.exploration_policy, break_when_any_done=False)


@pytest.mark.parametrize("layer_norm", [False, True])
def test_an_update_moves_everything_it_should(env, layer_norm):
    torch.manual_seed(0)
    config = TQCConfig(hidden_sizes=(16, 12), layer_norm=layer_norm)
    agent = make_tqc(config, env)
    assert agent.loss._ensemble is not None
    before = {name: tensor.clone() for name, tensor in agent.loss.state_dict().items()}
    batch = rollout(env, agent)
    result = agent.update(batch)
    assert result["td_error"].shape == (20,)
    assert all(v.isfinite().all() and not v.requires_grad for v in result.values())
    for name, tensor in agent.loss.state_dict().items():
        if "weight" in name or name == "log_alpha":
            assert not torch.equal(tensor, before[name]), name
    assert all(p.grad is None for p in agent.loss.parameters())


def test_the_actor_acts_within_bounds_and_trains_in_place(env):
    agent = make_tqc(SMALL, env)
    weight = agent.actor.module[0].module[0][0].weight
    before = weight.clone()
    data = rollout(env, agent, 50)
    assert data["action"].abs().max() <= 2
    agent.update(data)
    assert not torch.equal(weight, before)


def test_exploration_noise_has_the_configured_size():
    env = GymEnv("Pendulum-v1")
    agent = make_tqc(TQCConfig(hidden_sizes=(8,), exploration_sigma=0.1), env)
    noise = agent.exploration_policy[-1]
    data = TensorDict({"action": torch.zeros(20_000, 1)}, batch_size=[20_000])
    # Pendulum's action is +-2: its half range times sigma is 0.2.
    assert noise(data)["action"].std().item() == pytest.approx(0.2, rel=0.05)


def test_batched_environments():
    env = SerialEnv(2, lambda: GymEnv("Pendulum-v1"))
    agent = make_tqc(SMALL, env)
    data = rollout(env, agent, 6)
    assert data.shape == (2, 6)
    assert agent.update(data.reshape(-1))["loss_qvalue"].isfinite()
    env.close()


def test_target_entropy_is_minus_the_actions_width(env):
    assert make_tqc(SMALL, env).loss.target_entropy == -1
    agent = make_tqc(TQCConfig(hidden_sizes=(8,), target_entropy=-0.25), env)
    assert agent.loss.target_entropy == -0.25


def test_parameter_groups_carry_their_learning_rates(env):
    config = TQCConfig(hidden_sizes=(8,), actor_lr=0.1, critic_lr=0.2, alpha_lr=0.3)
    groups = make_tqc(config, env).optimizer.param_groups
    assert {g["name"]: g["lr"] for g in groups} == {"actor": 0.1, "critic": 0.2, "alpha": 0.3}
    fixed = make_tqc(TQCConfig(hidden_sizes=(8,), fixed_alpha=True), env)
    assert [g["name"] for g in fixed.optimizer.param_groups] == ["actor", "critic"]


def test_one_optimizer_equals_three(env):
    """A fused Adam with three groups steps like three plain ones."""
    ends = []
    for split in (False, True):
        torch.manual_seed(0)
        agent = make_tqc(SMALL, env)
        optimizers = [agent.optimizer]
        if split:
            groups = agent.optimizer.param_groups
            optimizers = [torch.optim.Adam(g["params"], lr=g["lr"]) for g in groups]
        torch.manual_seed(1)
        for seed in range(5):
            losses = agent.loss(batch_for(agent, seed))
            for name in ("loss_actor", "loss_qvalue", "loss_alpha"):
                losses[name].backward()
            for optimizer in optimizers:
                optimizer.step()
                optimizer.zero_grad()
            agent.target_updater.step()
        ends.append(torch.cat([p.detach().flatten() for p in agent.loss.parameters()]))
    torch.testing.assert_close(*ends, rtol=1e-5, atol=1e-7)


def batch_for(agent, seed, size=8):
    generator = torch.Generator().manual_seed(seed)
    after = {"observation": torch.randn(size, 3, generator=generator)}
    after |= {"reward": torch.randn(size, 1, generator=generator)}
    after |= {key: torch.zeros(size, 1, dtype=torch.bool) for key in ("done", "terminated")}
    now = {"observation": torch.randn(size, 3, generator=generator)}
    now |= {"action": torch.rand(size, 1, generator=generator) * 4 - 2}
    return TensorDict({**now, "next": after}, batch_size=[size])


def test_our_critics_work_in_torchrls_own_loss(env):
    agent = make_tqc(SMALL, env)
    theirs = TorchRLTQCLoss(agent.actor, agent.critics, num_qvalue_nets=2)
    ours = TQCLoss(agent.actor, agent.critics, num_qvalue_nets=2)
    values = []
    for loss in (theirs, ours):
        loss.make_value_estimator(gamma=0.9)
        from torchrl.objectives import SoftUpdate

        SoftUpdate(loss, tau=0.5)
        torch.manual_seed(0)
        values.append(loss(batch_for(agent, 3))["loss_qvalue"])
    torch.testing.assert_close(*values)


def test_sac_trainer_runs_the_agent():
    from torchrl.trainers.algorithms import SACTrainer

    env = TransformedEnv(
        GymEnv("Pendulum-v1"), RewardSum(in_keys=["reward"], out_keys=["reward_sum"])
    )
    agent = make_tqc(SMALL, env)
    before = agent.loss.log_alpha.item()
    # The trainer writes the loss's actor into the collector's policy, so it takes the bare actor.
    collector = Collector(
        env, agent.actor, frames_per_batch=10, total_frames=40, init_random_frames=10
    )
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(100), batch_size=8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the trainer calls itself experimental
        trainer = SACTrainer(
            collector=collector,
            total_frames=40,
            frame_skip=1,
            optim_steps_per_batch=2,
            loss_module=agent.loss,
            optimizer=agent.optimizer,
            replay_buffer=buffer,
            target_net_updater=agent.target_updater,
            progress_bar=False,
            enable_logging=False,
        )
        trainer.train()
    assert agent.loss.log_alpha.item() != before


def test_compiled_update_equals_the_eager_one(monkeypatch):
    results = []
    compile_eagerly = torch.compile
    monkeypatch.setattr(
        torch, "compile", lambda function: compile_eagerly(function, backend="eager")
    )
    for execution in ("eager", "compile"):
        loss = make_loss(TQCLoss)
        optimizer = torch.optim.SGD([p for p in loss.parameters() if p.requires_grad], lr=1e-3)
        from torchrl.objectives import SoftUpdate

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # dynamo on tensordict's locks
            update = TQCUpdate(loss, optimizer, SoftUpdate(loss, tau=0.1), execution=execution)
            torch.manual_seed(0)
            output = update(make_batch(6))
        results.append((output, loss.state_dict()))
    for key, value in results[0][0].items():
        torch.testing.assert_close(results[1][0][key], value)
    for name, value in results[0][1].items():
        torch.testing.assert_close(results[1][1][name], value)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_graphs_learn_like_eager_updates():
    env, ends = GymEnv("Pendulum-v1"), []
    for execution in ("eager", "cudagraph"):
        torch.manual_seed(0)
        config = TQCConfig(hidden_sizes=(16,), device="cuda", execution=execution)
        agent = make_tqc(config, env)
        for seed in range(30):
            result = agent.update(batch_for(agent, seed).to("cuda"))
        ends.append(result["loss_qvalue"].item())
    assert ends[0] == pytest.approx(ends[1], rel=0.3)


def test_unknown_executions_and_missing_devices_are_refused():
    loss = make_loss(TQCLoss)
    with pytest.raises(ValueError, match=r"execution must be one of \('eager', .*, got 'fast'."):
        TQCUpdate(loss, None, None, execution="fast")
    message = r"'cudagraph' needs parameters on a CUDA device, got cpu\."
    with pytest.raises(ValueError, match=message):
        TQCUpdate(loss, None, None, execution="cudagraph")


def test_presets():
    assert TQCConfig.preset("paper") == TQCConfig()
    cpu = TQCConfig.preset("cpu", gamma=0.9)
    assert (cpu.hidden_sizes, cpu.batch_size, cpu.alpha_init) == ((256, 256), 256, 0.02)
    assert cpu.gamma == 0.9
    gpu = TQCConfig.preset("gpu")
    assert (gpu.device, gpu.execution) == ("cuda", "cudagraph")
    with pytest.raises(ValueError, match=r"must be one of \['cpu', 'gpu', 'paper'\], got 'tpu'."):
        TQCConfig.preset("tpu")


def test_the_papers_numbers():
    config = TQCConfig.preset("paper")
    assert config.hidden_sizes == (512, 256, 128)
    assert (config.num_critics, config.num_quantiles) == (2, 25)
    assert config.top_quantiles_to_drop_per_net == 2
    assert (config.gamma, config.tau) == (0.98, 0.005)
    assert {config.actor_lr, config.critic_lr, config.alpha_lr} == {1e-4}
    assert (config.batch_size, config.learning_starts, config.updates_per_step) == (512, 10_000, 1)
    assert (config.alpha_init, config.exploration_sigma) == (1.0, 0.4)


def test_every_field_is_documented():
    import inspect

    source = inspect.getsource(TQCConfig)
    for field in fields(TQCConfig):
        line = source.split(f"    {field.name}: ")[1].split("\n")[1]
        assert line.strip().startswith('"""'), field.name


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"num_critics": 0}, "num_critics must be > 0, got 0."),
        ({"critic_lr": -1.0}, "critic_lr must be > 0, got -1.0."),
        ({"exploration_sigma": -0.1}, "exploration_sigma must be >= 0, got -0.1."),
        ({"hidden_sizes": ()}, r"hidden_sizes must hold widths >= 1, got \(\)."),
        ({"gamma": 1.1}, r"gamma must be in \[0, 1\], got 1.1."),
        ({"tau": 2.0}, r"tau must be in \(0, 1\], got 2.0."),
        (
            {"num_quantiles": 3, "top_quantiles_to_drop_per_net": 3},
            r"top_quantiles_to_drop_per_net must be < num_quantiles \(3\), got 3.",
        ),
        ({"min_alpha": 2.0}, "alpha_init must lie between min_alpha and max_alpha, got 2.0 <= 1.0"),
    ],
)
def test_bad_configs(kwargs, message):
    with pytest.raises(ValueError, match=message):
        TQCConfig(**kwargs)


def test_a_missing_observation_lists_what_there_is(env):
    message = r"observation_key 'state' not found, the env has \['observation'\]"
    with pytest.raises(ValueError, match=message):
        make_tqc(SMALL, env, observation_key="state")


def test_unbounded_actions_are_refused():
    from torchrl.data import Unbounded

    with pytest.raises(ValueError, match=r"action_spec must be a Bounded spec of shape \[A\]"):
        make_actor(3, Unbounded((2,)), (8,))


def test_log_standard_deviation_is_clamped():
    from torchrl.data import Bounded

    actor = make_actor(2, Bounded(-1, 1, (1,)), (4,))
    head = [layer for layer in actor.modules() if isinstance(layer, nn.Linear)][-1]
    head.weight.data.zero_()
    for bias, scale in ((50.0, torch.tensor(2.0).exp()), (-50.0, torch.tensor(1e-6))):
        head.bias.data[1] = bias
        data = actor(TensorDict({"observation": torch.zeros(1, 2)}, batch_size=[1]))
        torch.testing.assert_close(data["scale"].squeeze(), scale)


def test_public_names_resolve():
    import modpush.agents
    import modpush.replay

    for module in (modpush.agents, modpush.replay):
        assert all(hasattr(module, name) for name in module.__all__)
