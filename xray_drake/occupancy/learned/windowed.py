"""Two small networks in one: for a target that is hidden, and for one seen."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor, nn

from xray_drake.occupancy.learned.compact import CompactNet
from xray_drake.occupancy.learned.inputs import SIZE_FEATURES


class WindowedNet(nn.Module):
    """A :class:`CompactNet` for whole images, and one for windows of them.

    A target of which nothing is seen can be anywhere: ``whole`` looks at all
    of the image. One that is partly seen is near what is seen of it
    (:func:`~.window.target_window`): ``near`` looks at that window alone, a
    fourteenth of the image on average. So it can be several times as wide and
    still answer in less time; and it needs to be, since it has to tell a
    target's pose from a few pixels and to draw it sharply.
    """

    def __init__(
        self,
        whole: Mapping[str, Any] | None = None,
        near: Mapping[str, Any] | None = None,
        *,
        size_features: int = len(SIZE_FEATURES),
    ) -> None:
        """Makes the layers.

        Args:
            whole: ``widths`` and ``depths`` of the network for whole images;
                by default :class:`CompactNet`'s.
            near: those of the one for windows.
            size_features: length of the vector that describes the target.
        """
        super().__init__()
        self.whole = _part(whole or {}, size_features)
        self.near = _part(near or NEAR, size_features)

    def forward(self, fine: Tensor, coarse: Tensor, size: Tensor) -> Tensor:
        """Returns logits for windows; for whole images ask ``whole``.

        Args:
            fine: (B, 2, h, w), see ``GeometryInput``; h and w are multiples of
                32.
            coarse: (B, 3, h/4, w/4).
            size: (B, 5), see ``size_features``.

        Returns:
            (B, 2, h, w): logits of ``compact.OUTPUTS``.
        """
        answer: Tensor = self.near(fine, coarse, size)
        return answer

    def fused(self) -> "WindowedNet":
        """Returns a copy for inference: both parts ``CompactNet.fused``."""
        net = copy.deepcopy(self).eval()
        net.whole, net.near = net.whole.fused(), net.near.fused()
        return net


NEAR: Mapping[str, Sequence[int]] = {
    "widths": (64, 80, 96, 128),
    "depths": (2, 2, 2, 1),
}
"""Of the part for windows."""


def _part(options: Mapping[str, Any], size_features: int) -> CompactNet:
    return CompactNet(size_features, **options)
