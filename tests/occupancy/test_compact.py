import pytest
import torch
from torch import Tensor, nn

from xray_drake.occupancy.networks.build import build_network
from xray_drake.occupancy.networks.compact import OUTPUTS, CompactNet
from xray_drake.occupancy.networks.inputs import CHANNELS, SIZE_FEATURES

_SMALL = {"widths": (8, 8, 12, 16), "depths": (1, 1, 1, 2)}


def _network(seed: int = 0, **options: object) -> CompactNet:
    """With random weights and statistics, none of them special."""
    torch.manual_seed(seed)
    network = CompactNet(**{**_SMALL, **options})  # type: ignore[arg-type]
    for name, parameter in network.named_parameters():
        if "norm" in name or "modulation" in name:
            nn.init.normal_(parameter, 1.0 * ("weight" in name), 0.3)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.normal_(module.running_mean, 0.0, 0.3)
            nn.init.uniform_(module.running_var, 0.5, 2.0)
    return network


def _inputs(batch: int = 2, shape: tuple[int, int] = (32, 48)) -> list[Tensor]:
    generator = torch.Generator().manual_seed(1)
    return [
        torch.rand(batch, len(CHANNELS), *shape, generator=generator),
        torch.randn(batch, len(SIZE_FEATURES), generator=generator),
    ]


@pytest.mark.parametrize("shape", [(16, 16), (32, 48), (48, 16)])
@pytest.mark.parametrize("batch", [1, 3])
@torch.no_grad()
def test_two_values_for_every_pixel(batch: int, shape: tuple[int, int]) -> None:
    answer = _network().eval()(*_inputs(batch, shape))
    assert answer.shape == (batch, len(OUTPUTS), *shape)
    assert answer.dtype == torch.float32
    assert torch.isfinite(answer).all()


@torch.no_grad()
def test_the_shipped_network_is_small_and_begins_with_empty_images() -> None:
    network = CompactNet().eval()
    count = sum(p.numel() for p in network.parameters())
    assert 1_000_000 < count < 3_000_000
    answer = torch.sigmoid(network(*_inputs(1)))
    assert answer.mean() < 0.15


@pytest.mark.parametrize("shape", [(31, 32), (32, 24), (8, 16), (17, 33)])
def test_sides_that_are_no_multiples_of_16_are_refused(
    shape: tuple[int, int],
) -> None:
    with pytest.raises((RuntimeError, ValueError)):
        _network().eval()(*_inputs(1, shape))


@pytest.mark.parametrize("options", [{}, {"depths": (2, 1, 1, 1)}])
@torch.no_grad()
def test_fusing_changes_no_answer(options: dict[str, object]) -> None:
    network = _network(**options)
    inputs = _inputs()
    network.train()
    state = {name: t.clone() for name, t in network.state_dict().items()}
    fused = network.fused()
    assert network.training
    for name, tensor in network.state_dict().items():
        assert torch.equal(tensor, state[name]), name
    assert not fused.training
    assert not any(isinstance(m, nn.BatchNorm2d) for m in fused.modules())
    expected = network.eval()(*inputs)
    assert expected.std() > 0.1
    torch.testing.assert_close(fused(*inputs), expected, rtol=0, atol=1e-4)


@torch.no_grad()
def test_the_size_matters_once_it_is_learned() -> None:
    image, size = _inputs(1)
    fresh = CompactNet(**_SMALL).eval()
    other = size + torch.eye(len(SIZE_FEATURES))
    images = image.expand(len(other), -1, -1, -1)
    for answer in fresh(images, other):
        torch.testing.assert_close(answer, fresh(image, size)[0])
    network = _network().eval()
    base = network(image, size)[0]
    for name, answer in zip(SIZE_FEATURES, network(images, other), strict=True):
        assert (answer - base).abs().max() > 0.01, name


@torch.no_grad()
def test_images_of_a_batch_do_not_mix_in_use() -> None:
    network = _network().eval()
    image, size = _inputs(3)
    together = network(image, size)
    for i in range(3):
        alone = network(image[i : i + 1], size[i : i + 1])
        torch.testing.assert_close(
            together[i : i + 1], alone, rtol=1e-4, atol=1e-5
        )


@torch.no_grad()
def test_the_mean_alone_tells_a_pixel_of_what_is_far_away() -> None:
    network = _network().eval()
    image, size = _inputs(1, (16, 512))
    changed = image.clone()
    changed[:, :, :, 256:] += 5.0

    def change() -> Tensor:
        before, after = network(image, size), network(changed, size)
        return (after - before)[0, :, :, :64].abs()

    assert change().mean() > 1e-4
    nn.init.zeros_(network.overall.weight)
    assert change().max() == 0


@pytest.mark.parametrize("level", [1, 2, 3])
@torch.no_grad()
def test_each_level_is_joined_to_what_comes_from_below(level: int) -> None:
    network = _network().eval()
    image, size = _inputs(1)
    grow = getattr(network, f"grow{level}")
    before = network(image, size)
    nn.init.zeros_(grow.weight)
    nn.init.zeros_(grow.bias)
    alone = network(image, size)
    assert (alone - before).abs().max() > 0.01
    assert (network(1 - image, size) - alone).abs().max() > 0.01


def test_all_of_it_learns() -> None:
    network = _network().train()
    network(*_inputs()).square().mean().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name


def test_each_answer_learns_from_its_own_loss() -> None:
    network = _network().train()
    for index in range(len(OUTPUTS)):
        network.zero_grad()
        network(*_inputs())[:, index].square().mean().backward()
        gradient = network.head.bias.grad
        assert gradient is not None
        # Pixels of 2 × 2 lie side by side in the channels.
        own = gradient.view(len(OUTPUTS), 4).abs().sum(dim=1) > 0
        assert own.tolist() == [i == index for i in range(len(OUTPUTS))]


@torch.no_grad()
def test_a_seed_decides_the_weights_and_they_the_answer() -> None:
    inputs = _inputs()
    first, again, other = (_network(seed).eval() for seed in (0, 0, 1))
    answer = first(*inputs)
    assert torch.equal(answer, first(*inputs))
    assert torch.equal(answer, again(*inputs))
    assert not torch.equal(answer, other(*inputs))


def test_a_network_is_built_by_its_name_and_options() -> None:
    network = build_network("compact", {"widths": [8, 8, 8, 8]})
    assert isinstance(network, CompactNet)
    assert network.stem.out_channels == 8


@pytest.mark.parametrize(
    ("architecture", "options", "words"),
    [
        ("unet", {}, "no network is called 'unet': compact, fcn_resnet50"),
        ("compact", {"width": 8}, "compact: .*'width'"),
        ("compact", {"widths": [8, 8]}, "unpack"),
        ("compact", {"depths": [1, 1, 1, 1.5]}, "compact: .*float"),
    ],
)
def test_what_cannot_be_built_is_one_line(
    architecture: str, options: dict[str, object], words: str
) -> None:
    with pytest.raises(ValueError, match=words) as error:
        build_network(architecture, options)
    assert "\n" not in str(error.value)
