"""The procedural library: household things made from family and number.

An object is called ``family_number``, as in ``bottle_003``. Its name decides
all of it: the generator is seeded from the family's name and the number, so an
object stays the same when families or members are added.
"""

import zlib
from functools import cache

import numpy as np

from xray_drake.scene.colors import distractor_color
from xray_drake.scene.families import FAMILIES
from xray_drake.scene.object_model import ObjectModel, object_from_pieces

MEMBERS_PER_FAMILY = 12


@cache
def object_names(*families: str) -> tuple[str, ...]:
    """Returns the names of the library's objects, family by family.

    Args:
        *families: which families; all where none is named.

    Raises:
        ValueError: a family that does not exist.
    """
    for family in families:
        _check_family(family)
    return tuple(
        f"{family}_{index:03d}"
        for family in families or FAMILIES
        for index in range(MEMBERS_PER_FAMILY)
    )


@cache
def make_object(name: str) -> ObjectModel:
    """Builds an object of the library; takes a few milliseconds.

    Args:
        name: one of ``object_names()``.

    Raises:
        ValueError: the library has no such object.
    """
    family, _, number = name.rpartition("_")
    _check_family(family)
    if name not in object_names(family):
        raise ValueError(
            f"no object is called {name!r}; family {family!r} has "
            f"{family}_000 to {object_names(family)[-1]}"
        )
    rng = np.random.default_rng([zlib.crc32(family.encode()), int(number)])
    solid, density = FAMILIES[family](rng)
    return object_from_pieces(
        name,
        list(solid.surfaces),
        density=density,
        collision=list(solid.hulls),
        color=distractor_color(rng),
    )


def procedural_library() -> tuple[ObjectModel, ...]:
    """Returns all objects of the library, built at the first call."""
    return tuple(make_object(name) for name in object_names())


def _check_family(family: str) -> None:
    if family not in FAMILIES:
        raise ValueError(
            f"no family is called {family!r}; there are {', '.join(FAMILIES)}"
        )
