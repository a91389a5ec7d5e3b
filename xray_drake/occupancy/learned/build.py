"""Networks by their architecture's name."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import nn

from xray_drake.occupancy.learned.compact import CompactNet
from xray_drake.occupancy.learned.fcn_resnet50 import FCNResNet50
from xray_drake.occupancy.learned.windowed import WindowedNet

ARCHITECTURES: Mapping[str, Callable[..., nn.Module]] = {
    "compact": CompactNet,
    "fcn_resnet50": FCNResNet50,
    "windowed": WindowedNet,
}


def channels_last(net: nn.Module) -> nn.Module:
    """Lays a network's weights out as convolutions on a CPU are fastest."""
    for parameter in net.parameters():
        if parameter.ndim == 4:
            parameter.data = parameter.data.contiguous(
                memory_format=torch.channels_last
            )
    return net


def build_network(architecture: str, options: Mapping[str, Any]) -> nn.Module:
    """Makes a network with weights drawn at random.

    Raises:
        ValueError: no such architecture, or options that it does not take.
    """
    if architecture not in ARCHITECTURES:
        raise ValueError(
            f"no network is called {architecture!r}: "
            f"{', '.join(sorted(ARCHITECTURES))}"
        )
    try:
        return ARCHITECTURES[architecture](**options)
    except TypeError as error:
        raise ValueError(f"{architecture}: {error}") from error
