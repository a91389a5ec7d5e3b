"""Regions of an image, joined where what parts them is weak."""

import heapq
from operator import add
from typing import NamedTuple

import numpy as np

_BACKGROUND = 0


class _Border(NamedTuple):
    """What parts two regions, seen from one of them.

    Attributes:
        length: pairs of adjacent pixels.
        strength: sum over them.
        above: pairs where this region is the higher one, less those where it
            is the lower one.
    """

    length: int = 0
    strength: float = 0.0
    above: int = 0

    @property
    def mean(self) -> float:
        return self.strength / self.length

    def joined(self, other: "_Border") -> "_Border":
        """Returns the two as one."""
        return _Border(*map(add, self, other))

    def turned(self) -> "_Border":
        """Returns the border as the other region sees it."""
        return self._replace(above=-self.above)


class RegionGraph:
    """Regions of an image and the borders between them.

    Borders with the background count for how much of a region is enclosed;
    nothing is joined with the background.
    """

    def __init__(
        self, regions: np.ndarray, strength: np.ndarray, height: np.ndarray
    ) -> None:
        """Finds the borders.

        Args:
            regions: (H, W) integers; 0 is the background, others above.
            strength: (H, W), how much speaks for a border at each pixel; a
                pair of pixels has the larger of its two.
            height: (H, W), tells which of two adjacent pixels is higher.
        """
        # What is not in the image is background, too.
        regions, strength, height = (
            np.pad(image, 1) for image in (regions, strength, height)
        )
        values, flat = np.unique(regions, return_inverse=True)
        self._regions = flat.reshape(regions.shape)
        count = len(values)
        self._area = np.bincount(flat.ravel()).tolist()
        self._joined_to = list(range(count))
        self._borders: list[dict[int, _Border]] = [{} for _ in range(count)]
        self._find_borders(strength, height)

    def join_weak(self, threshold: float) -> None:
        """Joins, the weakest border first, until all are stronger than this.

        A border's strength is the mean over its pairs of pixels, so a gap in
        it does not join what it parts.
        """
        heap = [
            (border.mean, a, b, border.length)
            for a, borders in enumerate(self._borders)
            for b, border in borders.items()
            if _BACKGROUND < a < b
        ]
        heapq.heapify(heap)
        while heap and heap[0][0] < threshold:
            _, a, b, length = heapq.heappop(heap)
            border = self._borders[a].get(b)
            if border is None or border.length != length:
                continue  # has changed since
            a = self._join(a, b)
            for other, border in self._borders[a].items():
                if other != _BACKGROUND:
                    low, high = min(a, other), max(a, other)
                    heapq.heappush(
                        heap, (border.mean, low, high, border.length)
                    )

    def join_small(self, area: int) -> None:
        """Joins what has fewer pixels to the neighbour least parted from it."""
        for region in self._by_area():
            if self._area[region] >= area:
                continue
            neighbours = {
                other: border.mean
                for other, border in self._borders[region].items()
                if other != _BACKGROUND
            }
            if neighbours:
                self._join(min(neighbours, key=neighbours.__getitem__), region)

    def join_hollows(self, enclosed: float) -> None:
        """Joins the inside of bowls to their rims.

        Args:
            enclosed: share of a region's border that it has with one other
                region, which is the higher one along most of it.
        """
        for region in self._by_area():
            borders = self._borders[region]
            whole = sum(border.length for border in borders.values())
            for other, border in borders.items():
                if (
                    other != _BACKGROUND
                    and border.length >= enclosed * whole
                    and border.above < -border.length / 3
                ):
                    self._join(other, region)
                    break

    def labels(self, min_area: int = 1) -> np.ndarray:
        """Returns (H, W) int32: 0, 1, … from the largest region on.

        Args:
            min_area: smaller regions are background, which is −1.
        """
        kept = [
            region
            for region in self._by_area()
            if self._area[region] >= min_area
        ]
        label = {region: i for i, region in enumerate(reversed(kept))}
        table = np.array(
            [
                label.get(self._root(i), -1) if i != _BACKGROUND else -1
                for i in range(len(self._area))
            ],
            np.int32,
        )
        return table[self._regions[1:-1, 1:-1]]

    def _find_borders(self, strength: np.ndarray, height: np.ndarray) -> None:
        count = len(self._area)
        keys, strengths, above = [], [], []
        for first, second in (
            (np.s_[:, :-1], np.s_[:, 1:]),
            (np.s_[:-1], np.s_[1:]),
        ):
            a, b = self._regions[first], self._regions[second]
            differ = a != b
            a, b = a[differ], b[differ]
            keys.append(np.minimum(a, b) * count + np.maximum(a, b))
            strengths.append(
                np.maximum(strength[first], strength[second])[differ]
            )
            higher = np.sign(height[first][differ] - height[second][differ])
            above.append(np.where(a < b, higher, -higher))
        pairs, which = np.unique(np.concatenate(keys), return_inverse=True)
        lengths = np.bincount(which, minlength=len(pairs))
        sums = np.bincount(which, np.concatenate(strengths), len(pairs))
        signs = np.bincount(which, np.concatenate(above), len(pairs))
        for i, pair in enumerate(pairs.tolist()):
            a, b = divmod(pair, count)
            border = _Border(int(lengths[i]), float(sums[i]), int(signs[i]))
            self._borders[a][b] = border
            self._borders[b][a] = border.turned()

    def _join(self, a: int, b: int) -> int:
        """Joins two regions and returns which of the two is left."""
        if len(self._borders[a]) < len(self._borders[b]):
            a, b = b, a
        self._joined_to[b] = a
        self._area[a] += self._area[b]
        del self._borders[a][b]
        for other, border in self._borders[b].items():
            if other == a:
                continue
            whole = self._borders[a].get(other, _Border()).joined(border)
            self._borders[a][other] = whole
            del self._borders[other][b]
            self._borders[other][a] = whole.turned()
        self._borders[b] = {}
        return a

    def _root(self, region: int) -> int:
        while self._joined_to[region] != region:
            region = self._joined_to[region]
        return region

    def _by_area(self) -> list[int]:
        """Returns the regions that are left, the smallest first."""
        return sorted(
            (i for i in range(1, len(self._area)) if self._root(i) == i),
            key=self._area.__getitem__,
        )
