"""A small network for every target size, fast on a CPU."""

import copy
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from xray_drake.occupancy.learned.inputs import (
    COARSE,
    FINE,
    QUARTER,
    SIZE_FEATURES,
)

OUTPUTS = ("occupancy", "posterior")
"""The channels of the output; see :class:`CompactNet`."""


class CompactNet(nn.Module):
    """A U-Net whose blocks are told the target's size.

    It sees geometry (:mod:`xray_drake.occupancy.learned.inputs`) at the
    camera's resolution, works at a quarter of it and below, and answers at the
    camera's: a label has edges as sharp as those of the objects, and an answer
    at half the resolution that is enlarged has lost a fifth of its overlap
    with it before a network has erred. So each feature pixel reads the 4 × 4
    pixels that it stands for, and answers for each of them.
    Two answers come from the same features: the occupancy distribution as the
    paper labels it (where a flat target *could* lie), and the posterior (how
    probable each pixel shows the target, learned from where targets *were*).

    The size enters by a scale and a shift of each block's features
    (feature-wise linear modulation, Perez et al. 2018). At the coarsest level
    the mean over the image is added, since a distribution is relative to its
    maximum, wherever that is.
    """

    def __init__(
        self,
        size_features: int = len(SIZE_FEATURES),
        widths: Sequence[int] = (24, 32, 64, 128),
        depths: Sequence[int] = (1, 1, 2, 3),
    ) -> None:
        """Makes the layers.

        Args:
            size_features: length of the vector that describes the target.
            widths: channels at 1/4, 1/8, 1/16 and 1/32 of the camera's
                resolution.
            depths: blocks at each on the way down; one each on the way up.
        """
        super().__init__()
        w1, w2, w3, w4 = widths
        code = 64
        pixels = QUARTER**2
        self.size_code = nn.Sequential(
            nn.Linear(size_features, code),
            nn.SiLU(),
            nn.Linear(code, code),
            nn.SiLU(),
        )
        self.stem = nn.Conv2d(
            pixels * len(FINE) + len(COARSE), w1, 3, padding=1
        )
        self.down1 = _stage(w1, code, depths[0])
        self.shrink2 = nn.Conv2d(w1, w2, 2, stride=2)
        self.down2 = _stage(w2, code, depths[1])
        self.shrink3 = nn.Conv2d(w2, w3, 2, stride=2)
        self.down3 = _stage(w3, code, depths[2])
        self.shrink4 = nn.Conv2d(w3, w4, 2, stride=2)
        self.down4 = _stage(w4, code, depths[3])
        self.overall = nn.Linear(w4, w4)
        self.grow3 = nn.Conv2d(w4, w3, 1)
        self.up3 = _stage(w3, code, 1)
        self.grow2 = nn.Conv2d(w3, w2, 1)
        self.up2 = _stage(w2, code, 1)
        self.grow1 = nn.Conv2d(w2, w1, 1)
        self.up1 = _stage(w1, code, 1)
        self.head = nn.Conv2d(w1, pixels * len(OUTPUTS), 3, padding=1)
        # What a feature pixel's 4 × 4 pixels show goes to the answer for each
        # without having to pass through the features.
        self.sharp = nn.Conv2d(pixels * len(FINE), pixels * len(OUTPUTS), 1)
        # Most pixels are empty: begin there.
        assert self.head.bias is not None
        nn.init.constant_(self.head.bias, -3.0)

    def forward(self, fine: Tensor, coarse: Tensor, size: Tensor) -> Tensor:
        """Returns logits.

        Args:
            fine: (B, 2, H, W), see ``GeometryInput``; H and W are multiples
                of 32.
            coarse: (B, 3, H/4, W/4).
            size: (B, 5), see ``size_features``.

        Returns:
            (B, 2, H, W): logits of :data:`OUTPUTS`.
        """
        code = self.size_code(size)  # (B, 64)
        x0 = _unshuffled(fine)  # (B, 32, H/4, W/4)
        coarse = coarse.contiguous(memory_format=torch.channels_last)
        x = torch.cat([x0, coarse], dim=1)  # (B, 35, H/4, W/4)
        x1 = self.down1((self.stem(x), code))[0]  # (B, w1, H/4, W/4)
        x2 = self.down2((self.shrink2(x1), code))[0]  # (B, w2, H/8, W/8)
        x3 = self.down3((self.shrink3(x2), code))[0]  # (B, w3, H/16, W/16)
        x4 = self.down4((self.shrink4(x3), code))[0]  # (B, w4, H/32, W/32)
        overall = self.overall(x4.mean(dim=(2, 3)))  # (B, w4)
        x4 = x4 + overall[:, :, None, None]
        x = x3 + _grown(self.grow3(x4))  # (B, w3, H/16, W/16)
        x = x2 + _grown(self.grow2(self.up3((x, code))[0]))  # (B, w2, H/8, …)
        x = x1 + _grown(self.grow1(self.up2((x, code))[0]))  # (B, w1, H/4, …)
        x = self.head(self.up1((x, code))[0]) + self.sharp(x0)
        return nn.functional.pixel_shuffle(x, QUARTER)  # (B, 2, H, W)

    def fused(self) -> "CompactNet":
        """Returns a copy for inference, normalisation within convolutions.

        It answers for one image at a time, and raises ValueError if given
        more.
        """
        net = copy.deepcopy(self).eval()
        for stage in net.children():
            if isinstance(stage, nn.Sequential):
                for i, block in enumerate(stage):
                    if isinstance(block, _Block):
                        stage[i] = _FusedBlock(block)
        return net


class _Block(nn.Module):
    """Two convolutions beside the identity, modulated by the size."""

    def __init__(self, width: int, code: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.norm1 = nn.BatchNorm2d(width)
        self.modulation = nn.Linear(code, 2 * width)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.norm2 = nn.BatchNorm2d(width)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)

    def forward(self, pair: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        x, code = pair  # (B, width, h, w), (B, code)
        scale, shift = self.modulation(code)[:, :, None, None].chunk(2, dim=1)
        y = self.norm1(self.conv1(x))
        y = nn.functional.relu(y * (1 + scale) + shift)
        y = self.norm2(self.conv2(y))
        return nn.functional.relu(x + y), code


class _FusedBlock(nn.Module):
    """The same for one image: all of it is in the convolutions.

    To scale and to shift features takes as long as to convolve them; to scale
    weights takes no time.
    """

    def __init__(self, block: _Block) -> None:
        super().__init__()
        self.conv1 = fuse_conv_bn_eval(block.conv1, block.norm1)
        self.modulation = block.modulation
        self.conv2 = fuse_conv_bn_eval(block.conv2, block.norm2)

    def forward(self, pair: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        x, code = pair  # (1, width, h, w), (1, code)
        if len(code) != 1:
            raise ValueError(
                f"a fused network answers for one image, not for {len(code)}"
            )
        scale, shift = self.modulation(code)[0].chunk(2)  # (width,) each
        assert self.conv1.bias is not None
        y = nn.functional.conv2d(
            x,
            self.conv1.weight * (1 + scale)[:, None, None, None],
            self.conv1.bias * (1 + scale) + shift,
            padding=1,
        )
        y = self.conv2(nn.functional.relu(y))
        return nn.functional.relu(x + y), code


def _stage(width: int, code: int, depth: int) -> nn.Sequential:
    return nn.Sequential(*(_Block(width, code) for _ in range(depth)))


def _unshuffled(image: Tensor) -> Tensor:
    """(B, C, 4h, 4w) to (B, 16 C, h, w), channels last: as pixel_unshuffle."""
    b, c, height, width = image.shape
    h, w = height // QUARTER, width // QUARTER
    cells = image.reshape(b, c, h, QUARTER, w, QUARTER)
    return (
        cells.permute(0, 2, 4, 1, 3, 5).reshape(b, h, w, -1).permute(0, 3, 1, 2)
    )


def _grown(x: Tensor) -> Tensor:
    """(B, C, h, w) to (B, C, 2h, 2w)."""
    return nn.functional.interpolate(x, scale_factor=2, mode="nearest")
