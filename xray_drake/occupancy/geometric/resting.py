"""▲ The poses of a target that is tall and may lie on any face.

The paper names such targets as its first failure: "objects that are
significantly non-planar. Currently, the assumption that the object is flat can
result in incorrect occupancy distributions for taller objects" (section VI).
"""

from dataclasses import dataclass

import numpy as np
import torch

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.geometry.resting import resting_poses
from xray_drake.occupancy.geometric.acceptance import SLACK, AcceptanceRule
from xray_drake.occupancy.geometric.blocks import Blocks
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.pose_search import pose_range
from xray_drake.occupancy.geometric.standing import StandingTarget
from xray_drake.occupancy.geometric.standing_drawing import Drawing, View
from xray_drake.occupancy.geometric.standing_kernels import (
    PoseGrid,
    add_accepted,
    count_common,
    count_hidden,
    count_shown,
    with_neighbours,
)
from xray_drake.scene.object_model import ObjectModel

HIDDEN_STEP = 2
"""Pixels between the candidates of a target that is not seen, and of the first
look at one that is."""

_MARGIN = 0.2
"""What candidates of that first look may lack of each share asked for."""

_COARSE = 3
"""Times as large are its blocks of candidates that are drawn once."""

_EXACT_MOST = 20_000
"""Up to so many candidates close to acceptance are drawn where they are."""


class RestingPoses:
    """All resting poses, at every pixel and orientation.

    The poses are those of :func:`xray_drake.geometry.resting.resting_poses`;
    each counts with its probability and with the area of the floor that its
    pixel stands for. What a candidate would show is decided pixel by pixel, by
    the height of its own surface there in true perspective, so that its sides
    count, and what only hides its foot does not hide its top. And it must keep
    inside the bin's walls, while its image may reach beyond the floor's, as
    the top of a tall thing at a wall does.

    Where part of the target is seen, candidates are accepted relative to the
    best IoU over all resting poses: those that cannot explain what is seen are
    out.

    Attributes:
        bodies: the target in each of the poses.
        lowest: least height over the poses, m.
        tallest: greatest, m.
        seen_at: the floor's height, and the greatest, m.
    """

    def __init__(
        self, target: ObjectModel, config: GeometricConfig, floor: Floor
    ) -> None:
        """Finds the resting poses.

        Args:
            target: what is searched for.
            config: the numbers.
            floor: inside of the bin.

        Raises:
            ValueError: a target without a resting pose.
        """
        self.config, self._floor = config, floor
        self.bodies = tuple(
            StandingTarget(target.visual, target.p_OCom, pose)
            for pose in resting_poses(
                target.visual, target.p_OCom, least_share=config.least_share
            )
        )
        self.lowest = min(body.height for body in self.bodies)
        self.tallest = max(body.height for body in self.bodies)
        self.seen_at: tuple[float, ...] = (0.0, self.tallest)

    def angles(self, body: StandingTarget) -> np.ndarray:
        """Returns the (k,) orientations of one that is hidden, rad."""
        return body.angles(self.config.rotations)

    def seen_angles(self, body: StandingTarget) -> np.ndarray:
        """Returns the (k,) orientations of one that is seen, rad."""
        rotations = self.config.rotations
        steps = 2 * np.pi * body.radius / self.config.seen_step
        return body.angles(rotations, max(1, int(np.ceil(steps / rotations))))

    def count_hidden(
        self, heights: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """Sums poses that show nothing; see ``inference.Poses``."""
        config, view = self.config, View.of(camera)
        observed = with_neighbours(heights)
        change = np.zeros((camera.height, camera.width + 1))
        for body in self.bodies:
            blocks = Blocks.on_floor(body, camera, self._floor)
            reach = body.reach(camera, self._floor)
            blocks = blocks.that_hide(body, heights, view, reach)
            if not len(blocks.corners):
                continue
            angles = self.angles(body)
            weights = blocks.weights(body, camera) / len(angles)
            for angle in angles:
                tried = _Tried(body, float(angle), reach, blocks)
                count_hidden(
                    observed,
                    tried.candidates(HIDDEN_STEP),
                    weights,
                    config.blank_tolerance,
                    tried.drawing(view),
                    tried.room(self._floor, config.floor_tolerance),
                    change,
                )
        return _summed(change)

    def count_seen(
        self, heights: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """Sums poses that look as observed; see ``inference.Poses``."""
        running = np.zeros((camera.height, camera.width + 1), dtype=np.int32)
        np.cumsum(mask, axis=1, out=running[:, 1:])
        first = self._first_tries(mask, camera)
        view = View.of(camera)
        typical = self._typical(first, view)
        seen = _Seen(
            # Where the target is observed, it shows.
            with_neighbours(np.where(mask, np.float32(-np.inf), heights)),
            running,
            AcceptanceRule(self.config, int(running[:, -1].sum()), typical),
            view,
        )
        coarse = self._compare(first, seen, HIDDEN_STEP, _MARGIN)
        fine = self._compare(self._finer(first, coarse), seen, 1, SLACK)
        tries = [tried.alone(accepted) for tried, accepted in fine]
        if sum(len(tried.blocks.corners) for tried in tries) > _EXACT_MOST:
            # So many that none decides alone.
            tries = [tried for tried, _ in fine]
        chosen = self._compare(tries, seen, 1, 0.0)
        if not chosen:
            return mask.astype(np.float32)
        change = np.zeros((camera.height, camera.width + 1))
        for tried, accepted in chosen:
            turns = len(self.seen_angles(tried.body))
            add_accepted(
                accepted,
                tried.blocks.weights(tried.body, camera) / turns,
                tried.candidates(1),
                tried.drawing(view),
                change,
            )
        return _summed(change)

    def _first_tries(
        self, mask: np.ndarray, camera: PinholeCamera
    ) -> list["_Tried"]:
        """Returns every body, in as few orientations as if it were hidden."""
        tries = []
        for body in self.bodies:
            reach = body.reach(camera, self._floor)
            blocks = Blocks.over(
                pose_range(mask.sum(axis=1), reach),
                pose_range(mask.sum(axis=0), reach),
                body.block_side(camera, _COARSE),
            )
            tries += [
                _Tried(body, float(angle), reach, blocks)
                for angle in self.angles(body)
            ]
        return tries

    def _finer(
        self,
        tries: list["_Tried"],
        found: list[tuple["_Tried", np.ndarray]],
    ) -> list["_Tried"]:
        """Returns what to look at more closely.

        Args:
            tries: all that were compared.
            found: those of them that came near, and where.

        Returns:
            In all orientations up to the next of those tried, the blocks in
            which something came near in the one before or after.
        """
        near = {
            (tried.body, tried.angle): tried.alone(accepted, HIDDEN_STEP)
            for tried, accepted in found
        }
        finer = []
        for body in self.bodies:
            of_body = [tried for tried in tries if tried.body is body]
            steps = len(of_body)
            angles = self.seen_angles(body)
            for i, angle in enumerate(angles):
                around = {
                    i * steps // len(angles),
                    -(-i * steps // len(angles)),
                }
                places = [
                    near[body, of_body[k % steps].angle].blocks.corners
                    for k in around
                    if (body, of_body[k % steps].angle) in near
                ]
                if places:
                    blocks = Blocks.around(
                        np.concatenate(places),
                        of_body[0].blocks.side // _COARSE,
                    )
                    finer.append(
                        _Tried(body, float(angle), of_body[0].reach, blocks)
                    )
        return finer

    def _compare(
        self, tries: list["_Tried"], seen: "_Seen", step: int, slack: float
    ) -> list[tuple["_Tried", np.ndarray]]:
        """Compares candidates with the observed mask.

        Args:
            tries: bodies in an orientation, and where.
            seen: what is observed.
            step: between candidates, pixels.
            slack: taken off each share that is asked for.

        Returns:
            Those with accepted candidates, and (b, n, n) bool which these are;
            none where none meets the mask.
        """
        config, rule, size = self.config, seen.rule, seen.rule.size
        counts = [
            count_common(
                seen.running,
                tried.candidates(step),
                tried.drawing(seen.view),
                tried.room(self._floor, config.floor_tolerance),
            )
            for tried in tries
        ]
        most = max((int(common.max()) for common in counts), default=0)
        if most <= 0:
            return []
        least = rule.least_common(most, slack)
        # The most promising first: others are then soon found to be worse.
        order = sorted(range(len(tries)), key=lambda k: -int(counts[k].max()))
        order = [k for k in order if counts[k].max() >= least]
        limits = np.array(
            [
                size,
                config.accept_iou - slack,
                config.trusted_iou,
                (config.accept_spill + slack) * rule.typical,
                rule.fragment,
            ]
        )
        best = np.array([0.0, np.inf])
        shown = [
            count_shown(
                seen.shows,
                counts[k],
                least,
                tries[k].candidates(step),
                limits,
                best,
                tries[k].drawing(seen.view),
            )
            for k in order
        ]
        near = [np.asarray(counts[k] >= max(least, 1)) for k in order]
        common = _joined([counts[k] for k in order], near)
        area = _joined(shown, near)
        accepted = rule.accepted(common, area, slack)
        if slack > 0 and not rule.fragment:
            # Perhaps, looked at more closely, the best can be trusted.
            iou = common / (area + (size - common))
            accepted |= iou >= (config.accept_iou - slack) * iou.max()
        ends = np.cumsum([np.count_nonzero(candidates) for candidates in near])
        parts = np.split(accepted.numpy(), ends[:-1])
        for candidates, part in zip(near, parts, strict=True):
            candidates[candidates] = part
        return [
            (tries[k], chosen)
            for k, chosen in zip(order, near, strict=True)
            if chosen.any()
        ]

    def _typical(self, tries: list["_Tried"], view: View) -> float:
        """Returns the mean area of a silhouette, pixels.

        Args:
            tries: all orientations of each body.
            view: the camera.
        """
        areas, weights = [], []
        for tried in tries:
            corners, side = tried.blocks.corners, tried.blocks.side
            middle = (corners.min(axis=0) + corners.max(axis=0) + side) // 2
            drawn = tried.body.draw(
                tried.angle, middle[::-1], view, tried.reach
            )
            areas.append(np.count_nonzero(drawn >= 0))
            weights.append(
                tried.body.probability / len(self.angles(tried.body))
            )
        return float(np.average(areas, weights=weights))


@dataclass(frozen=True, eq=False)
class _Seen:
    """What is observed of a target that is seen.

    Attributes:
        shows: heights of the observed surface, −inf in the mask, as from
            ``with_neighbours``.
        running: (H, W + 1) sums of the mask along each row.
        rule: which candidates are accepted.
        view: the camera.
    """

    shows: np.ndarray
    running: np.ndarray
    rule: AcceptanceRule
    view: View


@dataclass(frozen=True, eq=False)
class _Tried:
    """A body in one orientation, and where its axis may be.

    Attributes:
        body: the body.
        angle: its turn about the vertical, rad.
        reach: half width of its drawing, pixels.
        blocks: where its axis may be.
    """

    body: StandingTarget
    angle: float
    reach: int
    blocks: Blocks

    def alone(self, chosen: np.ndarray, step: int = 1) -> "_Tried":
        """Returns the (b, n, n) bool ``chosen`` candidates, each drawn alone.

        They are ``step`` pixels apart.
        """
        block, row, column = np.nonzero(chosen)
        within = step * np.column_stack([row, column])
        corners = self.blocks.corners[block] + within
        blocks = Blocks(np.ascontiguousarray(corners), 1)
        return _Tried(self.body, self.angle, self.reach, blocks)

    def candidates(self, step: int) -> PoseGrid:
        """Returns what the loops take them as, ``step`` pixels apart."""
        return PoseGrid(self.blocks.corners, self.blocks.side, step)

    def room(self, floor: Floor, slack: float) -> np.ndarray:
        """Returns (4,) bounds of its axis; see ``StandingTarget.room``."""
        return self.body.room(self.body.turned(self.angle), floor, slack)

    def drawing(self, view: View) -> Drawing:
        """Returns what the loops draw it by."""
        return self.body.drawing(self.angle, view, self.reach)


def _joined(counts: list[np.ndarray], chosen: list[np.ndarray]) -> torch.Tensor:
    """Returns the chosen counts one after another, float32."""
    parts = [c[n] for c, n in zip(counts, chosen, strict=True)]
    return torch.from_numpy(np.concatenate(parts).astype(np.float32))


def _summed(change: np.ndarray) -> np.ndarray:
    """Adds differences up along the rows; returns (H, W) float32."""
    total = np.cumsum(change, axis=1)[:, :-1]
    # What is left over of differences that cancel.
    total[total < 1e-9 * max(float(total.max()), 1e-30)] = 0
    return total.astype(np.float32)
