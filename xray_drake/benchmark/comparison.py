"""The report of a benchmark: the paper's tables, its Figure 6, and more."""

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from xray_drake.benchmark.paper import PaperTable, paper_table
from xray_drake.benchmark.records import (
    Collection,
    Record,
    in_order,
)
from xray_drake.benchmark.statistics import (
    MOST_VISIBLE,
    NONE,
    QUARTILES,
    Estimate,
    Part,
    action_difference,
    occluded,
    parts,
    quantities,
    seconds_a_rollout,
    starts,
    success_difference,
    within,
)
from xray_drake.benchmark.variants import Variant
from xray_drake.provenance import Provenance, describe

_KEYS = ("part", "variant", "against", "quantity")
_COLUMNS = (*_KEYS, "value", "low", "high", "heaps")


@dataclass(frozen=True, eq=False)
class Report:
    """What a report says, before it is written in one way or another.

    Attributes:
        records: all, in order.
        counted: those whose heaps count (PROTOCOL.md, "Which heaps count").
        by_variant: of those, by variant, in order.
        parts: of their heaps.
        scenario: its name.
        changed: in what it is not the scenario of that name.
        horizon: actions at most.
        made_by: a line that stands under every table.
    """

    records: list[Record]
    counted: list[Record]
    by_variant: dict[Variant, list[Record]]
    parts: list[Part]
    scenario: str
    changed: tuple[str, ...]
    horizon: int
    made_by: str

    @property
    def paper(self) -> PaperTable | None:
        """The paper's table that it may stand beside, if any."""
        return paper_table(self.scenario, self.changed)

    @property
    def pairs(self) -> Iterator[tuple[Variant, Variant]]:
        """Pairs of variants, the later one of the order first."""
        found = list(self.by_variant)
        for i, variant in enumerate(found):
            for other in found[:i]:
                yield variant, other

    @cached_property
    def figures(self) -> dict[tuple[str, str, str, str], Estimate]:
        """All figures, by part, variant, variant against it, and quantity.

        Of a variant alone those of :func:`.statistics.quantities`; of two,
        how much higher ``success_rate`` is, and how many actions more are
        taken (``actions_where_both_succeed``). What there are no heaps for is
        left out.
        """
        found = {}
        for part in self.parts:
            own = {v: within(r, part) for v, r in self.by_variant.items()}
            for variant, records in own.items():
                for quantity, estimate in quantities(
                    records, self.horizon
                ).items():
                    key = part.key, variant.label, "", quantity
                    found[key] = estimate
            for variant, other in self.pairs:
                pair, labels = (own[variant], own[other]), (variant, other)
                for quantity, estimate in (
                    ("success_rate", success_difference(*pair)),
                    ("actions_where_both_succeed", action_difference(*pair)),
                ):
                    if estimate.heaps:
                        one, two = (v.label for v in labels)
                        found[part.key, one, two, quantity] = estimate
        return found

    def figure(
        self, variant: Variant, quantity: str, part: str = "all"
    ) -> Estimate:
        """Returns a figure of one variant, or of no heaps."""
        return self.figures.get((part, variant.label, "", quantity), NONE)

    def names(self, prefix: str) -> list[str]:
        """Returns the quantities over all heaps that begin so, without it."""
        found = [
            quantity.removeprefix(prefix)
            for part, _, _, quantity in self.figures
            if part == "all" and quantity.startswith(prefix)
        ]
        return list(dict.fromkeys(found))


def make_report(collection: Collection) -> Report:
    """Sorts out records.

    Raises:
        ValueError: there are none whose heaps count.
    """
    records = in_order(collection.records)
    counted = occluded(records)
    if not counted:
        raise ValueError(
            f"there is nothing to report: of {len(records)} rollouts none is "
            f"of a heap whose target starts at most {MOST_VISIBLE:.0%} visible"
        )
    changed = " (changed)" if collection.changed else ""
    by_variant: dict[Variant, list[Record]] = {}
    for record in counted:
        by_variant.setdefault(Variant.of(record), []).append(record)
    return Report(
        records=records,
        counted=counted,
        by_variant=by_variant,
        parts=parts(counted),
        scenario=collection.scenario,
        changed=collection.changed,
        horizon=max(record.get("horizon", 1) for record in records),
        made_by=describe(
            map(Provenance.from_dict, records),
            scenario=f"{collection.scenario}{changed}",
            seeds=(record["seed"] for record in records),
        ),
    )


def comma_separated(report: Report) -> str:
    """Returns all figures of the report, one a line, as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in _lines(report):
        writer.writerow(
            {
                key: round(value, 6) if isinstance(value, float) else value
                for key, value in row.items()
                if not (isinstance(value, float) and math.isnan(value))
            }
        )
    return text.getvalue()


def _lines(report: Report) -> Iterator[dict[str, Any]]:
    """Yields the lines of the CSV file."""
    for key, estimate in report.figures.items():
        yield dict(zip(_KEYS, key, strict=True)) | vars(estimate)
    for policy, row in report.paper.rows.items() if report.paper else ():
        figures = dict(zip(QUARTILES, row.quartiles, strict=True))
        for quantity, value in {"success_rate": row.rate, **figures}.items():
            yield {
                "part": "paper",
                "variant": policy,
                "quantity": quantity,
                "value": value,
                "heaps": report.paper.heaps if report.paper else 0,
            }
    yield {
        "part": "all",
        "quantity": "core_seconds_a_rollout",
        "value": seconds_a_rollout(report.records),
        "heaps": len(starts(report.records)),
    }
    yield {"part": "all", "quantity": "manifest", "value": report.made_by}
