import pytest
import torch
from torch import Tensor, nn

from tests.occupancy.networks import compact
from xray_drake.occupancy.learned.compact import OUTPUTS, CompactNet
from xray_drake.occupancy.learned.inputs import COARSE, FINE, SIZE_FEATURES

_SMALL = {"widths": (8, 8, 12, 16), "depths": (1, 1, 1, 2)}


def _network(**options: object) -> CompactNet:
    return compact(**{**_SMALL, **options})


def _inputs(batch: int = 2, shape: tuple[int, int] = (64, 96)) -> list[Tensor]:
    generator = torch.Generator().manual_seed(1)
    height, width = shape
    quarter = height // 4, width // 4
    return [
        torch.rand(batch, len(FINE), height, width, generator=generator),
        torch.rand(batch, len(COARSE), *quarter, generator=generator),
        torch.randn(batch, len(SIZE_FEATURES), generator=generator),
    ]


@torch.no_grad()
def test_the_shipped_network_is_small_and_begins_with_empty_images() -> None:
    network = CompactNet().eval()
    count = sum(p.numel() for p in network.parameters())
    assert 1_000_000 < count < 3_000_000
    answer = torch.sigmoid(network(*_inputs(1)))
    assert answer.mean() < 0.15


@pytest.mark.parametrize(
    ("fine", "coarse"),
    [
        *(
            ((h, w), (h // 4, w // 4))
            for h, w in ((31, 32), (32, 48), (36, 64))
        ),
        *(((64, 96), coarse) for coarse in ((1, 1), (16, 1), (8, 12))),
    ],
)
def test_images_that_do_not_fit_are_refused(
    fine: tuple[int, int], coarse: tuple[int, int]
) -> None:
    """Sides are multiples of 32, and four times those of coarse images."""
    images = torch.zeros(1, len(FINE), *fine), torch.zeros(1, 3, *coarse)
    with pytest.raises((RuntimeError, ValueError)):
        _network()(*images, torch.zeros(1, len(SIZE_FEATURES)))


@torch.no_grad()
def test_what_is_sharp_goes_to_the_pixels_it_is_of() -> None:
    network = _network()
    fine, coarse, size = _inputs()
    nn.init.zeros_(network.head.weight)
    assert network.head.bias is not None
    nn.init.normal_(network.head.bias)
    answer = network(fine, coarse, size)
    # 4 × 4 pixels by themselves: rows and columns of blocks, and in them.
    blocks = fine.unflatten(3, (24, 4)).unflatten(2, (16, 4))
    weight = network.sharp.weight.view(len(OUTPUTS), 4, 4, len(FINE), 4, 4)
    expected = torch.einsum("ovuijk,birjck->borvcu", weight, blocks)
    assert network.sharp.bias is not None
    bias = (network.sharp.bias + network.head.bias).view(len(OUTPUTS), 4, 4)
    expected += bias[None, :, None, :, None, :]
    assert answer.std() > 0.1
    torch.testing.assert_close(
        answer, expected.reshape(answer.shape), rtol=0, atol=1e-5
    )


@torch.no_grad()
def test_every_pixel_of_every_image_is_seen() -> None:
    network = _network()
    nn.init.zeros_(network.sharp.weight)
    images = _inputs(1, (32, 32))
    before = network(*images)
    for index in range(2):
        shape = images[index].shape[1:]
        side = shape[1] // 8
        for channel in range(shape[0]):
            for v in range(side):
                for u in range(side):
                    changed = [image.clone() for image in images]
                    changed[index][:, channel, 3 * side + v, 4 * side + u] += 3
                    change = (network(*changed) - before).abs()
                    assert change.max() > 1e-3, (index, channel, v, u)


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
    for i, answer in enumerate(expected):
        (alone,) = fused(*(each[i : i + 1] for each in inputs))
        torch.testing.assert_close(alone, answer, rtol=0, atol=1e-4)
    with pytest.raises(ValueError, match="one image, not for 2"):
        fused(*inputs)


@torch.no_grad()
def test_the_size_matters_once_it_is_learned() -> None:
    *image, size = _inputs(1)
    fresh = CompactNet(**_SMALL).eval()
    other = size + torch.eye(len(SIZE_FEATURES))
    images = [each.expand(len(other), -1, -1, -1) for each in image]
    for answer in fresh(*images, other):
        torch.testing.assert_close(answer, fresh(*image, size)[0])
    network = _network()
    base = network(*image, size)[0]
    answers = network(*images, other)
    for name, answer in zip(SIZE_FEATURES, answers, strict=True):
        assert (answer - base).abs().max() > 0.01, name


@torch.no_grad()
def test_the_mean_alone_tells_a_pixel_of_what_is_far_away() -> None:
    network = _network()
    fine, coarse, size = _inputs(1, (32, 1024))
    other_fine, other_coarse = fine.clone(), coarse.clone()
    other_fine[:, :, :, 512:] += 5.0
    other_coarse[:, :, :, 128:] += 5.0

    def change() -> Tensor:
        before = network(fine, coarse, size)
        after = network(other_fine, other_coarse, size)
        return (after - before)[0, :, :, :128].abs()

    assert change().mean() > 1e-4
    nn.init.zeros_(network.overall.weight)
    assert change().max() == 0


@pytest.mark.parametrize("level", [1, 2, 3])
@torch.no_grad()
def test_each_level_is_joined_to_what_comes_from_below(level: int) -> None:
    network = _network()
    # Only by way of the features.
    nn.init.zeros_(network.sharp.weight)
    fine, coarse, size = _inputs(1)
    grow = getattr(network, f"grow{level}")
    before = network(fine, coarse, size)
    nn.init.zeros_(grow.weight)
    nn.init.zeros_(grow.bias)
    alone = network(fine, coarse, size)
    assert (alone - before).abs().max() > 0.01
    for other in ((1 - fine, coarse), (fine, 1 - coarse)):
        assert (network(*other, size) - alone).abs().max() > 0.01


def test_all_of_it_learns() -> None:
    network = _network().train()
    network(*_inputs()).square().mean().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name
