"""The agent under dynamics, sizes and sensors that it was not trained with."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from torchrl.envs import EnvBase
from tqdm import tqdm

from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.layouts import OBSTACLE_SCENES
from modpush.envs.scenes.objects import OBJECTS, PushedObject
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.evaluation.sets import EvaluationSet
from modpush.evaluation.tables import format_table
from modpush.mdp.noise import DepthNoise
from modpush.recipes.methods import Method
from paper.measure import SEED, Running, find_method, measure
from paper.provenance import origin_of, sources_text
from paper.rows import ROWS
from paper.statistics import make_cells

matplotlib.use("Agg")  # no screen is needed
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

__all__ = ["QUANTITIES", "Change", "Quantity", "measure_dynamics"]

_OBJECT = "small_cube"


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Something that differs from training, and the values that it takes."""

    title: str
    nominal: float
    """Value in training."""
    values: tuple[float, ...]
    """Values that are measured, the nominal one among them."""


QUANTITIES = {
    "mass": Quantity(title="mass (kg)", nominal=1.0, values=(0.1, 0.3, 1.0, 2.0, 4.0)),
    "friction": Quantity(
        title="friction coefficient", nominal=0.5, values=(0.1, 0.3, 0.5, 0.8, 1.2)
    ),
    "center_of_mass": Quantity(
        title="centre of mass off the middle (m)",
        nominal=0.0,
        values=(0.0, 0.005, 0.01, 0.015, 0.02),
    ),
    "size": Quantity(
        title="size of the cube, times 5 cm", nominal=1.0, values=(0.6, 0.8, 1.0, 1.3, 1.6)
    ),
    "depth_noise": Quantity(
        title="noise of the depth image (m)",
        nominal=0.0,
        values=(0.0, 0.001, 0.002, 0.003, 0.004, 0.006),
    ),
    "depth_dropout": Quantity(
        title="share of missing pixels", nominal=0.0, values=(0.0, 0.02, 0.1, 0.3, 0.6)
    ),
    "control_freq": Quantity(title="control rate (Hz)", nominal=15, values=(5, 10, 15, 20, 30)),
    "tip_height": Quantity(
        title="height of the tool's tip (m)", nominal=0.02, values=(0.012, 0.016, 0.02, 0.03, 0.04)
    ),
}
"""The quantities that are varied, one at a time. All other values are those of training."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """One quantity with another value than in training; picklable."""

    quantity: str
    value: float

    @property
    def nominal(self) -> bool:
        """True if this is the value of training."""
        return self.value == QUANTITIES[self.quantity].nominal

    @property
    def name(self) -> str:
        """Name of the results, which all nominal changes share."""
        return "nominal" if self.nominal else f"{self.quantity}_{self.value:g}"

    @property
    def item(self) -> PushedObject:
        """The pushed object."""
        item = OBJECTS[_OBJECT]
        if self.quantity == "size" and not self.nominal:
            (cube,) = item.parts
            x, y, z = (self.value * side for side in cube.size)
            parts = (replace(cube, size=(x, y, z)),)
            return replace(item, name=f"{_OBJECT}_times_{self.value:g}", parts=parts)
        if self.quantity == "tip_height" and not self.nominal:
            return replace(item, name=f"{_OBJECT}_tip_{self.value:g}", tip_height=self.value)
        return item

    def scenario(self, seed: int, number: int) -> Scenario:
        """Episode of this number: the same for all changes that leave the object's size alone."""
        config = ScenarioConfig(
            scene=OBSTACLE_SCENES[number % len(OBSTACLE_SCENES)], pushed_object=self.item
        )
        drawn = sample_scenario(np.random.default_rng([seed, number]), config)
        dynamics = drawn.dynamics
        if self.nominal:
            return drawn
        if self.quantity == "center_of_mass":
            # In a direction of its own in every episode, and the same for every distance.
            angle = np.random.default_rng([seed, number, 1]).uniform(-np.pi, np.pi)
            offset = (self.value * float(np.cos(angle)), self.value * float(np.sin(angle)))
            dynamics = replace(dynamics, center_of_mass=offset)
        elif self.quantity in ("mass", "friction"):
            changed: dict[str, Any] = {self.quantity: self.value}
            dynamics = replace(dynamics, **changed)
        return replace(drawn, dynamics=dynamics)

    def make_env(self, num_envs: int, method: Method, conditions: EpisodeConditions) -> EnvBase:
        """The agent's environment with this change."""
        options: dict[str, Any] = {"pushed_object": self.item, "conditions": conditions}
        if self.quantity == "control_freq":
            options["control_freq"] = int(self.value)
        env = method.make_env(num_envs, (_OBJECT,), **options)
        if self.quantity == "depth_noise" and self.value:
            env.insert_transform(0, DepthNoise(sigma=self.value))
        if self.quantity == "depth_dropout" and self.value:
            env.insert_transform(0, DepthNoise(dropout=self.value))
        return env


def _make_env(
    change: Change, agent: str, num_envs: int, objects: Sequence[str], conditions: EpisodeConditions
) -> EnvBase:
    """`make_env` of a change, as `evaluate` takes it; picklable."""
    return change.make_env(num_envs, find_method(agent)[1], conditions)


def measure_dynamics(
    running: Running, agent: str = "small_cube", episodes: int = 100, seed: int = SEED
) -> str:
    """Measure an agent under dynamics, sizes and sensors that it was not trained with.

    Draws `dynamics.png`, and returns the table in Markdown.

    Args:
        running: How episodes are run.
        agent: The agent.
        episodes: Number of episodes for each value of each quantity.
        seed: Seed from which the scenarios are drawn.
    """
    name, method = find_method(agent)
    cells: dict[str, pd.DataFrame] = {}
    origins, tables = [], []
    changes = [Change(quantity=q, value=v) for q, about in QUANTITIES.items() for v in about.values]
    for change in tqdm(changes, desc="dynamics", unit="value", disable=not running.progress):
        folder = running.folder / "dynamics" / name / change.name
        if change.name not in cells:
            rows = measure(
                method,
                EvaluationSet(
                    name=f"dynamics/{change.name}",
                    scenarios=tuple(change.scenario(seed, number) for number in range(episodes)),
                ),
                folder,
                running,
                make_env=functools.partial(_make_env, change, agent),
                label=change.name,
            )
            cells[change.name] = make_cells({name: rows})
            origins.append(origin_of(folder))
        about = {"quantity": change.quantity, "value": change.value, "nominal": change.nominal}
        tables.append(cells[change.name].assign(**about))
    table = pd.concat(tables, ignore_index=True)
    _draw(table, ROWS.parent / "dynamics.png")
    sources = sources_text("python -m paper dynamics", str(seed), origins)
    return f"{sources}\n{_as_text(table)}"


def _as_text(table: pd.DataFrame) -> str:
    lines = []
    for (quantity, value), own in table.groupby(["quantity", "value"], sort=False):
        cells = own.set_index("metric")
        success, spl = cells.loc["success"], cells.loc["spl"]
        mark = " (training)" if own["nominal"].iloc[0] else ""
        lines.append(
            {
                "quantity": QUANTITIES[str(quantity)].title,
                "value": f"{value:g}{mark}",
                "success": f"{success['mean']:.3f} [{success['low']:.3f}, {success['high']:.3f}]",
                "contact": cells.loc["contact_rate", "mean"],
                "collision": cells.loc["collision_rate", "mean"],
                "SPL": f"{spl['mean']:.3f}",
            }
        )
    return format_table(pd.DataFrame(lines).set_index("quantity"))


def _draw(table: pd.DataFrame, path: Path) -> None:
    figure, axes = plt.subplots(2, 4, figsize=(15, 6.4), sharey=True)
    for axis, (name, about) in zip(axes.flat, QUANTITIES.items(), strict=True):
        own = table[table["quantity"] == name]
        for metric, colour, label in (
            ("success", "C0", "success"),
            ("contact_rate", "C1", "contact rate"),
            ("collision_rate", "C3", "collision rate"),
        ):
            _draw_metric(axis, own[own["metric"] == metric], colour, label)
        axis.axvline(about.nominal, color="0.6", linestyle=":", label="training")
        axis.set(xlabel=about.title, ylim=(-0.02, 1.04))
        axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize="small", loc="center right")
    figure.tight_layout()
    figure.savefig(path, dpi=80, pil_kwargs={"optimize": True})
    plt.close(figure)


def _draw_metric(axis: Axes, cells: pd.DataFrame, colour: str, label: str) -> None:
    axis.plot(cells["value"], cells["mean"], color=colour, marker=".", label=label)
    axis.fill_between(cells["value"], cells["low"], cells["high"], color=colour, alpha=0.15)
