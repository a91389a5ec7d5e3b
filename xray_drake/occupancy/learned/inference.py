"""Learned inference of the occupancy distribution, from a file of weights."""

from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import nn

from xray_drake.cell.bin import Bin
from xray_drake.choices import DTYPES
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.learned.augmented_depth import augmented_depth
from xray_drake.occupancy.learned.build import build_network, channels_last
from xray_drake.occupancy.learned.compact import OUTPUTS, CompactNet
from xray_drake.occupancy.learned.fcn_resnet50 import SIZE_STEP
from xray_drake.occupancy.learned.inputs import (
    COARSE,
    FINE,
    QUARTER,
    SIZE_FEATURES,
    geometry_input,
    size_features,
)
from xray_drake.occupancy.learned.single_box import (
    aspect_ratio,
    box_scale,
    nearest_ratio,
    oriented_size,
    rescale_input,
    rescale_output,
)
from xray_drake.occupancy.learned.weights import (
    NetworkCard,
    WeightsError,
    load_weights,
    read_card,
)
from xray_drake.occupancy.learned.window import target_window
from xray_drake.occupancy.learned.windowed import WindowedNet
from xray_drake.occupancy.observation import check_observation
from xray_drake.resources import models_dir

Output = Literal["occupancy", "posterior"]

SUPPORT_THRESHOLD = 0.02
"""A network's answer is support above this (PROTOCOL.md, "Rollout")."""

_SUFFIX = ".safetensors"


class LearnedInference:
    """Asks a network where the target can be.

    A network that is told the target's size sees the image as it is. One that
    was trained on a single box sees it scaled until the target is as large as
    that box, and its answer is scaled back (paper section IV.C, "Target Object
    Scale").
    """

    def __init__(
        self,
        net: nn.Module,
        card: NetworkCard,
        target_size: np.ndarray,
        *,
        output: Output = "occupancy",
        scaling: bool = True,
        dtype: str = DTYPES[0],
        floor: Floor | None = None,
    ) -> None:
        """Prepares a network for a target.

        Args:
            net: with its weights.
            card: what it is.
            target_size: (3,) length, width, thickness of the target's bounding
                box, m.
            output: "occupancy", where a flat target could lie; or
                "posterior", where it probably is (not "fcn_resnet50").
            scaling: scale the image for a network of a single box; otherwise
                it sees it as it is.
            dtype: what it computes in, one of ``DTYPES``. bfloat16 is faster
                on processors that have instructions for it, and changes the
                shipped network's answers by up to 0.18; not "fcn_resnet50".
            floor: inside of the bin's; by default the nominal bin's.

        Raises:
            ValueError: no such output or type, or a network that has not got
                it.
        """
        if dtype not in DTYPES:
            raise ValueError(
                f"no network computes in {dtype!r}: {', '.join(DTYPES)}"
            )
        if output not in OUTPUTS:
            raise ValueError(
                f"no output is called {output!r}: {', '.join(OUTPUTS)}"
            )
        if output != "occupancy" and card.input != "geometry":
            raise ValueError(f"{card.architecture} has no {output}")
        self.card = card
        self.output = output
        self._size = oriented_size(target_size)
        self._floor = floor or Bin().floor
        self._scale = 1.0
        if card.box_size is not None:
            self._scale = box_scale(self._size) if scaling else 1.0
            # In the scaled image it is as large as the box.
            sides = self._scale * np.array(card.box_size[:2])
            self._size = np.array([*sides, self._size[2]])
        self._dtype: torch.dtype = getattr(torch, dtype)
        if isinstance(net, CompactNet | WindowedNet):
            net = net.fused().to(self._dtype)
        elif self._dtype != torch.float32:
            raise ValueError(f"{card.architecture} computes in float32 alone")
        self._net = channels_last(net.eval())
        self._mean = np.array(card.training.get("input_mean", [0.0] * 3))
        self._label_scale = float(card.training.get("label_scale", 1.0))

    def infer(
        self,
        depth: np.ndarray,
        target_mask: np.ndarray,
        camera: PinholeCamera,
    ) -> OccupancyDistribution:
        """Infers where the target can be.

        Args:
            depth: (H, W) float32 z-depth, m; 0, inf and NaN are no reading.
            target_mask: (H, W) bool, the target's modal mask as detected;
                blank where it is not seen.
            camera: of both.

        Returns:
            The network's answer as it is: a label's maximum is 1, an answer's
            may be less, and a posterior's are probabilities.

        Raises:
            ValueError: images of another shape than the camera's, or a depth
                image without any reading.
        """
        mask = np.asarray(target_mask, dtype=bool)
        depth = check_observation(depth, mask, camera)
        return OccupancyDistribution(
            data=self._respond(depth, mask, camera),
            support_threshold=SUPPORT_THRESHOLD,
            method="learned" if self.output == "occupancy" else self.output,
        )

    def _respond(
        self, depth: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """(H, W) float32 in [0, 1]."""
        height, width = camera.shape
        if self._scale != 1.0:
            depth, mask = rescale_input(depth, mask, self._scale)
            camera = camera.zoomed(1 / self._scale)
        depth, mask, camera = _padded(depth, mask, camera)
        if self.card.input == "geometry":
            answer = self._from_geometry(depth, mask, camera)
        else:
            answer = self._from_augmented_depth(depth, mask)
        answer = answer[:height, :width]
        if self._scale != 1.0:
            answer = rescale_output(answer, self._scale)
        return np.clip(answer, 0.0, 1.0)

    def _from_geometry(
        self, depth: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        size = size_features(self._size, mask, camera)
        net = self._net
        if not isinstance(net, WindowedNet):
            return self._asked(net, depth, mask, camera, size)
        if not mask.any():
            return self._asked(net.whole, depth, mask, camera, size)
        window = target_window(mask, size)
        answer = np.zeros(camera.shape, np.float32)
        answer[window.rows, window.columns] = self._asked(
            net.near,
            window.of(depth),
            window.of(mask),
            camera.cropped(window.rows, window.columns),
            size,
        )
        return answer

    def _asked(
        self,
        net: nn.Module,
        depth: np.ndarray,
        mask: np.ndarray,
        camera: PinholeCamera,
        size: np.ndarray,
    ) -> np.ndarray:
        """What a network answers to images, in their shape."""
        images = geometry_input(
            depth, mask, camera, float(self._size[2]), self._floor
        )
        with torch.inference_mode():
            logits = net(
                *(
                    torch.from_numpy(array)[None].to(self._dtype)
                    for array in (*images, size)
                )
            )
            chosen = logits[0, OUTPUTS.index(self.output)]
            return torch.sigmoid(chosen.float()).numpy()

    def _from_augmented_depth(
        self, depth: np.ndarray, mask: np.ndarray
    ) -> np.ndarray:
        image = augmented_depth(depth, mask)
        image -= self._mean.astype(np.float32)[:, None, None]
        with torch.inference_mode():
            answer = self._net(torch.from_numpy(image)[None])
        return answer[0, 0].numpy() / self._label_scale


def _padded(
    depth: np.ndarray, mask: np.ndarray, camera: PinholeCamera
) -> tuple[np.ndarray, np.ndarray, PinholeCamera]:
    """Gives images sides that are multiples of 32, as networks need.

    What is added, below and on the right, has no reading.
    """
    more = [-side % SIZE_STEP for side in camera.shape]
    if not any(more):
        return depth, mask, camera
    added = [(0, n) for n in more]
    height, width = np.add(camera.shape, more).tolist()
    return (
        np.pad(depth, added),
        np.pad(mask, added),
        camera.padded(height, width),
    )


def default_weights() -> Path:
    """Returns the file of the weights that travel with the package."""
    return models_dir() / "networks" / f"windowed{_SUFFIX}"


def load_inference(
    path: Path,
    *,
    target_size: np.ndarray,
    **settings: Any,
) -> LearnedInference:
    """Reads a network from disk and prepares it for a target.

    Args:
        path: of the weights; or a folder of networks of one box each, of which
            the one with the nearest aspect ratio is taken (section IV.C).
        target_size: (3,) length, width, thickness, m.
        settings: output, scaling, dtype and floor of
            :class:`LearnedInference`.

    Raises:
        WeightsError: there are no weights, or they are no network's of this
            package.
        ValueError: an output or type that the network has not got.
    """
    if path.is_dir():
        path = _nearest(path, target_size)
    changed = path.stat().st_mtime_ns if path.is_file() else 0
    net, card = _load(path.resolve(), changed)
    return LearnedInference(net, card, target_size, **settings)


@lru_cache(maxsize=16)
def _load(path: Path, changed: int) -> tuple[nn.Module, NetworkCard]:
    state, card = load_weights(path)
    try:
        net = build_network(card.architecture, card.options)
        net.load_state_dict(state)
        _try(net.eval(), card)
    except (IndexError, RuntimeError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0].rstrip(":")
        raise WeightsError(
            f"{path} does not fit this version's {card.architecture!r} "
            f"network: {reason}; train it again with 'xray-drake train'"
        ) from error
    return net.eval(), card


def _try(net: nn.Module, card: NetworkCard) -> None:
    """Raises RuntimeError or TypeError if a network takes another input."""
    side = SIZE_STEP
    with torch.inference_mode():
        if card.input == "geometry":
            net(
                torch.zeros(1, len(FINE), side, side),
                torch.zeros(1, len(COARSE), side // QUARTER, side // QUARTER),
                torch.zeros(1, len(SIZE_FEATURES)),
            )
        else:
            net(torch.zeros(1, 3, side, side))


def _nearest(folder: Path, target_size: np.ndarray) -> Path:
    by_ratio: dict[float, Path] = {}
    for path in sorted(folder.glob(f"*{_SUFFIX}")):
        box = read_card(path).box_size
        if box is not None:
            by_ratio[aspect_ratio(np.array(box))] = path
    if not by_ratio:
        raise WeightsError(
            f"{folder} holds no network of a single box: make some with "
            "'xray-drake train', or give a file of weights"
        )
    return by_ratio[nearest_ratio(aspect_ratio(target_size), list(by_ratio))]
