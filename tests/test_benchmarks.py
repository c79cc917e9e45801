"""Every benchmark that `make bench` runs still runs, at its smallest; no time is looked at."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SMALL = {  # arguments, and a row that the table must have
    "bench_env.py": (["--quick"], "PushEnv(8).step"),
    "bench_learner.py": (["--rounds", "2", "--no-replay"], "| sb3 / ours |"),
    "bench_perception.py": (["--images", "4"], "small_cylinder"),
    "bench_planners.py": (["--queries", "16"], "LazyThetaStar.plan, 8 scenes"),
    "bench_play.py": ([], "| agent + corridor | all |"),
    "bench_poses.py": (["--maps", "1"], "scipy dijkstra"),
    "bench_scale.py": (["--steps", "6000", "--collectors", "1"], "success"),
    "bench_training.py": (["--seconds", "1"], "| taking turns |"),
}


def test_no_benchmark_is_left_out() -> None:
    assert sorted(SMALL) == sorted(path.name for path in (ROOT / "benchmarks").glob("bench_*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_benchmark_runs(name: str, tmp_path: Path) -> None:
    if name == "bench_scale.py" and importlib.util.find_spec("ray") is None:
        pytest.skip("bench_scale.py needs ray")
    arguments, row = SMALL[name]
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / name), *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=1200,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert row in done.stdout
