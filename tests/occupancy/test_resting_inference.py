"""Exact inference over all resting poses against brute force, and laws."""

import numpy as np
import pytest
import trimesh

from tests.occupancy.brute_force import RestingBruteForce, render
from tests.occupancy.scenes import make_camera, occluders
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.blocks import Blocks
from xray_drake.occupancy.exact_config import ExactInferenceConfig
from xray_drake.occupancy.floor_grid import Floor
from xray_drake.occupancy.resting_inference import (
    HIDDEN_STEP,
    RestingInference,
)
from xray_drake.occupancy.standing import StandingTarget
from xray_drake.scene.object_model import ObjectModel, object_from_pieces

# Few orientations and pixels, for the sake of the brute force.
COARSE = ExactInferenceConfig(rotations=8, seen_step=0.02)
SMALL = {
    "nominal": make_camera(
        focal_length=276.25, center=(127.5, 95.5), size=(256, 192)
    ),
    "tilted": make_camera(
        tilt=9,
        azimuth=57,
        roll=5,
        focal_length=276.25,
        center=(127.5, 95.5),
        size=(256, 192),
    ),
}
FLOOR = Floor((-0.25, 0.25), (-0.20, 0.20))


def block(*sides: float) -> ObjectModel:
    mesh = trimesh.creation.box(sides)
    return object_from_pieces("block", [mesh], density=600.0, recenter=False)


def cup() -> ObjectModel:
    outer = trimesh.creation.cylinder(0.03, 0.07, sections=24)
    inner = trimesh.creation.cylinder(0.026, 0.07, sections=24)
    inner.apply_translation([0, 0, 0.005])
    mesh = trimesh.boolean.difference([outer, inner], engine="manifold")
    return object_from_pieces("cup", [mesh], density=600.0, recenter=False)


TARGETS = {
    "die": block(0.06, 0.06, 0.06),
    "brick": block(0.07, 0.045, 0.03),
    "cup": cup(),
}
_INFERENCES: dict[str, RestingInference] = {}


def inference_of(name: str) -> RestingInference:
    if name not in _INFERENCES:
        _INFERENCES[name] = RestingInference(TARGETS[name])
    return _INFERENCES[name]


def placed(
    body: StandingTarget, xy: np.ndarray, angle: float
) -> trimesh.Trimesh:
    return trimesh.Trimesh(
        body.turned(angle) + [*xy, 0.0], body.faces, process=False
    )


def amodal_of(mesh: trimesh.Trimesh, camera: PinholeCamera) -> np.ndarray:
    return render(camera, [mesh])[1] == 0


def roof(xy: np.ndarray, height: float, side: float) -> trimesh.Trimesh:
    plate = trimesh.creation.box([side, side, 0.01])
    return plate.apply_translation([*xy, height + 0.007])


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def poses_at(
    body: StandingTarget,
    pixels: np.ndarray,
    angles: np.ndarray,
    camera: PinholeCamera,
) -> np.ndarray:
    """Returns (n, 3) x, y, angle where the axis is seen at pixels."""
    homogeneous = np.column_stack([pixels, np.ones(len(pixels))])
    ray = homogeneous @ np.linalg.inv(camera.plane_homography(body.middle)).T
    xy = ray[:, :2] / ray[:, 2:]
    return np.concatenate(
        [np.column_stack([xy, np.full(len(xy), a)]) for a in angles]
    )


def near(pixels: np.ndarray, place: np.ndarray, reach: float) -> np.ndarray:
    return pixels[(np.abs(pixels - place) <= reach).all(axis=1)]


SCENES = [
    (name, view, seed)
    for name in TARGETS
    for view in SMALL
    for seed in range(2)
]


@pytest.mark.parametrize(("name", "view", "seed"), SCENES)
def test_hidden_support_agrees_with_brute_force(
    name: str, view: str, seed: int
) -> None:
    target, camera = TARGETS[name], SMALL[view]
    inference = RestingInference(target, COARSE)
    rng = np.random.default_rng(seed)
    body = inference.bodies[seed % len(inference.bodies)]
    xy = rng.uniform([-0.17, -0.12], [0.17, 0.12])
    side = 2 * body.radius + 0.02
    others = occluders(rng, 3, xy, 0.05, 0.0)
    depth, _ = render(camera, [roof(xy, body.height, side), *others])
    nothing = np.zeros(camera.shape, dtype=bool)
    result = inference.infer(depth, nothing, camera)

    place = camera.project(np.array([*xy, body.middle]))[:2]
    poses = [
        poses_at(
            one,
            near(
                Blocks.on_floor(one, camera, FLOOR).pixels(HIDDEN_STEP),
                place,
                60,
            ),
            inference.angles(one),
            camera,
        )
        for one in inference.bodies
    ]
    meshes = [placed(one, np.zeros(2), 0.0) for one in inference.bodies]
    shares = [one.probability for one in inference.bodies]
    truth = RestingBruteForce(meshes, shares, COARSE, depth, nothing, camera)
    expected = truth.infer(poses)
    assert np.count_nonzero(expected) > 100
    assert iou(result.support(), expected > 0) >= 0.96
    either = result.support() | (expected > 0)
    assert np.abs(result.data - expected)[either].mean() <= 0.03


@pytest.mark.parametrize(("name", "view", "seed"), SCENES)
def test_seen_support_agrees_with_brute_force(
    name: str, view: str, seed: int
) -> None:
    target, camera = TARGETS[name], SMALL[view]
    inference = RestingInference(target, COARSE)
    rng = np.random.default_rng(seed)
    body = inference.bodies[seed % len(inference.bodies)]
    xy = rng.uniform([-0.17, -0.12], [0.17, 0.12])
    mesh = placed(body, xy, rng.uniform(0, 2 * np.pi))
    amodal = amodal_of(mesh, camera)
    aside = xy + 0.6 * body.radius * np.array([1, 0.3])
    depth, label = render(
        camera,
        [
            mesh,
            roof(aside, body.height, 1.2 * body.radius),
            *occluders(rng, 2, aside, 0.02, 0.0),
        ],
    )
    mask = label == 0
    assert 0.2 < np.count_nonzero(mask) / amodal.sum() < 0.95
    result = inference.infer(depth, mask, camera)

    place = camera.project(np.array([*xy, body.middle]))[:2]
    around = np.rint(place) + np.array(
        [[u, v] for u in range(-30, 31) for v in range(-30, 31)]
    )
    poses = [
        poses_at(one, around, inference.seen_angles(one), camera)
        for one in inference.bodies
    ]
    meshes = [placed(one, np.zeros(2), 0.0) for one in inference.bodies]
    shares = [one.probability for one in inference.bodies]
    truth = RestingBruteForce(meshes, shares, COARSE, depth, mask, camera)
    expected = truth.infer(poses)
    assert iou(result.support(), expected > 0) >= 0.95
    either = result.support() | (expected > 0)
    assert np.abs(result.data - expected)[either].mean() <= 0.04
