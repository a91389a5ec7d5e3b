"""Parametric families of household objects, all unions of convex pieces."""

from xray_drake.scene.families import (
    blocks,
    containers,
    household,
    mechanical,
    tools,
    toys,
    unseen,
)
from xray_drake.scene.families.family import Family

TRAINING_FAMILIES: dict[str, Family] = {
    **containers.FAMILIES,
    **tools.FAMILIES,
    **blocks.FAMILIES,
    **mechanical.FAMILIES,
    **household.FAMILIES,
    **toys.FAMILIES,
}
"""Families of the training and validation splits by their name."""

TEST_FAMILIES: dict[str, Family] = unseen.FAMILIES
"""Families of the test split by their name."""

FAMILIES: dict[str, Family] = {**TRAINING_FAMILIES, **TEST_FAMILIES}
"""Every family by its name."""

__all__ = ["FAMILIES", "TEST_FAMILIES", "TRAINING_FAMILIES", "Family"]
