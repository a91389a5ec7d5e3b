"""Geometric inferences that tests share; preparing one takes a while."""

from dataclasses import replace
from functools import cache, partial

import trimesh

from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.targets import target_model

label_inference = partial(GeometricInference, method="geometric_label")


def resting_inference(
    target: ObjectModel, config: GeometricConfig | None = None
) -> GeometricInference:
    config = config or GeometricConfig()
    return GeometricInference(target, replace(config, poses="resting"))


def block(*sides: float) -> ObjectModel:
    mesh = trimesh.creation.box(sides)
    return object_from_pieces("block", [mesh], density=600.0, recenter=False)


@cache
def cup() -> ObjectModel:
    outer = trimesh.creation.cylinder(0.03, 0.07, sections=24)
    inner = trimesh.creation.cylinder(0.026, 0.07, sections=24)
    inner.apply_translation([0, 0, 0.005])
    mesh = trimesh.boolean.difference([outer, inner], engine="manifold")
    return object_from_pieces("cup", [mesh], density=600.0, recenter=False)


TALL = {
    "die": block(0.06, 0.06, 0.06),
    "brick": block(0.07, 0.045, 0.03),
    "cup": cup(),
}
"""Targets that rest on any face."""


@cache
def inference_of(name: str) -> GeometricInference:
    """The usual inference of one of ``TALL``, or of a flat target."""
    if name in TALL:
        return resting_inference(TALL[name])
    return GeometricInference(target_model(name))
