"""Weights that training begins with, in place of random ones."""

from pathlib import Path

import safetensors.torch
from safetensors import SafetensorError
from torch import nn

from xray_drake.occupancy.learned.weights import WeightsError, load_weights
from xray_drake.occupancy.learned.windowed import WindowedNet

_HEAD = "classifier."
"""The backbone has all parameters but these."""

_FOREIGN_HEAD = "fc."
"""What classifies in torchvision's ``resnet50``."""

_COUNTERS = "num_batches_tracked"
"""Older weights are without them, and nothing needs them."""

_WANTED = "torchvision's resnet50 as safetensors"


def begin_with(net: nn.Module, path: Path) -> None:
    """Loads all weights of a network, to be trained further.

    Args:
        net: changed in place. A ``WindowedNet`` takes those of a
            ``CompactNet``, too, as its part for whole images.
        path: of weights that ``xray-drake train`` wrote.

    Raises:
        WeightsError: there are none, or they are another network's; ``net`` is
            then unchanged.
    """
    state, card = load_weights(path)
    if isinstance(net, WindowedNet) and card.architecture == "compact":
        net = net.whole
    own = {name: tensor.shape for name, tensor in net.state_dict().items()}
    if own != {name: tensor.shape for name, tensor in state.items()}:
        raise WeightsError(
            f"{path} cannot be trained further: its network, "
            f"{card.architecture} {card.options}, is not the configuration's; "
            "give that its architecture and options"
        )
    net.load_state_dict(state)


def load_backbone(net: nn.Module, path: Path) -> None:
    """Loads the backbone of an ``FCNResNet50``; its head stays as it is.

    Args:
        net: changed in place.
        path: of a safetensors file, with the names that torchvision's
            ``resnet50`` gives; reading it runs no code.

    Raises:
        WeightsError: there is no such file, or it does not fit; ``net`` is then
            unchanged.
    """
    try:
        state = safetensors.torch.load_file(path)
    except (SafetensorError, OSError) as error:
        raise WeightsError(
            f"no backbone can be read from {path}: {error}; give {_WANTED}"
        ) from error
    found = {
        name: tensor
        for name, tensor in state.items()
        if not name.startswith(_FOREIGN_HEAD)
    }
    own = {
        name: tuple(tensor.shape)
        for name, tensor in net.state_dict().items()
        if not name.startswith(_HEAD)
    }
    for name in sorted(own.keys() | found.keys()):
        if name not in found:
            if name.endswith(_COUNTERS):
                continue
            why = f"it lacks {name}"
        elif name not in own:
            why = f"it has {name}"
        elif (shape := tuple(found[name].shape)) != own[name]:
            why = f"{name} is {shape}, not {own[name]}"
        else:
            continue
        raise WeightsError(f"{path} is no backbone: {why}; give {_WANTED}")
    net.load_state_dict(found, strict=False)
