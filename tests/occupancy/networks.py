"""Small networks that tests share, and their cards."""

from typing import Any, TypeVar

import torch
from torch import Tensor, nn

from xray_drake.occupancy.learned.compact import CompactNet
from xray_drake.occupancy.learned.inputs import FINE
from xray_drake.occupancy.learned.weights import NetworkCard

OPTIONS: dict[str, Any] = {"widths": [8, 8, 8, 8], "depths": [1, 1, 1, 1]}

Net = TypeVar("Net", bound=nn.Module)


def randomized(net: Net) -> Net:
    """Draws weights and statistics, none special; answers vary from 0 to 1."""
    for name, parameter in net.named_parameters():
        if "norm" in name or "modulation" in name:
            nn.init.normal_(parameter, 1.0 * ("norm" in name), 0.3)
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.normal_(module.bias, 0.0, 0.3)
            nn.init.normal_(module.running_mean, 0.0, 0.3)
            nn.init.uniform_(module.running_var, 0.5, 2.0)
        if isinstance(module, CompactNet):
            nn.init.normal_(module.head.weight, 0.0, 1.0)
            nn.init.zeros_(module.head.bias)
    return net.eval()


def compact(seed: int = 0, **options: Any) -> CompactNet:
    torch.manual_seed(seed)
    return randomized(CompactNet(**{**OPTIONS, **options}))


def card(**change: Any) -> NetworkCard:
    fields: dict[str, Any] = {
        "architecture": "compact",
        "options": OPTIONS,
        "input": "geometry",
        "targets": ("box_2to1",),
        "box_size": None,
    }
    return NetworkCard(**{**fields, **change})


PAPERS = {"architecture": "fcn_resnet50", "input": "augmented_depth"}
"""What the paper's network has in its card."""


class Mirror(nn.Module):
    """Answers with the mask that it sees; remembers all that it sees."""

    def __init__(self, gain: float = 1.0, offset: float = 0.0) -> None:
        super().__init__()
        self.gain, self.offset = gain, offset
        self.image = self.coarse = self.size = torch.zeros(0)

    def forward(
        self,
        image: Tensor,
        coarse: Tensor | None = None,
        size: Tensor | None = None,
    ) -> Tensor:
        self.image = image
        if coarse is None or size is None:
            return self.gain * image[:, :1] + self.offset
        self.coarse, self.size = coarse, size
        modal = image[:, [FINE.index("modal")]]
        return torch.cat([40 * modal - 20] * 2, dim=1)
