"""A training run from end to end: what it leaves, and what it survives."""

import itertools
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import psutil
import pytest
import torch
import yaml
from torchrl.envs import RewardScaling

import modpush
from modpush import evaluate
from modpush.evaluation import EvaluationConfig, load_set
from modpush.mdp import Curriculum, Phase
from modpush.recipes.agent_file import load_agent
from modpush.replay import cosine
from modpush.training import (
    NonFiniteLossError,
    Trainer,
    check_run_folder,
    held_out_scenarios,
)
from modpush.training.log import TrainingBar
from modpush.training.run_folder import RunFolder
from modpush.training.scene_worker import SceneWorker
from modpush.training.worker import InlineWorker, ProcessWorker
from tests.full_disk import full_disk
from tests.own_parts import (
    MeanHeight,
    SmallConv,
    goal_direction,
    make_scaled_env,
    one_post,
    small_actions,
)
from tests.training.conftest import SHORT, SMOKE

SMOKE_ASYNC = replace(SMOKE, async_collection=True)
ROOT = Path(modpush.__file__).parents[1]


def train(folder, config=SMOKE, *, resume=False):
    return Trainer(config, folder, resume=resume).run()


def resume_here(monkeypatch, folder, config=SMOKE_ASYNC, **options):
    """Resume a run of two processes in this one: the other takes ten seconds to start."""
    monkeypatch.setattr(
        "modpush.training.trainer.ProcessWorker", lambda make_worker, _: InlineWorker(make_worker)
    )
    trainer = Trainer(config, folder, resume=True, **options)
    trainer.run()
    return trainer


def numbers(folder):
    """What must not depend on when a run was killed."""
    table = pd.read_csv(folder / "evaluations.csv").drop(columns="minutes")
    return table, load_agent(folder / "last_agent.safetensors").actor.state_dict()


def assert_same(one, other):
    pd.testing.assert_frame_equal(one[0], other[0])
    assert one[1].keys() == other[1].keys()
    for name, value in one[1].items():
        assert torch.equal(value, other[1][name]), name


def start(folder, *arguments, total_steps=SMOKE.total_steps, **options):
    """`modpush train` with `SMOKE`'s settings."""
    settings = {
        "--train.total-steps": total_steps,
        "--train.evaluate-every": SMOKE.evaluate_every,
        "--train.checkpoint-every": SMOKE.checkpoint_every,
    }
    given = [str(part) for setting in settings.items() for part in setting]
    return subprocess.Popen(
        [sys.executable, "-m", "modpush", "train", "smoke", "--out", folder, *given, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        **options,
    )


def mirrored(n_steps=1):
    return replace(SHORT, mirror=True, replay=replace(SHORT.replay, n_steps=n_steps))


def wait_for_checkpoint(folder, process, limit=240):
    deadline = time.monotonic() + limit
    while not list((folder / "checkpoints").glob("step-*")):
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() < deadline, "no checkpoint in time"
        time.sleep(0.02)


def test_a_run_leaves_config_logs_agents_and_checkpoints(unbroken):
    stored = yaml.safe_load((unbroken / "config.yaml").read_text())
    assert stored["tqc"]["hidden_sizes"] == [16]
    log = pd.read_csv(unbroken / "log.csv")
    assert log["step"].iloc[-1] == 192
    assert log["updates"].iloc[-1] == 16  # (192 - 64) / 8
    assert {"learner/loss_qvalue", "noisy/success", "curriculum/level", "speed/steps"} <= set(log)
    assert log["learner/similarity"].dropna().between(-1, 1).all()
    evaluations = pd.read_csv(unbroken / "evaluations.csv")
    assert evaluations["step"].tolist() == [96, 192]
    assert {"success", "contact_rate", "success/free", "success/posts"} <= set(evaluations)
    assert len(list((unbroken / "checkpoints").glob("step-*"))) == 2
    assert list((unbroken / "logs" / "csv").rglob("*.csv"))
    assert load_agent(unbroken / "best_agent.safetensors").config == SMOKE.env


def test_async_collection_learns_the_same_as_taking_turns(unbroken, tmp_path, monkeypatch):
    """In two processes, which share the held-out episodes; one test, since a process takes 10 s."""
    trainer = Trainer(SMOKE_ASYNC, tmp_path / "run")
    assert isinstance(trainer.worker, ProcessWorker)
    with pytest.raises(RuntimeError, match=r"(?s)the worker failed.*call restart first"):
        trainer.worker.call(SceneWorker.collect, 1, None)
    shares = []
    submit, run = trainer.worker.submit, trainer.held_out.run

    def submitted(method, *args):
        if method is SceneWorker.evaluate:
            shares.append(args[-1])
        submit(method, *args)

    monkeypatch.setattr(trainer.worker, "submit", submitted)
    monkeypatch.setattr(
        trainer.held_out, "run", lambda *args: shares.append(args[-1]) or run(*args)
    )
    trainer.run()
    assert shares == [range(2), range(2, 4)] * 2
    assert_same(numbers(unbroken), numbers(tmp_path / "run"))


def test_a_killed_run_takes_its_worker_along_and_resumed_reaches_the_same_numbers(
    unbroken, tmp_path, monkeypatch
):
    """On Linux the worker is a fork, shares the libraries, and hears of its caller's end all the same."""
    folder = tmp_path / "run"
    process = start(folder, "--train.async-collection", total_steps=100_000)
    wait_for_checkpoint(folder, process)
    workers = psutil.Process(process.pid).children(recursive=True)
    assert workers
    if sys.platform == "linux":
        shared = workers[0].memory_full_info()
        assert shared.uss < 0.6 * shared.rss
    process.send_signal(signal.SIGKILL)
    assert process.wait(30) == -signal.SIGKILL
    process.stdout.close()
    _, alive = psutil.wait_procs(workers, timeout=60)
    assert not alive
    for checkpoint in RunFolder(folder).checkpoints.paths()[1:]:
        checkpoint.unlink()  # it may have gone past the other run's end
    resume_here(monkeypatch, folder)
    assert_same(numbers(unbroken), numbers(folder))


def test_a_worker_in_this_process_leaves_the_callers_random_numbers_alone():
    worker = InlineWorker(partial(SceneWorker, SMOKE))
    torch.manual_seed(7)
    expected = torch.rand(4)
    torch.manual_seed(7)
    worker.call(SceneWorker.restart, 0)
    worker.call(SceneWorker.collect, 2, None)
    assert torch.equal(torch.rand(4), expected)
    worker.close()


def test_a_folder_that_is_not_empty_is_refused(unbroken):
    with pytest.raises(FileExistsError, match="is not empty; resume it"):
        check_run_folder(unbroken, SMOKE, resume=False)


def test_a_checkpoint_of_another_config_says_which_fields_differ(unbroken):
    other = replace(SMOKE, seed=3, tqc=replace(SMOKE.tqc, hidden_sizes=(32,)))
    with pytest.raises(ValueError, match=r"tqc.hidden_sizes: \(16,\) -> \(32,\); seed: 0 -> 3"):
        check_run_folder(unbroken, other, resume=True)
    longer = replace(SMOKE, total_steps=960)
    assert check_run_folder(unbroken, longer, resume=True).path == unbroken


def test_only_what_does_not_change_the_numbers_may_change_in_a_resumed_run():
    free = {
        "total_steps": 960,
        "evaluate_every": 7,
        "log_every": 7,
        "checkpoint_every": 7,
        "progress": True,
        "collector": "ray",
        "num_collectors": 2,
    }
    assert replace(SMOKE, **free).differences(SMOKE) == []
    others = {
        "seed": 3,
        "rollout_length": 4,
        "greedy_envs": 0,
        "actor_average": 0.0,
        "first_actions": "random",
        "mirror": True,
        "save_buffer": False,
        "evaluation_episodes": 3,
    }
    for name, value in others.items():
        found = replace(SMOKE, **{name: value}).differences(SMOKE)
        assert found == [f"{name}: {getattr(SMOKE, name)!r} -> {value!r}"]


def test_the_buffer_takes_from_the_rest_of_the_run_what_must_agree_with_it():
    tqc = replace(SMOKE.tqc, gamma=0.75)
    config = replace(SMOKE, tqc=tqc, replay=replace(SMOKE.replay, n_steps=3), mirror=True)
    filled = config.filled_replay()
    # The returns' discount is the loss's; there is a query for each scene.
    assert (filled.gamma, filled.num_queries) == (0.75, SMOKE.env.num_envs)
    given = replace(config, replay=replace(config.replay, num_queries=5), mirror=False)
    assert given.filled_replay().num_queries == 5
    # Of a batch of 16, five queries keep 4, 3, 3, 3 and 3, of 4 times as many each.
    assert given.sampled_from == 64
    odd = replace(given, replay=replace(given.replay, k=2.5))
    assert odd.sampled_from == 10 + 4 * 8  # 2.5 * 3 = 7.5 is rounded up
    assert replace(given, replay=replace(given.replay, sampler="uniform")).sampled_from == 16


class Scenes(SceneWorker):
    """A worker without a simulator, which notes the stage that its episodes begin in."""

    def __init__(self):
        self.curriculum, self.env = Curriculum(SMOKE.curriculum), self
        self._sums = torch.zeros(2, 4)
        self.began = []
        self._hindsight = None

    def set_seed(self, seed):
        self.seed = seed

    def reset(self):
        self.began.append((self.curriculum.stage, self.seed))


def fake_trainer(**attributes):
    """As much of a trainer as begins and saves a run."""
    trainer = object.__new__(Trainer)
    forgetful = SimpleNamespace(forget_open_steps=lambda: None)
    defaults = {
        "config": SMOKE,
        "learner": forgetful,
        "worker": InlineWorker(Scenes),
        "checkpoints_made": 0,
        "curriculum_state": {},
        "_began": 0.0,
        "collect": lambda: None,
        "steps": 0,
        "folder": SimpleNamespace(checkpoints=SimpleNamespace(save=lambda steps, state: None)),
    }
    vars(trainer).update({**defaults, **attributes})
    return trainer


def test_a_resumed_run_continues_in_the_stage_that_it_was_in(monkeypatch):
    monkeypatch.setattr("modpush.training.trainer.trainer_state", lambda trainer: {})
    one = fake_trainer()
    one._first_rollout()
    one.worker._worker.curriculum.stage = 3
    one.save()
    other = fake_trainer(
        curriculum_state=one.curriculum_state, checkpoints_made=one.checkpoints_made
    )
    other._first_rollout()
    # With the seed that the scenes of the first one were begun anew with, too.
    assert other.worker._worker.began == one.worker._worker.began[1:]
    assert [stage for stage, _ in one.worker._worker.began] == [0, 3]


def test_what_is_due_is_done_at_the_first_rollout_past_its_step():
    """Rollouts of 16 steps; the scenes act while the learner learns, but for pauses."""
    events = []
    trainer = fake_trainer(
        config=replace(
            SMOKE, evaluate_every=25, checkpoint_every=40, log_every=100, total_steps=112
        ),
        steps=0,
        seconds_waited=0.0,
        learner=SimpleNamespace(learn=lambda before, now: events.append("learn")),
        collect=lambda: events.append("collect"),
        worker=SimpleNamespace(result=lambda: None),
        _write_log=lambda rollout: events.append("log") or {},
        _evaluate=lambda: events.append("evaluate"),
        save=lambda: events.append("save"),
    )

    def store(rollout):
        trainer.steps += 16
        events.append(trainer.steps)

    trainer.store = store
    trainer.bar = TrainingBar(SMOKE)
    while trainer.steps < 112:
        trainer._iterate()
    assert events == [
        *(16, "collect", "learn"),
        *(32, "learn", "evaluate", "collect"),
        *(48, "learn", "save", "collect"),
        *(64, "learn", "evaluate", "collect"),
        *(80, "learn", "evaluate", "save", "collect"),
        *(96, "collect", "learn"),
        *(112, "learn", "log", "evaluate", "save"),  # at the end all is due, and nothing follows
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"total_steps": 0}, "total_steps: .*greater than or equal to 1, got 0"),
        ({"greedy_envs": 2}, r"greedy_envs must be in \[0, 1\] with 2 scenes"),
        ({"replay": replace(SMOKE.replay, batch_size=8)}, "batch_size must be tqc.batch_size"),
        ({"tqc": replace(SMOKE.tqc, learning_starts=63)}, "learning_starts must be >= 64"),
        (
            {"replay": replace(SMOKE.replay, k=8)},
            "learning_starts must be >= 128",
        ),
        (
            {"mirror": True, "env": replace(SMOKE.env, encoder="end_to_end")},
            "mirror must be False with env.encoder='end_to_end'",
        ),
    ],
)
def test_configs_that_cannot_work_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SMOKE, **change)


def test_zero_initial_weights_leave_latent_and_points_ahead_without_effect(tmp_path):
    trainer = Trainer(SMOKE, tmp_path / "run")
    trainer.close()
    observation = torch.randn(5, trainer.learner.observation_dim)
    other = observation.clone()
    other[:, :32] += 1.0  # the latent of RayScan comes first
    other[:, -6:] += 1.0  # `path_ahead`, the last entry: three points
    actor = trainer.learner.agent.actor
    assert torch.equal(actor(observation)[0], actor(other)[0])
    other[:, 32] += 1.0
    assert not torch.equal(actor(observation)[0], actor(other)[0])


def test_a_loss_that_is_not_finite_stops_the_run_and_keeps_the_batch(tmp_path):
    trainer = Trainer(SMOKE, tmp_path / "run")
    with torch.no_grad():
        parameters = trainer.learner.agent.loss.named_parameters()
        next(value for name, value in parameters if "qvalue" in name).fill_(torch.nan)
    with pytest.raises(NonFiniteLossError, match=r"loss_\w+ is nan at update 1, step 80"):
        trainer.run()
    batch = torch.load(tmp_path / "run" / "non_finite_batch.pt")
    assert batch["observation"].shape == (16, trainer.learner.observation_dim)


def test_torchs_loggers_hold_the_rows_of_the_tables_once(unbroken, tmp_path):
    folder = shutil.copytree(unbroken, tmp_path / "run")
    with (folder / "logs" / "csv" / "train" / "scalars" / "speed" / "steps.csv").open("a") as file:
        file.write("240,1.0\n")  # of a stretch that was lost
    Trainer(replace(SMOKE, total_steps=240), folder, resume=True).run()
    steps = pd.read_csv(folder / "log.csv")["step"].tolist()
    logged = folder / "logs" / "csv" / "train" / "scalars"
    for name in ("speed/steps.csv", "updates.csv"):
        assert pd.read_csv(logged / name, header=None)[0].tolist() == steps
    assert len(pd.read_csv(logged / "evaluation" / "success.csv", header=None)) == len(
        pd.read_csv(folder / "evaluations.csv")
    )


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(tmp_path):
    trainer = Trainer(SMOKE, tmp_path / "run")
    trainer.worker.call(SceneWorker.restart, 0)
    trainer.store(trainer.worker.call(SceneWorker.collect, 4, None))
    trainer.save()
    first = trainer.folder.checkpoints.latest()
    trainer.steps += 1
    with full_disk(2_000), pytest.raises(OSError, match=r"step-000000009.safetensors"):
        trainer.save()
    assert trainer.folder.checkpoints.paths() == [first]
    assert [path.name for path in first.parent.iterdir()] == [first.name]
    trainer.close()
    resumed = Trainer(SMOKE, tmp_path / "run", resume=True)
    assert resumed.steps == 8
    resumed.close()


def test_held_out_episodes_are_the_same_in_every_run_and_of_all_families():
    one = held_out_scenarios(SMOKE)
    assert one == held_out_scenarios(replace(SMOKE, seed=5))
    assert {s.scene for s in one} == {"free", "posts"}
    assert all(0.2 <= _distance(s) <= 0.6 for s in one)


def test_the_scene_of_the_environment_is_what_is_trained_and_evaluated_on():
    config = replace(SMOKE, env=SMOKE.env.with_fields(scene="slot"))
    assert {s.scene for s in held_out_scenarios(config)} == {"slot"}
    worker = SceneWorker(config)
    curriculum = worker.curriculum
    curriculum.phase, curriculum.stage = 1, len(config.curriculum.distances) - 1
    worker.env.reset()
    assert {s.scene for s in worker.env.base_env.scenarios} == {"slot"}
    worker.close()


def _distance(scenario):
    (x, y, _), (a, b) = scenario.object_pose, scenario.goal_position
    return ((x - a) ** 2 + (y - b) ** 2) ** 0.5


def test_one_trains_resumes_and_evaluates_with_parts_of_your_own(tmp_path, monkeypatch):
    parts = {
        "encoder": MeanHeight(2.0),
        "scene": one_post,
        "entries": ["latent", "ee_position", "goal", goal_direction],
        "reward_terms": {"small_actions": small_actions},
        "similarity": cosine,
    }
    weights = {**SMOKE.env.reward.weights, "small_actions": 0.1}
    config = replace(
        SMOKE,
        env=replace(SMOKE.env, reward=replace(SMOKE.env.reward, weights=weights)),
        curriculum=replace(SMOKE.curriculum, phases=(Phase(),)),  # the environment's own scenes
        async_collection=True,
    )
    short = replace(config, total_steps=96)
    Trainer(short, tmp_path / "run", parts=parts).run()
    longer = replace(config, total_steps=144)
    trainer = resume_here(monkeypatch, tmp_path / "run", longer, parts=parts)
    assert trainer.specs.observation["observation"].shape == (4 + 2 + 2 + 2,)
    table = pd.read_csv(tmp_path / "run" / "evaluations.csv")
    assert "success/tests.own_parts:one_post" in table
    file = tmp_path / "run" / "last_agent.safetensors"
    agent = load_agent(file, parts=parts)
    rows = evaluate(
        agent,
        load_set("free/small_cube").first(2),
        tmp_path / "evaluation",
        config=EvaluationConfig(num_envs=2, progress=False),
    )
    assert len(rows) == 2


def test_a_convolutional_encoder_is_trained_with_the_agent(tmp_path):
    config = replace(
        SHORT,
        env=replace(SMOKE.env, encoder="end_to_end", window_size=32),
        tqc=replace(SMOKE.tqc, encoder="tests.own_parts:SmallConv"),
    )
    trainer = Trainer(config, tmp_path / "run")
    before = SmallConv().state_dict()
    trainer.run()
    batch = trainer.learner.buffer.sample()
    assert batch["window"].dtype == batch["next", "window"].dtype == torch.uint8
    agent = load_agent(tmp_path / "run" / "last_agent.safetensors", allow=("tests",))
    encoder = next(m for m in agent.policy.modules() if isinstance(m, SmallConv))
    name = (
        "layers.3.weight"  # windows of free space are all zeros, and do not reach the first layer
    )
    assert not torch.equal(encoder.state_dict()[name], before[name])
    env = agent.make_env(num_envs=2)
    env.rollout(2, agent.policy)
    env.close()


OWN_SAMPLER = "tests.own_parts:newest_half"


@pytest.mark.parametrize(
    ("sampler", "n_steps"),
    [
        (OWN_SAMPLER, 3),
        ("prioritized", 3),
        pytest.param("prioritized", 1, marks=pytest.mark.slow),
        pytest.param(OWN_SAMPLER, 1, marks=pytest.mark.slow),
        pytest.param("uniform", 3, marks=pytest.mark.slow),
        pytest.param("uniform", 1, marks=pytest.mark.slow),
    ],
)
def test_returns_over_several_steps_and_other_samplers(tmp_path, sampler, n_steps):
    replay = replace(SHORT.replay, n_steps=n_steps, sampler=sampler)
    trainer = Trainer(replace(SHORT, replay=replay), tmp_path / "run")
    trainer.run()
    batch = trainer.learner.buffer.sample()
    if n_steps == 3:
        assert batch["steps_to_next_obs"].max() == 3
    assert trainer.learner.updates == 4


@pytest.mark.parametrize("n_steps", [1, 3])
def test_a_run_learns_from_mirror_images(tmp_path, n_steps):
    trainer = Trainer(mirrored(n_steps), tmp_path / "run")
    trainer.run()
    batch = trainer.learner.buffer.sample()
    stored = trainer.learner.buffer.storage[batch["index"]]
    kept = (batch["observation"] == stored["observation"]).all(-1)
    assert 0 < kept.sum() < len(kept)
    mirror_images = (batch["observation"] == stored["mirrored_observation"]).all(-1)
    assert (kept | mirror_images).all()
    agent = load_agent(tmp_path / "run")
    env = agent.make_env(num_envs=1)
    assert "mirrored_observation" not in env.reset().keys()
    assert env.rollout(2, agent.actor)["action"].shape == (1, 2, 3)
    env.close()


def test_parts_of_an_unknown_kind_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"parts has no \['coder'\], expected some of \['actor', "):
        Trainer(SMOKE, tmp_path / "run", parts={"coder": None})


def test_a_part_that_cannot_be_pickled_is_refused_before_any_work(tmp_path):
    with pytest.raises(ValueError, match=r"parts\['scene'\] must be picklable.*top level of a mod"):
        Trainer(SMOKE_ASYNC, tmp_path / "run", parts={"scene": lambda rng, difficulty: []})
    assert not (tmp_path / "run").exists()


def test_no_two_runs_or_checkpoints_draw_the_same_episodes():
    seeds = sorted(
        fake_trainer(config=replace(SMOKE, seed=seed), checkpoints_made=made).worker_seed()
        for seed in range(4)
        for made in range(60)
    )
    # Scene i of at most some hundred takes seed + i.
    assert min(b - a for a, b in itertools.pairwise(seeds)) > 1000


def test_recovery_is_for_the_trained_agent_and_not_for_its_training():
    assert SMOKE.env.recovery
    worker = SceneWorker(SMOKE)
    assert "recovering" not in worker.env.reset().keys()
    worker.close()


def test_an_environment_of_your_own_is_trained_in(tmp_path):
    trainer = Trainer(SHORT, tmp_path / "run", make_env=make_scaled_env)
    trainer.run()
    agent = load_agent(tmp_path / "run" / "last_agent.safetensors", allow=("tests",))
    env = agent.make_env()
    assert any(isinstance(t, RewardScaling) for t in env.transform)
    env.close()
