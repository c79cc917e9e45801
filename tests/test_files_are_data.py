"""Whatever comes from a file is data: no reader of a file imports what it names, unless it is allowed."""

import copy
import functools
import json
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

import modpush
from modpush.cli.train import parse_run
from modpush.data import load_demonstrations
from modpush.envs import PushEnv
from modpush.envs.scenes.objects import OBJECTS, get_object_of
from modpush.evaluation.sets import load_set
from modpush.files import read_tensors, write_packed_json, write_tensors, write_yaml
from modpush.parts import ModulesRefusedError, check_allowed
from modpush.recipes import PushEnvConfig, load_agent
from modpush.training import TRAIN_PRESETS
from modpush.training.warm_start import load_initial_weights
from tests.damage import KINDS

SMOKE = TRAIN_PRESETS["smoke"]
SCENARIO = load_set("smoke").scenarios[0].to_dict()
HOSTILE = (
    "evil_module:thing",
    "modpush._atomic:os.getpid",
    "evil_module:Thing.thing",
    "évil_module:thing",
    "evil_module:thïng",
    "evil_module:thing-1",
    "modpush.files:read_json",
    "modpush.planners.named:find_part",
    "modpush.planners:named.PLANNERS",
)
"""Names of code that no file may run: others' modules, and ways out of the library's parts."""
MODULES = ("evil_module", "évil_module")


@pytest.fixture(autouse=True)
def evil(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Modules that can be imported, and have not been when the test ends."""
    (tmp_path / "path").mkdir()
    for name in MODULES:
        content = "class Thing: thing = None\nthing = thïng = Thing\n"
        (tmp_path / "path" / f"{name}.py").write_text(content, "utf-8")
    monkeypatch.syspath_prepend(tmp_path / "path")
    yield
    imported = [name for name in MODULES if sys.modules.pop(name, None)]
    assert not imported


def put(data: Any, place: str, value: Any) -> None:
    """Put a value into nested data; `place` is dotted, and a last `*` is for a new key."""
    *folders, last = place.split(".")
    for folder in folders:
        data = data[folder]
    data[value if last == "*" else last] = 1.0 if last == "*" else value


@functools.cache
def agent_content() -> tuple[Any, Any]:
    """What an agent's file holds."""
    with tempfile.TemporaryDirectory() as folder:
        return read_tensors(KINDS["agent"](Path(folder))[0], "modpush.Agent", 5)


def agent(place: str, several: bool = False) -> Callable[[Path, str], object]:
    def read(folder: Path, text: str) -> object:
        path = folder / "agent.safetensors"
        tensors, about = copy.deepcopy(agent_content())
        if place.startswith("parts"):
            about["parts"]["planner"] = {}
        if place.startswith("make_env"):
            about["make_env"] = {}
        put(about, place, [text] if several else text)
        write_tensors(path, tensors, "modpush.Agent", 5, about)
        return load_agent(path).make_env()

    return read


def warm_start_from_agent(folder: Path, text: str) -> None:
    with pytest.raises(ValueError, match="load_agent"):
        agent("env.planner")(folder, text)
    config = replace(SMOKE, init_from=str(folder / "agent.safetensors"))
    load_initial_weights(None, config, None, {})  # type: ignore[arg-type]  # not reached


def write_set(path: Path, field: str, text: str) -> None:
    conditions = asdict(load_set("smoke").conditions)
    content = {"name": "own", "conditions": conditions, "episodes": [{**SCENARIO, field: text}]}
    write_packed_json(path, content)


def evaluation_set(field: str) -> Callable[[Path, str], object]:
    def read(folder: Path, text: str) -> object:
        write_set(folder / "set.json.gz", field, text)
        return PushEnv(1, pushed_object=load_set(folder / "set.json.gz").objects)

    return read


def engine_of_a_set(folder: Path, text: str) -> object:
    conditions = {**asdict(load_set("smoke").conditions), "engine": text, "sim_freq": None}
    content = {"name": "own", "conditions": conditions, "episodes": [SCENARIO]}
    write_packed_json(folder / "set.json.gz", content)
    return PushEnv(1, **load_set(folder / "set.json.gz").conditions.env_options)


def minari(folder: Path, text: str) -> object:
    pytest.importorskip("minari")
    (folder / "main_data.hdf5").touch()
    env = {**asdict(PushEnvConfig()), "planner": text}
    about = {"modpush": {"env": env}, "observation_space": "{}", "action_space": "{}"}
    (folder / "metadata.json").write_text(json.dumps(about))
    return load_demonstrations(folder)


def minari_specification(folder: Path, text: str) -> object:
    """Minari makes the environment of a data set that does not say its spaces."""
    pytest.importorskip("minari")
    (folder / "main_data.hdf5").touch()
    spec = {"id": "Evil-v0", "entry_point": text, "kwargs": {}, "additional_wrappers": []}
    about = {"modpush": {"env": asdict(PushEnvConfig())}, "env_spec": json.dumps(spec)}
    (folder / "metadata.json").write_text(json.dumps({**about, "data_format": "hdf5"}))
    return load_demonstrations(folder)


def run_config(folder: Path, text: str) -> object:
    env = json.loads(json.dumps({**asdict(SMOKE), "env": {**asdict(SMOKE.env), "planner": text}}))
    write_yaml(folder / "config.yaml", env, "modpush.TrainConfig", 1)
    return parse_run(["smoke", "--config", str(folder / "config.yaml")])


READERS: dict[str, Callable[[Path, str], object]] = {
    **{
        f"agent {place}": agent(place)
        for place in (
            "env.planner",
            "env.encoder",
            "env.scenario.scene",
            "env.scenario.pushed_object",
            "env.simulation.depth",
            "env.simulation.engine",
            "env.reward.weights.*",
            "network.actor",
            "network.encoder",
            "parts.planner.name",
            "make_env.name",
        )
    },
    **{f"agent {place}": agent(place, several=True) for place in ("env.entries", "env.add")},
    "init_from an agent": warm_start_from_agent,
    "set pushed_object": evaluation_set("pushed_object"),
    "set scene": evaluation_set("scene"),
    "set engine": engine_of_a_set,
    "minari": minari,
    "minari specification": minari_specification,
    "config.yaml": run_config,
}
"""What reads a file that names something, and uses what it has read."""


@pytest.mark.parametrize(
    ("reader", "text"),
    [
        *((reader, text) for reader in READERS for text in HOSTILE[:2]),
        *(("agent env.planner", text) for text in HOSTILE[2:]),
    ],
)
def test_no_file_runs_code_that_its_reader_has_not_allowed(
    tmp_path, reader: str, text: str
) -> None:
    with pytest.raises(
        ValueError, match=r"names parts in|leads to|must be one of|must hold|loaded alone"
    ):
        READERS[reader](tmp_path, text)


def test_a_part_given_by_the_caller_does_not_open_the_door_to_another(tmp_path) -> None:
    """Where the encoder is not trained with the agent, the network's own is still the file's."""
    path = tmp_path / "agent.safetensors"
    tensors, about = copy.deepcopy(agent_content())
    about["network"]["encoder"] = "evil_module:thing"
    write_tensors(path, tensors, "modpush.Agent", 5, about)
    with pytest.raises(ModulesRefusedError, match="evil_module"):
        load_agent(path, parts={"encoder": "rays"})


def test_an_object_that_is_not_loaded_is_not_imported_to_say_so() -> None:
    with pytest.raises(ValueError, match="'evil_module:thing' was not loaded"):
        get_object_of([OBJECTS["small_cube"]], "evil_module:thing")


def test_what_is_allowed_must_be_defined_where_it_is_named(tmp_path, monkeypatch) -> None:
    (tmp_path / "path" / "own_module.py").write_text(
        "import os\nfrom json import JSONDecoder\nfrom os import getpid\n"
        "class Thing:\n    def __init__(self): ...\n    def make(self): ...\n"
        "def thing(): ...\nVALUE = JSONDecoder()\nSEVERAL = [1]\n"
    )
    for name in ("Thing", "Thing.make", "thing", "VALUE", "SEVERAL"):
        check_allowed("who", {"a": [f"own_module:{name}"]}, ("own_module",))
    for name in (
        "os",
        "os.getpid",
        "getpid",
        "JSONDecoder",
        "Thing.__class__",
        "Thing.__init__.__globals__.clear",
        "thing.__globals__.clear",
        "VALUE.decode",
        "SEVERAL.clear",
    ):
        with pytest.raises(ModulesRefusedError, match=f"own_module:{name}.*leads to"):
            check_allowed("who", {f"own_module:{name}": 1.0}, ("own_module",))
        check_allowed(
            "who", f"own_module:{name}", (f"own_module:{name}",)
        )  # the caller's own words
    sys.modules.pop("own_module")


NO_PARTS = {
    "_validation.py": "defines from_plain",
    "geometry/camera_model.py": "has no parts",
    "envs/scenes/conditions.py": "has no parts",
    "envs/scenes/scenario.py": "takes plain data; its names are looked up by those who use it",
    "envs/push_state.py": "names are compared with those of the environment",
    "mdp/curriculum.py": "reads numbers and names of scenes, which are counted alone",
    "recipes/gym_env.py": "takes arguments",
    "training/run_folder.py": "compares the config with another, and makes no parts",
}
"""Modules that make objects of plain data without the gate, and why."""


def test_every_module_that_makes_objects_of_plain_data_has_the_gate() -> None:
    root = Path(modpush.__file__).parent
    makes = re.compile(r"\b(from_plain|Scenario\.from_dict)\(")
    found = {
        path.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if makes.search(text := path.read_text()) and "check_allowed(" not in text
    }
    assert found == set(NO_PARTS)
