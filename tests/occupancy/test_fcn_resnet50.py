import pytest
import torch
from torch import nn

from xray_drake.occupancy.learned.fcn_resnet50 import FCNResNet50


@pytest.fixture(scope="module")
def network() -> FCNResNet50:
    """With random weights, none of them special."""
    torch.manual_seed(0)
    network = FCNResNet50()
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.normal_(module.bias, 0.0, 0.5)
    return network.eval()


def _names_of_resnet50() -> set[str]:
    """Names in the state dict of torchvision's ``resnet50``, without ``fc``."""
    pairs = [("conv1", "bn1")]
    for layer, blocks in enumerate((3, 4, 6, 3), 1):
        pairs.append(
            (f"layer{layer}.0.downsample.0", f"layer{layer}.0.downsample.1")
        )
        for block in range(blocks):
            start = f"layer{layer}.{block}"
            pairs += [(f"{start}.conv{i}", f"{start}.bn{i}") for i in (1, 2, 3)]
    of_norm = nn.BatchNorm2d(1).state_dict()
    return {f"{conv}.weight" for conv, _ in pairs} | {
        f"{norm}.{part}" for _, norm in pairs for part in of_norm
    }


@torch.no_grad()
def test_one_value_for_every_pixel(network: FCNResNet50) -> None:
    answer = network(torch.randn(2, 3, 64, 96))
    assert answer.shape == (2, 1, 64, 96)
    assert answer.dtype == torch.float32
    assert torch.isfinite(answer).all()


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((1, 3, 384, 500), "384×500 .* multiples of 32"),
        ((1, 3, 40, 32), "40×32 .* multiples of 32"),
        ((1, 3, 0, 32), "0×32 .* multiples of 32"),
        ((1, 1, 32, 32), r"takes \(B, 3, H, W\), not \(1, 1, 32, 32\)"),
        ((3, 32, 32), r"takes \(B, 3, H, W\), not \(3, 32, 32\)"),
    ],
)
def test_other_shapes_are_refused(
    network: FCNResNet50, shape: tuple[int, ...], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        network(torch.zeros(shape))


def test_it_is_torchvisions_and_takes_its_state_dict(
    network: FCNResNet50,
) -> None:
    ours = network.state_dict()
    names = _names_of_resnet50()
    state = {name: torch.full_like(ours[name], 2) for name in names}
    state |= {
        "fc.weight": torch.zeros(1000, 2048),
        "fc.bias": torch.zeros(1000),
    }
    # torchvision's fcn_resnet50 has 35,322,218: 21 classes, and a second head.
    second_head = 1024 * 256 * 9 + 2 * 256 + (256 + 1) * 21
    one_class = 35_322_218 - second_head - 20 * (512 + 1)
    assert sum(p.numel() for p in network.parameters()) == one_class
    other = FCNResNet50()
    missing, unexpected = other.load_state_dict(state, strict=False)
    assert all(name.startswith("classifier.") for name in missing)
    assert set(unexpected) == {"fc.weight", "fc.bias"}
    assert torch.all(other.layer4[2].conv2.weight == 2)
    assert set(ours) == names | {
        name for name in ours if name.startswith("classifier.")
    }


@pytest.mark.parametrize(("along", "step"), [(2, 32), (3, 32), (3, 8)])
@torch.no_grad()
def test_what_moves_by_a_multiple_of_8_pixels_is_seen_so_much_farther(
    network: FCNResNet50, along: int, step: int
) -> None:
    # A pixel's answer depends on 225 pixels to each side; across the direction
    # of the movement, the border is the same for both.
    reach, size = 225, 544
    shape = [1, 3, 32, 32]
    shape[along] = size + step
    scene = 5 * torch.randn(shape)
    before = network(scene.narrow(along, step, size))
    after = network(scene.narrow(along, 0, size))
    seen = size - step - 2 * reach
    here = before.narrow(along, reach, seen)
    there = after.narrow(along, reach + step, seen)
    contrast = float(here.std())
    torch.testing.assert_close(there, here, rtol=0, atol=1e-3 * contrast)
    # They do not fit everywhere: the answer is no constant.
    elsewhere = after.narrow(along, reach + step - 8, seen)
    assert (elsewhere - here).std() > 0.1 * contrast


def test_all_of_it_learns() -> None:
    torch.manual_seed(0)
    network = FCNResNet50()
    image = torch.randn(2, 3, 64, 64)
    network(image).square().mean().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name
