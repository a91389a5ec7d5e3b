"""The training loop's contents, for Lightning."""

import math
from dataclasses import asdict
from typing import Any

import lightning
import torch
from torch import Tensor, nn

from xray_drake.occupancy.learned.build import channels_last
from xray_drake.training.config import TrainConfig
from xray_drake.training.data import Batch
from xray_drake.training.losses import (
    OccupancyMetrics,
    posterior_loss,
    robust_loss,
)


class OccupancyTraining(lightning.LightningModule):
    """What the training of every network has in common.

    Attributes:
        net: that is trained.
        resolution: of the images that the logged metrics are of, in words.
        unused: keys of the configuration that decide nothing here.
    """

    resolution = "full resolution"
    unused: tuple[str, ...] = ()

    def __init__(self, net: nn.Module, config: TrainConfig, steps: int) -> None:
        """Keeps what it is given.

        Args:
            net: to be trained.
            config: of the run.
            steps: of the optimizer, in all.
        """
        super().__init__()
        self.net = channels_last(net)
        self.metrics = OccupancyMetrics()
        self._config = config
        self._steps = steps

    def facts(self) -> dict[str, Any]:
        """Returns what a card says of the training."""
        return {
            key: value
            for key, value in asdict(self._config).items()
            if key not in self.unused
        }

    def flipped_axes(self) -> list[int]:
        """Draws the axes of (B, C, h, w) along which a step's batch is flipped.

        The seed and the step decide, so a resumed run draws the same.
        """
        if not self._config.flips:
            return []
        generator = torch.Generator().manual_seed(
            self._config.seed * 1_000_003 + self.global_step
        )
        flips = torch.rand(2, generator=generator) < 0.5
        return [axis for axis, flip in zip((2, 3), flips, strict=True) if flip]

    def on_validation_epoch_end(self) -> None:
        """Logs what was counted, on all devices."""
        for name, value in self.metrics.compute().items():
            bar = name != "mass_on_target"
            self.log(f"validation/{name}", value, prog_bar=bar)
        self.metrics.reset()

    def configure_optimizers(self) -> Any:
        """Returns AdamW and its schedule, or SGD."""
        config = self._config
        if config.optimizer == "sgd":
            return torch.optim.SGD(
                self.net.parameters(),
                config.learning_rate,
                momentum=config.momentum,
                weight_decay=config.weight_decay,
            )
        optimizer = torch.optim.AdamW(
            self.net.parameters(),
            config.learning_rate,
            weight_decay=config.weight_decay,
        )
        rise = max(1.0, config.warmup * self._steps)

        def rate(step: int) -> float:
            if step < rise:
                return (step + 1) / rise
            gone = min(1.0, (step - rise) / max(1.0, self._steps - rise))
            return 0.5 * (1 + math.cos(math.pi * gone))

        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, rate)
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }


class GeometryTraining(OccupancyTraining):
    """Trains networks of geometry and size; logs PROTOCOL.md's metrics."""

    unused: tuple[str, ...] = ("label_scale", "input_mean_images", "backbone")

    def _count(
        self,
        output: Tensor,
        labels: Tensor,
        real: Tensor,
        beyond: Tensor | None = None,
    ) -> None:
        """Adds the pixels of (B, 2, h, w) answers and labels."""
        label, amodal = (labels.float() / 255).unbind(dim=1)
        occupancy, posterior = torch.sigmoid(output.float()).unbind(dim=1)
        share = (posterior * amodal).sum(dim=(1, 2)) / posterior.sum(dim=(1, 2))
        self.metrics.update(occupancy, label, share[real], beyond)

    def _loss(self, stage: str, batch: Batch) -> tuple[Tensor, Tensor]:
        fine, coarse, labels, sizes, real = batch
        output = self.net(_scaled(fine), _scaled(coarse), sizes)
        logits = output.float()  # (B, 2, H, W)
        label, amodal = (labels.float() / 255).unbind(dim=1)
        occupancy = robust_loss(
            logits[:, 0],
            label,
            entropy_weight=self._config.entropy_weight,
            miss_weight=self._config.miss_weight,
        )
        posterior = posterior_loss(logits[:, 1], amodal, real)
        loss = occupancy + self._config.posterior_weight * posterior
        training = stage == "train"
        self.log_dict(
            {
                f"{stage}/loss": loss,
                f"{stage}/occupancy_loss": occupancy,
                f"{stage}/posterior_loss": posterior,
            },
            on_step=training,
            on_epoch=not training,
            sync_dist=not training,
            batch_size=len(fine),
        )
        return loss, output


class CompactTraining(GeometryTraining):
    """Trains a network on whole images."""

    unused = (*GeometryTraining.unused, "freeze_norm")

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """Returns the loss of one batch, mirrored at random; of shape ()."""
        *images, sizes, real = batch
        axes = self.flipped_axes()
        fine, coarse, labels = (image.flip(axes) for image in images)
        return self._loss("train", (fine, coarse, labels, sizes, real))[0]

    def validation_step(self, batch: Batch, index: int) -> None:
        """Counts pixels."""
        _, output = self._loss("validation", batch)
        _, _, labels, _, real = batch
        self._count(output, labels, real)


def _scaled(images: Tensor) -> Tensor:
    """Bytes to [0, 1]."""
    scaled = images.float() / 255
    return scaled.contiguous(memory_format=torch.channels_last)
