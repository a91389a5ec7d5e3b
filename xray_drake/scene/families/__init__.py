"""Parametric families of household objects, all unions of convex pieces."""

from xray_drake.scene.families import blocks, containers, tools
from xray_drake.scene.families.family import Family

FAMILIES: dict[str, Family] = {
    **containers.FAMILIES,
    **tools.FAMILIES,
    **blocks.FAMILIES,
}
"""Every family by its name."""

__all__ = ["FAMILIES", "Family"]
