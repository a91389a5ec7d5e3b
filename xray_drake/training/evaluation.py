"""What predictors of the occupancy distribution are worth: Table I, and more.

Metrics are those of :mod:`xray_drake.occupancy.metrics`, over all images of a
set and over parts of it. Counts are pooled, as the paper does, and means over
images stand beside them.

Intervals are 95 % percentile bootstraps that draw heaps, not images: views and
snapshots of one heap are much alike, and drawn one by one they would make the
intervals too narrow. All metrics are ratios of sums over images, so a draw of n
out of n heaps is a vector of multinomial weights on the heaps' sums, the same
for all metrics and every predictor. (``scipy.stats.bootstrap`` would draw anew
for each metric.)
"""

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

import numpy as np

from xray_drake.choices import TARGET_NAMES
from xray_drake.dataset.check import FULLY_VISIBLE
from xray_drake.dataset.sample import Sample, SampleKey
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.metrics import (
    BINS,
    CalibrationCounts,
    PixelCounts,
    calibration_counts,
    mass_on_mask,
    pixel_counts,
    share_in_support,
)
from xray_drake.seeding import stream

Predictor = Callable[[Sample], OccupancyDistribution]
"""Answers a sample with a distribution of its size."""

HELD = 0.95
"""Share of the true amodal mask that the support must hold to contain it."""

_SLACK = 1e-6
"""Rounding may take a prediction so far out of [0, 1]."""


class Visibility(Enum):
    """How much of the target is seen; the values are those of reports."""

    HIDDEN = "hidden"
    PARTLY_VISIBLE = "partly_visible"
    FULLY_VISIBLE = "fully_visible"


def visibility(visible_fraction: float) -> Visibility:
    """Tells the class of an image, as the statistics of a dataset do.

    Args:
        visible_fraction: visible share of the target's amodal mask. Hidden is
            0, fully visible more than ``dataset.check.FULLY_VISIBLE``.
    """
    if visible_fraction == 0:
        return Visibility.HIDDEN
    if visible_fraction <= FULLY_VISIBLE:
        return Visibility.PARTLY_VISIBLE
    return Visibility.FULLY_VISIBLE


@dataclass(frozen=True, eq=False)
class ImageRecord:
    """What a predictor did on one image.

    Attributes:
        key: of the sample.
        visibility: of its target.
        counts: of pixels.
        target_mass: of the prediction on the true amodal mask; NaN where it
            is 0 everywhere.
        support_share: of the true amodal mask inside the support; NaN where
            that mask is blank.
        calibration: of the prediction as a probability.
        seconds: wall time.
    """

    key: SampleKey
    visibility: Visibility
    counts: PixelCounts
    target_mass: float
    support_share: float
    calibration: CalibrationCounts
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Returns the record as strict JSON takes it, undefined as null."""
        return _strict(
            {
                **asdict(self.key),
                "visibility": self.visibility.value,
                **asdict(self.counts),
                "balanced_accuracy": self.counts.balanced_accuracy,
                "iou": self.counts.iou,
                "target_mass": self.target_mass,
                "support_share": self.support_share,
                "brier_score": self.calibration.brier_score,
                "seconds": self.seconds,
            }
        )


@dataclass(frozen=True)
class Estimate:
    """A figure and its 95 % interval; NaN where it is undefined.

    Where all heaps have the same value, draws of them have it as well, and
    the interval is a point: it does not speak for heaps that were not seen.

    Attributes:
        value: over the images.
        low, high: bounds; NaN for fewer than two heaps.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Summary:
    """What a predictor did on some images.

    Attributes:
        images: how many.
        heaps: how many they are of.
        counts: of pixels, pooled.
        balanced_accuracy, iou: of the pooled counts.
        mean_balanced_accuracy, mean_iou: over the images that define them.
        target_mass: mean over the images; a prediction that is 0 everywhere
            counts as 0.
        containment: share of the images whose true amodal mask lies in the
            support to at least :data:`HELD`; of those with such a mask.
        brier_score: of all pixels.
        calibration: of all pixels.
        seconds: median over the images, which passes over the first call's
            preparations.
    """

    images: int
    heaps: int
    counts: PixelCounts
    balanced_accuracy: Estimate
    iou: Estimate
    mean_balanced_accuracy: Estimate
    mean_iou: Estimate
    target_mass: Estimate
    containment: Estimate
    brier_score: Estimate
    calibration: CalibrationCounts
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Returns the summary as strict JSON takes it, undefined as null."""
        calibration = self.calibration
        return _strict(
            {
                **asdict(self),
                "expected_calibration_error": (
                    calibration.expected_calibration_error
                ),
                "calibration": {
                    name: getattr(calibration, name).tolist()
                    for name in ("pixels", "predicted", "observed")
                },
            }
        )


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What one predictor did.

    Attributes:
        records: one per image, in the order of the samples.
        overall: of all images.
        by_visibility: of the classes that there are images of.
        by_target: of each target, in the order of ``TARGET_NAMES``.
    """

    records: tuple[ImageRecord, ...]
    overall: Summary
    by_visibility: Mapping[Visibility, Summary]
    by_target: Mapping[str, Summary]

    def parts(self) -> dict[str, Summary]:
        """Returns what a table has rows of, by its name there."""
        return {
            "all": self.overall,
            **{
                part.value.replace("_", " "): summary
                for part, summary in self.by_visibility.items()
            },
            **(self.by_target if len(self.by_target) > 1 else {}),
        }

    def to_dict(self) -> dict[str, Any]:
        """Returns everything as strict JSON takes it, undefined as null."""
        return {
            "overall": self.overall.to_dict(),
            "by_visibility": {
                part.value: summary.to_dict()
                for part, summary in self.by_visibility.items()
            },
            "by_target": {
                name: summary.to_dict()
                for name, summary in self.by_target.items()
            },
            "images": [record.to_dict() for record in self.records],
        }


def evaluate(
    samples: Iterable[Sample],
    predictors: Mapping[str, Predictor],
    *,
    bins: int = BINS,
    resamples: int = 2000,
    seed: int = 0,
) -> dict[str, Evaluation]:
    """Asks predictors about the same samples and compares with the truth.

    Samples are taken one by one and not kept.

    Args:
        samples: at least one.
        predictors: by the name that results go by; at least one.
        bins: of predicted values, for calibration.
        resamples: draws of the bootstrap.
        seed: of the bootstrap.

    Returns:
        One evaluation per predictor, in their order.

    Raises:
        ValueError: no samples, no predictors, no draws, or a prediction of
            another size or with values outside [0, 1]; a predictor's own.
    """
    if not predictors:
        raise ValueError("there is nothing to evaluate: no predictor")
    if resamples < 1:
        raise ValueError(f"a bootstrap needs draws, not {resamples}")
    records: dict[str, list[ImageRecord]] = {name: [] for name in predictors}
    for sample in samples:
        for name, predictor in predictors.items():
            start = time.perf_counter()
            answer = predictor(sample)
            seconds = time.perf_counter() - start
            data = answer.data
            _check(data, sample, name)
            records[name].append(
                ImageRecord(
                    key=sample.key,
                    visibility=visibility(sample.visible_fraction),
                    counts=pixel_counts(sample.occupancy, data),
                    target_mass=mass_on_mask(data, sample.target_amodal),
                    support_share=share_in_support(
                        answer.support(), sample.target_amodal
                    ),
                    calibration=calibration_counts(
                        data, sample.target_amodal, bins=bins
                    ),
                    seconds=seconds,
                )
            )
    if not all(records.values()):
        raise ValueError("there is nothing to evaluate: no sample")
    found = {}
    for name, own in records.items():
        targets = [record.key.target_name for record in own]
        seen = [record.visibility for record in own]
        # The package's targets in their order, then others by name.
        order = dict.fromkeys((*TARGET_NAMES, *sorted(targets)))

        def parts(of: list[Any], order: Iterable[Any], own: Any = own) -> Any:
            return {
                part: _summarize(some, resamples, seed)
                for part in order
                if (
                    some := [
                        r for r, p in zip(own, of, strict=True) if p == part
                    ]
                )
            }

        found[name] = Evaluation(
            records=tuple(own),
            overall=_summarize(own, resamples, seed),
            by_visibility=parts(seen, Visibility),
            by_target=parts(targets, order),
        )
    return found


def markdown_table(results: Mapping[str, Evaluation]) -> str:
    """Returns results as a table in Markdown.

    All images, then the classes of visibility, then the targets where there
    are several; predictors below each other. Undefined figures are dashes;
    intervals that are a point are left out.

    Args:
        results: of :func:`evaluate`.
    """
    lines = [
        "| images | predictor | balanced accuracy | IoU | mean bal. acc. | "
        "mean IoU | mass on target | target held | ECE | Brier | ms |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    parts = {name: result.parts() for name, result in results.items()}
    for part in next(iter(parts.values()), {}):
        for name, summaries in parts.items():
            s = summaries[part]
            error = s.calibration.expected_calibration_error
            cells = [
                f"{part}, {s.images}",
                name,
                _with_interval(s.balanced_accuracy, ".1%"),
                _with_interval(s.iou, ".3f"),
                _number(s.mean_balanced_accuracy.value, ".1%"),
                _number(s.mean_iou.value, ".3f"),
                _with_interval(s.target_mass, ".3f"),
                _with_interval(s.containment, ".1%"),
                _number(error, ".4f"),
                _number(s.brier_score.value, ".4f"),
                _number(1000 * s.seconds, ".1f"),
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "–"


def _with_interval(estimate: Estimate, form: str) -> str:
    if not estimate.low < estimate.high:
        return _number(estimate.value, form)
    return (
        f"{estimate.value:{form}} ({estimate.low:{form}} to "
        f"{estimate.high:{form}})"
    )


def _check(prediction: np.ndarray, sample: Sample, name: str) -> None:
    where = f"the prediction of {name} for {sample.key}"
    if prediction.shape != sample.shape:
        raise ValueError(f"{where} is {prediction.shape}, not {sample.shape}")
    if not (np.all(prediction >= -_SLACK) and np.all(prediction <= 1 + _SLACK)):
        raise ValueError(f"{where} has values outside [0, 1], or NaN")


def _summarize(
    records: list[ImageRecord], resamples: int, seed: int
) -> Summary:
    heaps, heap = np.unique(
        np.array([record.key.heap_seed for record in records]),
        return_inverse=True,
    )
    sums = np.zeros((len(heaps), 8, 2))
    np.add.at(sums, heap, np.array([_ratios_of(r) for r in records]))
    values = _statistics(sums.sum(axis=0))
    drawn = _statistics(_resampled(sums, resamples, seed))
    first, *rest = [record.calibration for record in records]
    return Summary(
        images=len(records),
        heaps=len(heaps),
        counts=sum((record.counts for record in records), PixelCounts()),
        calibration=sum(rest, first),
        seconds=float(np.median([record.seconds for record in records])),
        **{
            name: _estimate(float(value), drawn[name], len(heaps))
            for name, value in values.items()
        },
    )


def _estimate(value: float, drawn: np.ndarray, heaps: int) -> Estimate:
    drawn = drawn[np.isfinite(drawn)]
    if heaps < 2 or not drawn.size:
        return Estimate(value, math.nan, math.nan)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Estimate(value, float(low), float(high))


def _ratios_of(record: ImageRecord) -> list[tuple[float, float]]:
    """Returns one image's share of the ratios that metrics are made of.

    Returns:
        Numerator and denominator of each; both 0 where the image does not
        count.
    """
    counts = record.counts

    def mean_of(value: float) -> tuple[float, float]:
        return (0.0, 0.0) if math.isnan(value) else (value, 1.0)

    share = record.support_share
    return [
        (counts.tp, counts.positives),
        (counts.tn, counts.negatives),
        (counts.tp, counts.union),
        mean_of(counts.balanced_accuracy),
        mean_of(counts.iou),
        mean_of(np.nan_to_num(record.target_mass)),
        mean_of(share if math.isnan(share) else share >= HELD),
        (
            record.calibration.squared_error,
            float(record.calibration.pixels.sum()),
        ),
    ]


def _statistics(sums: np.ndarray) -> dict[str, np.ndarray]:
    """Returns the metrics of sums.

    Args:
        sums: (..., 8, 2) of :func:`_ratios_of`.

    Returns:
        Field of :class:`Summary` to (...,) values; NaN where undefined.
    """
    with np.errstate(invalid="ignore"):
        ratios = sums[..., 0] / sums[..., 1]
    positive, negative, *others = np.moveaxis(ratios, -1, 0)
    names = "iou mean_balanced_accuracy mean_iou target_mass containment"
    return {
        "balanced_accuracy": (positive + negative) / 2,
        **dict(zip([*names.split(), "brier_score"], others, strict=True)),
    }


def _resampled(sums: np.ndarray, resamples: int, seed: int) -> np.ndarray:
    """Returns the (resamples, ...) sums of heaps drawn with replacement.

    Args:
        sums: (n, ...), of each heap.
        resamples: how many draws of n heaps.
        seed: of the draws.
    """
    heaps = len(sums)
    shares = np.full(heaps, 1 / heaps)
    flat = sums.reshape(heaps, -1)
    rng = stream(seed, "bootstrap")
    drawn = [rng.multinomial(heaps, shares) @ flat for _ in range(resamples)]
    return np.reshape(drawn, (resamples, *sums.shape[1:]))


def _strict(value: Any) -> Any:
    """Returns the same with None for what JSON has no number for."""
    if isinstance(value, dict):
        return {name: _strict(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
