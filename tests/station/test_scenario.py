import pickle
import re
from copy import deepcopy
from dataclasses import replace
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
from pydrake.common.schema import Rotation, Transform
from pydrake.common.yaml import yaml_dump_typed
from pydrake.geometry import Rgba
from pydrake.systems.sensors import CameraConfig

from xray_drake.cell.cameras import pinhole_camera, sample_camera
from xray_drake.cell.drake_rules import DRAKE_RULES
from xray_drake.configuration import fields_of, is_struct, rules_of
from xray_drake.ranges import Choice, Interval, Numbers
from xray_drake.station import scenario as scenario_module
from xray_drake.station.scenario import (
    Scenario,
    ScenarioError,
    check_scenario,
    dump_scenario,
    load_scenario,
    parse_scenario,
    record_scenario,
    scenario_names,
)

SOURCE = "my/own.yaml"


def whole(scenario: Scenario) -> str:
    """Config structs have no equality; their dumps do."""
    return yaml_dump_typed(scenario, schema=Scenario)


def complaint(text: str) -> str:
    """Returns what is said of a bad scenario: one line that names the file."""
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, SOURCE)
    message = str(caught.value)
    assert message.startswith(SOURCE)
    assert "\n" not in message
    return message


PACKAGE = {
    "demo": {
        "scene.target": "box_2to1",
        "scene.num_objects": 14,
        "perception.occupancy": "learned",
        "policy.min_visible_pixels": 50,
    },
    "table2": {
        "scene.num_objects": 14,
        "scene.heap.arrangement": "one_by_one",
        "scene.split": "test",
        "scene.packaged": True,
        "scene.packaged_share": pytest.approx(13 / 59, abs=1e-5),
        "scene.most_visible": 0.9,
        "perception.detector": "ground_truth",
        "perception.segmenter": "ground_truth",
        "gripper.grasps": "models",
        "gripper.execution": "quasi_static",
    },
    "table3": {
        "scene.target": "box_2to1",
        "scene.num_objects": 24,
        "scene.heap.arrangement": "dump",
        "scene.split": "test",
        "scene.most_visible": 0.9,
        "perception.detector": "hsv",
        "perception.segmenter": "depth",
        "perception.noise": True,
        "gripper.grasps": "depth",
        "gripper.execution": "contact",
        # Weak grasps are tried before strong ones on what hides less.
        "policy.min_grasp_quality": pytest.approx(0.05, abs=0.049),
    },
}


@pytest.mark.parametrize("name", PACKAGE)
def test_scenarios_are_as_the_protocol_says(name: str) -> None:
    scenario = load_scenario(name)
    expected = {"name": name, "horizon": 10, "policy.target_first": True}
    for path, value in (expected | PACKAGE[name]).items():
        assert attrgetter(path)(scenario) == value, path
    scenario.scene.target = "domino"
    check_scenario(scenario)


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_of_the_package_loads(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    check_scenario(scenario)


def test_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("seed: 3\nscene:\n  target: lid\n")
    for name in (path, str(path)):
        scenario = load_scenario(name)
        assert (scenario.seed, scenario.scene.target) == (3, "lid")
        assert scenario.scene.num_objects == Scenario().scene.num_objects


@pytest.mark.parametrize("text", ["", "# nothing\n", "{}"])
def test_what_is_not_said_has_its_default(text: str) -> None:
    assert whole(parse_scenario(text, SOURCE)) == whole(Scenario())


def test_settings_deep_inside() -> None:
    scenario = parse_scenario(
        """
        scene: {heap: {rest_motion: 1e-3}}
        camera: {width: 320, X_PB: {translation: [0, 0, 0.9]}}
        gripper: {depth_planner: {judgement: {clearance: 0.004}}}
        """,
        SOURCE,
    )
    assert scenario.scene.heap.rest_motion == 1e-3
    assert (scenario.camera.width, scenario.camera.height) == (320, 384)
    planner = scenario.gripper.depth_planner
    assert planner.judgement.clearance == 0.004
    assert planner.max_checks == Scenario().gripper.depth_planner.max_checks


COMPLAINTS = r"""
horizn: 3 | horizn | did you mean horizon?
camera: {widht: 320} | cell.overhead.widht | mean cell.overhead.width?
seed: 1\nhorizon: 2\nseed: 2 | stands twice
{ | not YAML
- a\n- b | top level | list
scene: {target: spoon} | scene.target | 'spoon' | box_1to1 | lid | domino
    | flute | cube | mug
perception: {geometric: {poses: upright}} | geometric.poses | 'upright'
    | flat, resting
policy: {name: greedy} | policy.name | xray, largest, random
perception: {detector: eye} | perception.detector | 'eye' | hsv
perception: {segmenter: eye} | perception.segmenter | depth
perception: {occupancy: eye} | perception.occupancy | geometric
perception: {occupancy: geometric_label, geometric: {poses: resting}}
    | perception.geometric.poses is resting | occupancy: geometric
gripper: {grasps: eye} | gripper.grasps | models, depth
gripper: {execution: eye} | gripper.execution | quasi_static, contact
gripper: {carrier: crane} | gripper.carrier | wrist, arm
{gripper: {execution: contact}, plant_config: {contact_model: point}}
    | execution is contact | contact_model is 'point'
{gripper: {execution: contact},
    plant_config: {discrete_contact_approximation: tamsi}}
    | execution is contact | discrete_contact_approximation
plant_config: {contact_model: soft} | contact_model | 'soft'
perception: {dtype: float16} | perception.dtype | 'float16' | float32, bfloat16
scene: {num_objects: 0} | scene.num_objects is 0: it must be from 1
horizon: 0 | horizon is 0: it must be from 1
seed: -1 | seed is -1: it must be from 0
perception: {occupancy: geometric_label, geometric: {rotations: 24}}
    | perception.geometric.rotations is 24 | multiple
camera: {name: ''} | cell.overhead.name
camera: {renderer_class: RenderEngineGl} | RenderEngineGl
policy: xray | policy
scene: {split: all} | scene.split is 'all': choose one of train
scene: {heap: {arrangement: pile}}
    | scene.heap.arrangement is 'pile': choose one of one_by_one, dump
scene: {random_number: {mean: 12, least: 16, most: 15}}
    | scene.random_number.least is 16: it must be at most 15
scene: {random_number: {mean: -1}}
    | scene.random_number.mean is -1: it must be from 0 to 100
scene: {mesh_scale: 0} | scene.mesh_scale is 0
scene: {most_visible: 90} | scene.most_visible is 90: it must be from 0 to 1
scene: {packaged: true, packaged_share: -0.1}
    | scene.packaged_share is -0.1: it must be from 0 to 1
scene: {packaged_share: 0.2} | scene.packaged_share needs packaged: true
gripper: {quasi_static: {approach_time: 0}} | quasi_static.approach_time is 0
gripper: {contact: {touch_speed: 0}} | gripper.contact.touch_speed is 0
perception: {depth_segmenter: {arm: 0}} | depth_segmenter.arm is 0
perception: {geometric: {rotations: 0}} | geometric.rotations is 0
scene: {heap: {max_attempts: 0}} | scene.heap.max_attempts is 0
scene: {contact: {tumble_time: 0}} | scene.contact.tumble_time is 0
perception: {exact: {cell: 0}} | perception.geometric.cell is 0
simulator_config: {accuracy: -1} | simulator_config.accuracy is -1
simulator_config: {integration_scheme: foo}
    | simulator_config.integration_scheme is 'foo': choose one of
plant_config: {penetration_allowance: 0} | penetration_allowance is
plant_config: {contact_surface_representation: x} | choose one of t
plant_config: {time_step: 5} | plant_config.time_step is 5
camera: {z_far: .nan} | cell.overhead.z_far is nan
camera: {z_near: 4} | cell.overhead.z_near is 4.0: it must be at most 3.0
camera: {focal: {x: -1}} | cell.overhead.focal.x is -1
camera: {focal: !FovDegrees {x: 200}} | cell.overhead.focal.x is 200
camera: {focal: !Fov {x: 50}} | cell.overhead.focal is tagged !Fov
camera: {width: 512.5} | cell.overhead.width is 512.5: it must be a whole
camera: {center_x: left} | cell.overhead.center_x is 'left'
camera: {background: {rgba: [2, 0, 0, 1]}} | background.rgba is [2
camera: {X_PB: {translation: [0, a, 1]}} | X_PB.translation[1] is
camera: {X_PB: {translation: [0, 1]}} | cell.overhead.X_PB.translation
camera: {output_delay: 0.1} | cell.overhead.output_delay is 0.1
camera: {X_PB: {rotation: !Rpy {deg: [0, 0, 0]}}} | cell.overhead: X_PB: th
camera: {X_PB: {translation: [0, 0, -1]}} | does not look at the bin
camera: {X_PB: {translation: [0, 0, 4]}} | out of the sensor's range
camera: {X_BD: {translation: [0, 0.1, 0]}} | X_BD is not X_BC
camera_sampling: {least_radius: 2} | least_radius is 2.0: it must be
visualization: {publish_period: 0} | visualization.publish_period
visualization: {publish_contacts: false} | publish_contacts is Fal
gripper: {execution: contact, parameters: {pad_width: 0.02}}
    | cell.gripper.parameters.pad_width is 0.02: the gripper in the plant
gripper: {parameters: {opening: 0.06}} | opening is 0.06
gripper: {contact: {lost: 0.95}} | gripper.contact.lost is 0.95: it
gripper: {planner: {perturbation: {friction_min: 0.6}}}
    | planner.perturbation.friction_min is 0.6: it must be at most 0.5
seed: 9223372036854775808 | seed is 9223372036854775808: it must be
perception: {segmenter: depth} | perception.segmenter is depth
    | gripper.grasps is models
"""
"""What is said of bad YAML: text | words of the message | …"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (row[0].replace("\\n", "\n"), row[1:])
        for line in re.sub(r"\n +", " ", COMPLAINTS.strip()).splitlines()
        for row in [line.split(" | ")]
    ],
)
def test_what_is_said_of_a_bad_scenario(text: str, said: list[str]) -> None:
    message = complaint(text).removeprefix(SOURCE)
    assert said
    for words in said:
        assert words in message


@pytest.mark.parametrize("name", ["nope", "", "/"])
def test_no_such_scenario(name: str) -> None:
    with pytest.raises(ScenarioError, match="demo") as caught:
        load_scenario(name)
    assert repr(name) in str(caught.value)


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"cannot read .*nope\.yaml"):
        load_scenario(tmp_path / "nope.yaml")
    path = tmp_path / "image.yaml"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(ScenarioError, match=r"image\.yaml"):
        load_scenario(path)


def test_a_dump_holds_what_differs() -> None:
    assert dump_scenario(Scenario()).strip() == "{}"
    scenario = Scenario(seed=12)
    scenario.camera.X_PB.translation = [0.1, 0.0, 0.9]
    text = dump_scenario(scenario)
    assert "seed: 12" in text
    assert "0.9" in text
    for usual in ("num_objects", "stiction_tolerance", "rotation"):
        assert usual not in text


def test_a_scenario_made_in_python_is_checked_too() -> None:
    with pytest.raises(ScenarioError, match="scenario: horizon is 0"):
        check_scenario(replace(Scenario(), horizon=0))


def test_a_misspelt_field_is_an_error() -> None:
    scenario = load_scenario("demo")
    with pytest.raises(AttributeError, match="nmae"):
        scenario.policy.nmae = "largest"  # type: ignore[attr-defined]


ODD = ["1e-3", "010", "null", "~", "yes", "!Rpy {}", "- a", "#", "2026-01-01"]


def _another(value: object, rule: object) -> object:
    """Returns what a field may be, and is not."""
    if isinstance(rule, Choice):
        return next(name for name in rule.names if name != value)
    if isinstance(rule, Interval) and rule.whole:
        return next(n for n in (rule.high, rule.low) if n != value)
    if isinstance(rule, Interval):
        return 0.3 * rule.low + 0.7 * rule.high
    if isinstance(rule, Numbers):
        return [_another(None, rule.each)] * rule.lengths[-1]
    if isinstance(value, list):
        return ODD
    return not value if isinstance(value, bool) else f"{value} # no comment"


def _change(config: object) -> None:
    """Gives each field another value, but for Drake's unions of structs."""
    rules = rules_of(type(config), DRAKE_RULES)
    for name in fields_of(type(config)):
        value = getattr(config, name)
        if is_struct(value) and not isinstance(value, Transform | Rgba):
            _change(value)
        elif name in rules or isinstance(value, bool | str | list):
            setattr(config, name, _another(value, rules.get(name)))


@pytest.mark.parametrize(
    ("rotation", "focal"),
    [
        (Rotation.Identity(), CameraConfig.FovDegrees(x=50.0)),
        (Rotation.Rpy(deg=[175, 5, 1 / 3]), CameraConfig.FocalLength(x=1.5)),
        (Rotation.AngleAxis(angle_deg=-10, axis=[0, 0.6, 0.8]), None),
    ],
)
def test_what_is_written_is_read_again(
    rotation: object, focal: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever differs from the defaults; pickled and copied as well."""
    scenario = Scenario()
    _change(scenario)
    camera = scenario.camera
    camera.X_PB = Transform(
        translation=[0.1, -1e-9, 0.9], rotation=Rotation(value=rotation)
    )
    camera.focal = focal or camera.focal
    camera.background = Rgba(0.1, 0.2, 0.3, 0.4)
    # Whether the camera sees the floor is another matter.
    monkeypatch.setattr(scenario_module, "check_scenario", lambda *a, **k: None)
    read = parse_scenario(dump_scenario(scenario), SOURCE)
    assert whole(read) == whole(scenario)
    for other in (
        read,
        pickle.loads(pickle.dumps(scenario)),
        deepcopy(scenario),
    ):
        assert other == scenario
        assert other.camera is not scenario.camera


def test_every_field_matters_to_equality() -> None:
    scenario, other = Scenario(), Scenario()
    assert scenario == other
    assert scenario != "demo"
    scenario.camera.center_x = None
    other.gripper.planner.judgement.clearance = 0.004
    assert len({*map(whole, (scenario, other, Scenario()))}) == 3
    assert scenario != other != Scenario() != scenario


def test_a_camera_centred_by_null_stays_so() -> None:
    text = "camera: {width: 640, height: 480, center_x: null, center_y: null}"
    asked = parse_scenario(text, SOURCE, searched=False)
    read = parse_scenario(dump_scenario(asked), SOURCE, searched=False)
    wanted = pinhole_camera(asked.camera).intrinsics
    np.testing.assert_array_equal(wanted[:2, 2], [319.0, 239.0])
    np.testing.assert_array_equal(
        pinhole_camera(read.camera).intrinsics, wanted
    )


def test_cameras_are_drawn_around_one_centred_by_null() -> None:
    scenario = load_scenario("paper")
    scenario.camera.center_x = None
    drawn = sample_camera(
        scenario.camera, scenario.camera_sampling, np.random.default_rng(0)
    )
    assert drawn.center_x == pytest.approx(255.5, abs=3.0)


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("scene: {meshes: [in, /out]}\n")
    assert load_scenario(path).scene.meshes == [f"{tmp_path}/in", "/out"]
    assert load_scenario(path).perception.weights == ""


def test_paths_of_records_hold_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scenario = Scenario()
    scenario.scene.meshes = ["in"]
    scenario.perception.weights = "w.safetensors"
    read = parse_scenario(record_scenario(scenario), SOURCE, searched=False)
    assert read.scene.meshes == [f"{tmp_path}/in"]
    assert read.perception.weights == f"{tmp_path}/w.safetensors"
    assert scenario.scene.meshes == ["in"]
