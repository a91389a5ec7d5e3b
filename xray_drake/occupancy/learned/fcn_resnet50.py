"""The paper's network: fully convolutional, on a ResNet-50 (section IV.B).

The paper cites Long et al. (2015) and says no more of the head. The code that
its authors published (github.com/BerkeleyAutomation/xray, ``xray/model.py``)
takes ``torchvision.models.segmentation.fcn_resnet50`` with one class, and so
do we, layer by layer: the backbone's last two stages are dilated, not strided,
so that features stay at 1/8 (Chen et al. 2017); the head is two convolutions;
its output is scaled up 8 times, bilinearly. There are no skip connections.
"""

from torch import Tensor, nn
from torch.nn import functional

SIZE_STEP = 32
"""Height and width of the input are multiples of it: the stride of ResNet-50
where nothing is dilated."""

_DROPOUT = 0.1


class FCNResNet50(nn.Module):
    """Image to occupancy distribution; 32,946,753 parameters.

    The output is the head's linear one: nothing bounds it, and nothing needs
    to, since it is trained by the squared distance to the label. Who wants a
    distribution clips it to the label's range. (The authors' labels and images
    are bytes, 0 to 255, and their loss is the mean over the pixels; their
    learning rate belongs to those. Their backbone starts from ImageNet, as
    torchvision's did unless told otherwise.)

    Parameters are called what torchvision's ``resnet50`` calls them (``conv1``,
    ``bn1``, ``layer1.0.conv1``, …), so its state dict is loaded by
    ``load_state_dict(state, strict=False)``: the head (``classifier.…``) is
    missing from it and ``fc.…`` is left over. Made anew, the backbone has
    Kaiming's initial weights, the head PyTorch's.
    """

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        self.layer1 = _stage(64, 64, [1, 1, 1])
        self.layer2 = _stage(256, 128, [1, 1, 1, 1], stride=2)
        # Stride 2 is traded for dilation, from the second block on.
        self.layer3 = _stage(512, 256, [1, 2, 2, 2, 2, 2])
        self.layer4 = _stage(1024, 512, [2, 4, 4])
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(
                    module.weight, mode="fan_out", nonlinearity="relu"
                )
        self.classifier = nn.Sequential(
            nn.Conv2d(2048, 512, 3, padding=1, bias=False),
            nn.BatchNorm2d(512),
            nn.ReLU(),
            nn.Dropout(_DROPOUT),
            nn.Conv2d(512, 1, 1),
        )

    def forward(self, image: Tensor) -> Tensor:
        """Predicts.

        Args:
            image: (B, 3, H, W) float32, the augmented depth less its mean over
                the dataset; H and W multiples of :data:`SIZE_STEP`.

        Returns:
            (B, 1, H, W) float32, in the unit of the label; not bounded.

        Raises:
            ValueError: the image has another shape.
        """
        _check_shape(image)
        # image: (B, 3, H, W)
        x = self.conv1(image)  # (B, 64, H/2, W/2)
        x = functional.relu(self.bn1(x))
        x = self.maxpool(x)  # (B, 64, H/4, W/4)
        x = self.layer1(x)  # (B, 256, H/4, W/4)
        x = self.layer2(x)  # (B, 512, H/8, W/8)
        x = self.layer3(x)  # (B, 1024, H/8, W/8)
        x = self.layer4(x)  # (B, 2048, H/8, W/8)
        x = self.classifier(x)  # (B, 1, H/8, W/8)
        x = functional.interpolate(
            x, size=image.shape[-2:], mode="bilinear", align_corners=False
        )
        return x  # (B, 1, H, W)


class Bottleneck(nn.Module):
    """Narrow, look around, widen, add (He et al. 2016, figure 5, right).

    The 3×3 convolution takes the stride, as in torchvision ("ResNet v1.5").
    """

    def __init__(
        self, channels: int, width: int, *, stride: int, dilation: int
    ) -> None:
        """Makes the layers.

        Args:
            channels: of the input.
            width: channels of the 3×3 convolution; the output has 4 times as
                many.
            stride: of the 3×3 convolution.
            dilation: of the 3×3 convolution.
        """
        super().__init__()
        out = 4 * width
        self.conv1 = nn.Conv2d(channels, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(
            width,
            width,
            3,
            stride=stride,
            padding=dilation,
            dilation=dilation,
            bias=False,
        )
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, out, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(out)
        self.downsample: nn.Module = nn.Identity()
        if stride > 1 or channels != out:
            self.downsample = nn.Sequential(
                nn.Conv2d(channels, out, 1, stride=stride, bias=False),
                nn.BatchNorm2d(out),
            )

    def forward(self, x: Tensor) -> Tensor:
        """Maps (B, channels, h, w) to (B, 4·width, h', w'), h' = h/stride."""
        y = functional.relu(self.bn1(self.conv1(x)))  # (B, width, h, w)
        y = functional.relu(self.bn2(self.conv2(y)))  # (B, width, h', w')
        y = self.bn3(self.conv3(y))  # (B, 4·width, h', w')
        return functional.relu(y + self.downsample(x))


def _stage(
    channels: int, width: int, dilations: list[int], *, stride: int = 1
) -> nn.Sequential:
    """One block per dilation; the first takes the stride."""
    blocks = []
    for i, dilation in enumerate(dilations):
        blocks.append(
            Bottleneck(
                channels if i == 0 else 4 * width,
                width,
                stride=stride if i == 0 else 1,
                dilation=dilation,
            )
        )
    return nn.Sequential(*blocks)


def _check_shape(image: Tensor) -> None:
    shape = tuple(image.shape)
    if len(shape) != 4 or shape[1] != 3:
        raise ValueError(f"the network takes (B, 3, H, W), not {shape}")
    height, width = shape[2:]
    if height % SIZE_STEP or width % SIZE_STEP or not height or not width:
        raise ValueError(
            f"an image of {height}×{width} does not fit the network: height "
            f"and width must be multiples of {SIZE_STEP}; pad it, or scale it"
        )
