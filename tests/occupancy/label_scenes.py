"""Random scenes for the label: a target in any pose, clutter and bin walls."""

from dataclasses import dataclass

import numpy as np
import trimesh

from tests.occupancy.brute_force import render
from tests.occupancy.scenes import make_camera, occluders
from xray_drake.choices import TARGET_NAMES
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.scene.targets import target_model

KINDS = ("hidden", "partly", "visible")


@dataclass(frozen=True, eq=False)
class Sample:
    """What the label is computed from, and what it shows."""

    target_depth: np.ndarray
    scene_depth: np.ndarray
    camera: PinholeCamera
    p_WT: np.ndarray
    observed: np.ndarray | None

    @property
    def inputs(self) -> tuple:
        return self.target_depth, self.scene_depth, self.camera, self.p_WT

    @property
    def amodal(self) -> np.ndarray:
        return np.isfinite(self.target_depth)


def draw_camera(rng: np.random.Generator) -> PinholeCamera:
    """Draws a camera as PROTOCOL.md samples them; every fourth is nominal."""
    if rng.random() < 0.25:
        return make_camera()
    u, v = rng.uniform(-3, 3, 2)
    return make_camera(
        radius=rng.uniform(0.7, 0.9),
        tilt=rng.uniform(0, 10),
        azimuth=rng.uniform(0, 360),
        roll=rng.uniform(-10, 10),
        focal_length=rng.uniform(535, 560),
        center=(255.5 + u, 191.5 + v),
    )


def pose_target(
    name: str, xy: np.ndarray, yaw: float, tilt: float, about: float
) -> tuple[trimesh.Trimesh, np.ndarray]:
    """Stands a target on the floor, leaning.

    Args:
        name: of the target.
        xy: (2,) of its body origin, m.
        yaw: turn about the vertical, rad.
        tilt: angle of its z axis from the vertical, rad.
        about: direction of the horizontal axis it leans about, rad.

    Returns:
        The mesh in the world and its body origin.
    """
    mesh = target_model(name).visual.copy()
    turn = trimesh.transformations.rotation_matrix
    mesh.apply_transform(turn(yaw, [0, 0, 1]))
    mesh.apply_transform(turn(tilt, [np.cos(about), np.sin(about), 0]))
    p_WT = np.array([*xy, -mesh.bounds[0, 2]])
    mesh.apply_translation(p_WT)
    return mesh, p_WT


def walls() -> list[trimesh.Trimesh]:
    """Returns the four walls of the bin."""
    return [
        trimesh.creation.box(bounds=[low, high])
        for low, high in (
            ([-0.27, -0.22, 0.0], [-0.25, 0.22, 0.12]),
            ([0.25, -0.22, 0.0], [0.27, 0.22, 0.12]),
            ([-0.25, -0.22, 0.0], [0.25, -0.20, 0.12]),
            ([-0.25, 0.20, 0.0], [0.25, 0.22, 0.12]),
        )
    ]


def lid_over(mesh: trimesh.Trimesh, margin: float) -> trimesh.Trimesh:
    """Returns a thick plate right over a mesh, larger by ``margin`` (m)."""
    low, high = mesh.bounds
    return trimesh.creation.box(
        bounds=[
            [*(low[:2] - margin), high[2] + 0.002],
            [*(high[:2] + margin), high[2] + 0.012],
        ]
    )


def render_target(camera: PinholeCamera, mesh: trimesh.Trimesh) -> np.ndarray:
    """Renders a target alone; inf where it is not."""
    depth, label = render(camera, [mesh])
    return np.where(label == 0, depth, np.float32(np.inf))


def draw_sample(seed: int) -> Sample:
    """Draws a sample; seeds go round the three kinds."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % 3]
    name = str(rng.choice(TARGET_NAMES))
    camera = draw_camera(rng)
    tilt = 0.0 if rng.random() < 0.5 else np.deg2rad(rng.uniform(0, 60))
    xy = rng.uniform([-0.15, -0.12], [0.15, 0.12])
    yaw, about = rng.uniform(0, 2 * np.pi, 2)
    mesh, p_WT = pose_target(name, xy, yaw, tilt, about)
    target_depth = render_target(camera, mesh)
    amodal = np.isfinite(target_depth)

    scene = walls()
    scene += occluders(rng, rng.integers(3, 9), -0.3 * xy, 0.05, 0.0)
    if kind == "partly":
        side = rng.uniform(0.3, 0.9) * mesh.extents[:2].max()
        block = lid_over(mesh, 0.0)
        block.apply_translation(
            [*(side * np.array([np.cos(about), np.sin(about)])), 0]
        )
        scene.append(block)
    if kind == "hidden":
        margin = rng.uniform(0.01, 0.04)
        scene.append(lid_over(mesh, margin))
        scene += occluders(rng, 4, xy, 0.04, 0.01)
    depth, _ = render(camera, scene)
    if kind == "hidden":
        # Perspective lets it peep out under its lid: widen that.
        while not (depth < target_depth - 0.001)[amodal].all():
            margin += 0.01
            scene.append(lid_over(mesh, margin))
            depth, _ = render(camera, scene)
    if rng.random() < 0.2:
        v, u = rng.integers([0, 0], np.array(camera.shape) - 60)
        blind = np.zeros(camera.shape, bool)
        blind[v : v + 60, u : u + 60] = True
        if kind == "hidden":
            blind &= ~amodal
        depth[blind] = rng.choice([0.0, np.inf, np.nan])
    observed = None
    if kind == "partly" and rng.random() < 0.5:
        # What a detector says: a pixel here and there is wrong.
        seen = amodal & ~(depth < target_depth)
        observed = seen ^ (amodal & (rng.random(camera.shape) < 0.03))
    return Sample(target_depth, depth, camera, p_WT, observed)
