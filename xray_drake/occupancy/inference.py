"""The one factory of inferences: for a search, an evaluation and a teacher."""

from pathlib import Path

import numpy as np

from xray_drake.choices import (
    DTYPES,
    OCCUPANCIES,
    WITHOUT_NETWORK,
    current_occupancy,
)
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.occupancy.learned.inference import (
    default_weights,
    load_inference,
)
from xray_drake.occupancy.observation import OccupancyModel
from xray_drake.occupancy.scaled import ScaledInference
from xray_drake.scene.object_model import ObjectModel


def make_inference(
    name: str,
    target: ObjectModel | np.ndarray,
    *,
    floor: Floor | None = None,
    geometric: GeometricConfig | None = None,
    weights: Path | None = None,
    dtype: str = DTYPES[0],
    scaling: bool = True,
    scale: float = 1.0,
) -> OccupancyModel:
    """Prepares what infers where a target can be.

    Args:
        name: one of :data:`xray_drake.choices.OCCUPANCIES`.
        target: what is searched for. To a network, the (3,) length, width and
            thickness of its bounding box, m, will do.
        floor: inside of the bin's; by default the nominal bin's.
        geometric: the numbers of geometric inference.
        weights: of a network, or a folder of networks of one box each; by
            default those that travel with the package.
        dtype: what a network computes in, one of
            :data:`xray_drake.choices.DTYPES`.
        scaling: a network of a single box sees an image that is scaled until
            the target is as large as its box; otherwise the image as it is.
        scale: of the sides of images before they are looked at, in (0, 1].

    Raises:
        ValueError: no such name, a number that is out of range, no model where
            one is needed, or something that the network has not got.
        WeightsError: there are no weights, or they are not this package's.
    """
    name = current_occupancy(name)
    if name not in OCCUPANCIES:
        raise ValueError(
            f"no inference is called {name!r}: choose one of "
            f"{', '.join(OCCUPANCIES)}"
        )
    model: OccupancyModel
    if name not in WITHOUT_NETWORK:
        model = load_inference(
            weights or default_weights(),
            target_size=target.extents
            if isinstance(target, ObjectModel)
            else target,
            output="posterior" if name == "posterior" else "occupancy",
            scaling=scaling,
            dtype=dtype,
            floor=floor,
        )
    elif not isinstance(target, ObjectModel):
        raise ValueError(
            f"{name} inference needs the target's model, not its size alone"
        )
    else:
        model = GeometricInference(target, geometric, name, floor=floor)
    return model if scale == 1.0 else ScaledInference(model, scale)
