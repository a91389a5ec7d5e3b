import importlib
import math
import re
import typing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import xray_drake
from xray_drake.cell.drake_rules import DRAKE_RULES
from xray_drake.configuration import (
    build,
    check,
    check_tree,
    choice,
    count,
    fields_of,
    is_struct,
    number,
    number_list,
    path_field,
    path_list,
    rules_of,
    with_paths,
)
from xray_drake.ranges import Choice, Interval, Numbers
from xray_drake.station.scenario import Scenario
from xray_drake.training.config import TrainConfig
from xray_drake.trees import ConfigurationError, read_tree, write_tree


@dataclass
class Motion:
    speed: float = number(0.8, "(0, 10]")
    looks: int = count(3, "[1, 100]")
    kind: str = choice("straight", ("straight", "curved"))
    floor: list[float] = number_list((0, 1, 0, 1), "[-10, 10]", (4,))
    size: list[float] = number_list((), "(0, 1]", (0, 3))
    file: str = path_field()
    free: float = 1.0


@dataclass
class Job:
    name: str = "job"
    files: list[str] = path_list()
    motion: Motion = field(default_factory=Motion)
    dry: bool = False
    options: dict[str, typing.Any] = field(default_factory=dict)


def read(text: str) -> Job:
    tree = read_tree(text, "f.yaml")
    check_tree(tree, Job, "f.yaml")
    return build(Job, tree, "f.yaml")


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("speed", 0, "is 0: it must be above 0 and at most 10"),
        ("speed", 10.1, "is 10.1: it must be above 0"),
        ("speed", math.nan, "is nan"),
        ("speed", math.inf, "is inf"),
        ("speed", np.float64(-1), "is -1.0"),
        ("speed", True, "is True: it must be a number above 0"),
        ("speed", None, "is None: it must be a number"),
        ("free", math.nan, "is nan: it must be finite"),
        ("looks", 0, "is 0: it must be from 1 to 100"),
        ("looks", 101, "is 101: it must be from 1 to 100"),
        ("looks", 2.5, "is 2.5: it must be a whole number"),
        ("looks", True, "is True: it must be a whole number"),
        ("kind", "bent", "is 'bent': choose one of straight, curved"),
        ("floor", [0, 1, 0], "is [0, 1, 0]: it must be 4 numbers"),
        ("floor", [0, math.nan, 0, 1], "is [0, nan, 0, 1]: each"),
        ("floor", "0101", "is '0101': it must be a list"),
        ("size", [1, 1], "is [1, 1]: it must be 0 or 3 numbers"),
        ("size", [1, 1, 0], "is [1, 1, 0]: each must be above 0"),
    ],
)
def test_what_is_out_of_range_is_named(
    key: str, value: object, said: str
) -> None:
    job = Job(motion=Motion(looks=np.int64(5), speed=np.float32(0.5)))
    check(job, "f.yaml")  # NumPy's numbers are numbers
    setattr(job.motion, key, value)
    with pytest.raises(ConfigurationError) as caught:
        check(job, "f.yaml")
    assert str(caught.value).startswith(f"f.yaml: motion.{key}")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    "text", ["[1, 0]", "[0, 0]", "[0, inf]", "(-inf, 1]", "[0, nan]", "0..1"]
)
def test_an_interval_has_two_ends(text: str) -> None:
    with pytest.raises(ValueError, match=r"0|1"):
        Interval.of(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "motion: {sped: 1}",
            "unknown key motion.sped; did you mean motion.sp",
        ),
        ("motion: 3", "motion is 3: it must be keys and values"),
        ("motion:", "motion is None: it must be keys and values"),
        ("motion: {speed: yes}", "motion.speed is True: it must be a number"),
        ("motion: {speed: 1:30}", "motion.speed is '1:30': it must be a numb"),
        ("motion: {speed: .nan}", "motion.speed is nan: it must be above 0"),
        ("motion: {looks: 2.0}", "motion.looks is 2.0: it must be a whole"),
        ("motion: {looks: 010}", "motion.looks is '010': it must be a whole"),
        ("motion: {floor: 3}", "motion.floor is 3: it must be a list"),
        ("motion: {floor: [0, a]}", "motion.floor[1] is 'a': it must be a num"),
        ("files: [1]", "files[0] is 1: it must be text"),
        ("dry: 1", "dry is 1: it must be true or false"),
        ("options: [1]", "options is [1]: it must be keys and values"),
        ("name: a\nname: b", "the key 'name' stands twice"),
        ("motion: {speed: 1, speed: 2}", "the key 'speed' stands twice"),
        ("- name", "its top level must be keys and values, not list"),
        ("3", "its top level must be keys and values, not int"),
        ("!Job {name: a}", "its top level must be keys and values, not !Job"),
        ("name: [", "is not YAML"),
        ("name: !Text a", "is not YAML"),
        ("name: !!python/object/apply:os.mkdir [a]", "is not YAML"),
        ("&a [*a]", "top level"),
    ],
)
def test_what_cannot_be_read_names_key_and_file(text: str, said: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        read(text)
    message = str(caught.value)
    assert message.startswith("f.yaml")
    assert "\n" not in message
    assert said in message


def test_what_can_be_read() -> None:
    assert read("") == Job()
    job = read(
        "name: 2026-01-01\nfiles: [a, /b]\nmotion: {speed: 1e-3, looks: 0x10, "
        "floor: [-.5, 5e-1, -1, 1]}\noptions: {widths: [1, 2]}"
    )
    assert job.name == "2026-01-01"
    assert job.files == ["a", "/b"]
    assert (job.motion.speed, job.motion.looks) == (1e-3, 16)
    assert job.motion.floor == [-0.5, 0.5, -1, 1]
    assert job.options == {"widths": [1, 2]}
    speed = read("motion: {speed: 2}").motion.speed
    assert type(speed) is float


def test_paths_become_absolute(tmp_path: Path) -> None:
    job = Job(files=["a", "/b", "../c"], motion=Motion(file="d"))
    found = with_paths(job, tmp_path)
    assert found.files == [f"{tmp_path}/a", "/b", f"{tmp_path}/../c"]
    assert found.motion.file == f"{tmp_path}/d"
    assert job.files == ["a", "/b", "../c"]
    assert with_paths(Job(), tmp_path) == Job()


_TEXT = st.text(st.characters(exclude_categories=["Cs"]))
_SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | _TEXT
    | st.sampled_from(["1e-3", "010", "1:30", "yes", "null", "~", "2026-01-01"])
)


@given(
    st.dictionaries(
        _TEXT.filter(lambda key: key not in ("_tag", "<<")),
        st.recursive(
            _SCALARS,
            lambda inner: st.lists(inner) | st.dictionaries(_TEXT, inner),
            max_leaves=8,
        ),
        max_size=4,
    )
)
def test_what_is_written_is_read(tree: dict) -> None:
    assert read_tree(write_tree(tree), "f.yaml") == tree


def _configurations() -> list[type]:
    """Finds every dataclass of the package that is a configuration."""
    waiting: list[type] = [Scenario, TrainConfig]
    root = Path(xray_drake.__file__).parent
    ends = ("Config", "Parameters", "Sampling", "Noise", "Augmentation", "Spec")
    for path in root.rglob("*.py"):
        parts = path.relative_to(root).with_suffix("").parts
        waiting += [
            getattr(importlib.import_module(f"xray_drake.{'.'.join(parts)}"), n)
            for n in re.findall(r"^class (\w+)", path.read_text("utf-8"), re.M)
            if n.endswith(ends)
        ]
    known: list[type] = []
    while waiting:
        kind = waiting.pop()
        if kind in known or not is_struct(kind):
            continue
        known.append(kind)
        for inner in fields_of(kind).values():
            waiting += [inner, *typing.get_args(inner)]
    names = {schema.__name__ for schema in known}
    assert names > {"GripperSpec", "DepthNoise", "FovDegrees"}
    return known


_UNUSED = (
    "Uniform",
    "Gaussian",
    "Deterministic",
    "_Invalid",
    "RenderEngine",
    "LightParameter",
    "SsaoParameter",
    "EquirectangularMap",
)
"""Parts of Drake's structs that a scenario refuses: random poses, engines."""


@pytest.mark.parametrize(
    "schema", _configurations(), ids=lambda schema: schema.__qualname__
)
def test_every_number_has_a_range(schema: type) -> None:
    if schema.__name__.startswith(_UNUSED):
        pytest.skip("a scenario cannot hold it")
    rules = rules_of(schema, DRAKE_RULES)
    if schema.__name__ == "SimulatorConfig":
        assert isinstance(rules["integration_scheme"], Choice)
    for name, kind in fields_of(schema).items():
        if kind == dict[str, float]:
            continue  # CellGripper.complaints looks at each
        wanted = {int, float, np.ndarray} & {kind, *typing.get_args(kind)}
        if not wanted:
            continue
        rule = rules.get(name)
        assert rule is not None, f"{schema.__qualname__}.{name} has no range"
        if isinstance(rule, Interval):
            assert rule.whole == (wanted == {int}), name
        elif typing.get_origin(kind) is list or np.ndarray in wanted:
            assert isinstance(rule, Numbers), name
        assert rule.broken_by(math.nan)
