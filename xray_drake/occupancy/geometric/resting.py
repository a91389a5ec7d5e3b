"""▲ Exact inference for a target that is tall and may lie on any face.

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
from xray_drake.occupancy.geometric.blocks import Blocks
from xray_drake.occupancy.geometric.config import ExactInferenceConfig
from xray_drake.occupancy.geometric.pose_counting import PoseCounting
from xray_drake.occupancy.geometric.pose_search import pose_range
from xray_drake.occupancy.geometric.seen import AcceptanceRule
from xray_drake.occupancy.geometric.standing import StandingTarget
from xray_drake.occupancy.geometric.standing_kernels import (
    Drawing,
    View,
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

_SLACK = 0.05
"""Candidates this close to acceptance are drawn once more, each where it is."""

_EXACT_MOST = 20_000
"""Up to so many of them."""


class RestingInference(PoseCounting):
    """Finds where a target can be that rests on any of its faces.

    As :class:`xray_drake.occupancy.geometric.flat.ExactInference`, with three
    differences. The candidates are all resting poses
    (:func:`xray_drake.geometry.resting.resting_poses`) at every pixel and
    orientation; each counts with the probability of its pose and with the area
    of the floor that its pixel stands for. What a candidate would show is
    decided pixel by pixel, by the height of its own surface there in true
    perspective, so that its sides count, and what only hides its foot does not
    hide its top. And it must keep inside the bin's walls, while its image may
    reach beyond the floor's, as the top of a tall thing at a wall does.

    Where part of the target is seen, candidates are accepted relative to the
    best IoU over all resting poses: those that cannot explain what is seen are
    out.
    """

    def __init__(
        self,
        target: ObjectModel,
        config: ExactInferenceConfig | None = None,
    ) -> None:
        """Finds the resting poses.

        Args:
            target: what is searched for.
            config: the numbers.

        Raises:
            ValueError: no rotation, a step that is not positive, or a target
                without a resting pose.
        """
        config = config or ExactInferenceConfig()
        if config.rotations < 1 or config.seen_step <= 0:
            raise ValueError(
                f"need at least one rotation and a positive step, not "
                f"{config.rotations} and {config.seen_step}"
            )
        x_low, x_high, y_low, y_high = config.floor
        self.bodies = tuple(
            StandingTarget(target.visual, target.p_OCom, pose)
            for pose in resting_poses(
                target.visual, target.p_OCom, least_share=config.least_share
            )
        )
        super().__init__(
            config,
            Floor((x_low, x_high), (y_low, y_high)),
            lowest=min(body.height for body in self.bodies),
            tallest=max(body.height for body in self.bodies),
        )

    def angles(self, body: StandingTarget) -> np.ndarray:
        """Returns the (k,) orientations of one that is hidden, rad."""
        return body.angles(self.config.rotations)

    def seen_angles(self, body: StandingTarget) -> np.ndarray:
        """Returns the (k,) orientations of one that is seen, rad."""
        rotations = self.config.rotations
        steps = 2 * np.pi * body.radius / self.config.seen_step
        return body.angles(rotations, max(1, int(np.ceil(steps / rotations))))

    def _possible(self, mask: np.ndarray, camera: PinholeCamera) -> np.ndarray:
        planes = self._floor.half_planes(self.config.floor_tolerance)
        result = np.zeros(camera.shape, dtype=bool)
        for height in (0.0, self._tallest):
            xy = camera.unproject(camera.plane_depth(height))[..., :2]
            result |= (xy @ planes[:, :2].T <= planes[:, 2]).all(axis=-1)
        return result & mask

    def _count_hidden(
        self, heights: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
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
                drawing = body.drawing(angle, view, reach)
                count_hidden(
                    observed,
                    blocks.corners,
                    blocks.side,
                    HIDDEN_STEP,
                    weights,
                    config.blank_tolerance,
                    drawing,
                    body.room(
                        drawing.vertices, self._floor, config.floor_tolerance
                    ),
                    change,
                )
        return _summed(change)

    def _count_seen(
        self, heights: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        view = View.of(camera)
        # Where the target is observed, it shows.
        shows = with_neighbours(np.where(mask, np.float32(-np.inf), heights))
        running = np.zeros((camera.height, camera.width + 1), dtype=np.int32)
        np.cumsum(mask, axis=1, out=running[:, 1:])
        first = self._first_tries(mask, camera)
        seen = shows, running, self._typical(first, view), view
        coarse = self._compare(first, *seen, HIDDEN_STEP, _MARGIN)
        if coarse is None:
            return mask.astype(np.float32)
        fine = self._compare(self._finer(first, coarse), *seen, 1, _SLACK)
        if fine is None:
            return mask.astype(np.float32)
        exact = [tried.alone(accepted) for tried, accepted in fine]
        if sum(len(tried.blocks.corners) for tried in exact) > _EXACT_MOST:
            # So many that none decides alone.
            exact = [tried for tried, _ in fine]
        chosen = self._compare(exact, *seen, 1, 0.0)
        if chosen is None:
            return mask.astype(np.float32)
        change = np.zeros((camera.height, camera.width + 1))
        for tried, accepted in chosen:
            turns = len(self.seen_angles(tried.body))
            add_accepted(
                accepted,
                tried.blocks.weights(tried.body, camera) / turns,
                tried.blocks.corners,
                tried.blocks.side,
                1,
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
        self,
        tries: list["_Tried"],
        shows: np.ndarray,
        running: np.ndarray,
        typical: float,
        view: View,
        step: int,
        slack: float,
    ) -> list[tuple["_Tried", np.ndarray]] | None:
        """Compares candidates with the observed mask.

        Args:
            tries: bodies in an orientation, and where.
            shows: heights of the observed surface, −inf in the mask, as from
                ``with_neighbours``.
            running: (H, W + 1) sums of the mask along each row.
            typical: area of a silhouette, pixels.
            view: the camera.
            step: between candidates, pixels.
            slack: taken off each share that is asked for.

        Returns:
            Those with accepted candidates, and (b, n, n) bool which these are;
            None where none meets the mask.
        """
        config, size = self.config, int(running[:, -1].sum())
        counts = [
            count_common(
                running,
                tried.blocks.corners,
                tried.blocks.side,
                step,
                tried.drawing(view),
                tried.room(self._floor, config.floor_tolerance),
            )
            for tried in tries
        ]
        most = max((int(common.max()) for common in counts), default=0)
        if most <= 0:
            return None
        rule = AcceptanceRule(config, size, typical)
        least = (config.accept_coverage - slack) * most
        if not rule.fragment:
            share = config.accept_iou - slack
            least = min(least, share * config.trusted_iou * size)
        # The most promising first: others are then soon found to be worse.
        order = sorted(range(len(tries)), key=lambda k: -int(counts[k].max()))
        order = [k for k in order if counts[k].max() >= least]
        limits = np.array(
            [
                size,
                config.accept_iou - slack,
                config.trusted_iou,
                (config.accept_spill + slack) * typical,
                rule.fragment,
            ]
        )
        best = np.array([0.0, np.inf])
        shown = [
            count_shown(
                shows,
                counts[k],
                least,
                tries[k].blocks.corners,
                tries[k].blocks.side,
                step,
                limits,
                best,
                tries[k].drawing(view),
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
        found = []
        first = 0
        for k, candidates in zip(order, near, strict=True):
            last = first + int(np.count_nonzero(candidates))
            chosen: np.ndarray = np.zeros(candidates.shape, dtype=bool)
            np.place(chosen, candidates, accepted[first:last].numpy())
            first = last
            if chosen.any():
                found.append((tries[k], chosen))
        return found

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
