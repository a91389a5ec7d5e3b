"""Which poses explain what is seen of a target."""

from dataclasses import dataclass

import torch

from xray_drake.occupancy.geometric.config import GeometricConfig

SLACK = 0.05
"""Candidates this close to acceptance are drawn once more, exactly."""


@dataclass(frozen=True)
class AcceptanceRule:
    """Which candidates are accepted.

    Attributes:
        config: the numbers.
        size: pixels of the observed mask.
        typical: pixels of a silhouette.
    """

    config: GeometricConfig
    size: int
    typical: float

    @property
    def fragment(self) -> bool:
        """The mask is too small to measure an IoU by."""
        return self.size < self.config.fragment_share * self.typical

    def least_common(self, most: float, slack: float = SLACK) -> float:
        """Returns a bound of what accepted candidates share with the mask.

        Args:
            most: what the one that shares most does, pixels.
            slack: see :meth:`accepted`.
        """
        by_coverage = (self.config.accept_coverage - slack) * most
        if self.fragment:
            return by_coverage
        share = self.config.accept_iou - slack
        return min(by_coverage, share * self.config.trusted_iou * self.size)

    def accepted(
        self, common: torch.Tensor, area: torch.Tensor, slack: float = 0.0
    ) -> torch.Tensor:
        """Returns which candidates are accepted, (n,) bool.

        Args:
            common: (n,) pixels of each predicted modal mask within the
                observed.
            area: (n,) pixels of each predicted modal mask.
            slack: taken off each share that is asked for.
        """
        config = self.config
        if not self.fragment:
            iou = common / (area + (self.size - common))
            best = iou.max()
            if best >= config.trusted_iou:
                return iou >= (config.accept_iou - slack) * best
        share = config.accept_coverage - slack
        accepted = common >= share * common.max()
        spill = area - common
        more = (config.accept_spill + slack) * self.typical
        return accepted & (spill <= spill[accepted].min() + more)
