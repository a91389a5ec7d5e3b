"""The procedural library: household things made from family and number.

An object is called ``family_number``, as in ``bottle_003``. Its name decides
all of it: the table ``families/draws.json`` gives the draw that the number
stands for, and the generator is seeded from the family's name and the draw.
The table leaves out draws that look like another object's (``Likeness`` in
``tests/scene/test_library.py``) and says which split an object belongs to.
``bottle_003_packaged`` is the same object on a backing card
(:mod:`xray_drake.scene.packaging`).
"""

import json
import zlib
from dataclasses import replace
from functools import cache
from importlib.resources import files

import numpy as np

from xray_drake.scene.colors import distractor_color
from xray_drake.scene.families import FAMILIES
from xray_drake.scene.object_model import (
    ObjectModel,
    Origin,
    object_from_pieces,
)
from xray_drake.scene.packaging import PACKAGED, packaged_model
from xray_drake.splits import SPLITS

PLAIN_DRAWS = 12
"""The first draws of a family are not stretched: they are as they always
were."""

PACKAGED_OF_SEVEN = (2, 5)
"""Which of seven members come in a package too: 2 more on 7, as the paper's
test set has 13 packaged on 46 others."""


@cache
def object_names(
    *families: str, split: str | None = None, packaged: bool = False
) -> tuple[str, ...]:
    """Returns names of the library's objects, family by family.

    Args:
        *families: which families; where none is named, all of the split.
        split: which split; by default every split of the families named, or
            ``train`` where none is.
        packaged: put the packaged variants after the objects.

    Raises:
        ValueError: a family or split that does not exist.
    """
    for family in families:
        _members(family)
    if split is None and not families:
        split = "train"
    if split is not None and split not in SPLITS:
        raise ValueError(
            f"no split is called {split!r}; there are {', '.join(SPLITS)}"
        )
    names = [
        name
        for family in families or families_of(split)
        for name, (_, belongs) in _members(family).items()
        if split in (None, belongs)
    ]
    if packaged:
        names += [
            name + PACKAGED
            for name in names
            if int(name[-3:]) % 7 in PACKAGED_OF_SEVEN
        ]
    return tuple(names)


@cache
def families_of(split: str | None = None) -> tuple[str, ...]:
    """Returns the families of a split, or all."""
    return tuple(
        family
        for family in FAMILIES
        if any(split in (None, one) for _, one in _members(family).values())
    )


def split_of(name: str) -> str:
    """Returns the split of an object or of a packaged variant.

    Raises:
        ValueError: the library has no such object.
    """
    return _find(name)[1]


@cache
def make_object(name: str) -> ObjectModel:
    """Builds an object of the library; takes a few milliseconds.

    Args:
        name: one of ``object_names()`` of any split, with or without
            ``_packaged``.

    Raises:
        ValueError: the library has no such object.
    """
    draw, _ = _find(name)
    if name.endswith(PACKAGED):
        model = packaged_model(
            make_object(name.removesuffix(PACKAGED)),
            zlib.crc32(name.encode()),
        )
    else:
        model = drawn_object(name, name.rpartition("_")[0], draw)
    return replace(model, origin=Origin(name))


def drawn_object(name: str, family: str, draw: int) -> ObjectModel:
    """Builds an object from a draw, be it in the table or not.

    Args:
        name: the object's.
        family: one of ``FAMILIES``.
        draw: number of the draw, from 0.
    """
    seed = [zlib.crc32(family.encode()), draw]
    rng = np.random.default_rng(seed)
    solid, density = FAMILIES[family](rng)
    color = distractor_color(rng)
    if draw >= PLAIN_DRAWS:
        solid = solid.stretched(FAMILIES[family].factors(rng))
    return object_from_pieces(
        name,
        list(solid.surfaces),
        density=density,
        collision=list(solid.hulls),
        color=color,
    )


@cache
def _members(family: str) -> dict[str, tuple[int, str]]:
    """Maps the names of a family's members to their draw and split.

    Raises:
        ValueError: there is no such family.
    """
    if family not in FAMILIES:
        raise ValueError(
            f"no family is called {family!r}; there are {', '.join(FAMILIES)}"
        )
    path = files("xray_drake.scene.families") / "draws.json"
    table = json.loads(path.read_text(encoding="utf-8")).get(family, {})
    drawn = [(draw, split) for split in SPLITS for draw in table.get(split, [])]
    return {f"{family}_{number:03d}": one for number, one in enumerate(drawn)}


def _find(name: str) -> tuple[int, str]:
    plain = name.removesuffix(PACKAGED)
    family = plain.rpartition("_")[0]
    members = _members(family)
    if plain not in members:
        raise ValueError(
            f"no object is called {name!r}; family {family!r} has "
            f"{family}_000 to {list(members)[-1]}"
        )
    return members[plain]
