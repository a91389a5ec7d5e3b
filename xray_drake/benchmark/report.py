"""The report of a benchmark: the paper's tables, its Figure 6, and more."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xray_drake.benchmark.paper import PaperTable, paper_table
from xray_drake.benchmark.records import (
    Collection,
    HeapKey,
    Record,
    heap_of,
    in_order,
)
from xray_drake.benchmark.statistics import (
    MOST_VISIBLE,
    Estimate,
    Part,
    action_difference,
    action_quartiles,
    actions,
    containment,
    draws,
    drop_seconds,
    ends,
    occluded,
    outcomes,
    parts,
    rollout_seconds,
    seconds_a_rollout,
    stage_seconds,
    start_shares,
    starts,
    success_difference,
    success_rate,
    success_within,
    within,
)
from xray_drake.benchmark.variants import Variant
from xray_drake.drawing.rollout_figures import actions_figure, success_figure
from xray_drake.files import write_whole_file
from xray_drake.provenance import Provenance, describe

REPORT = "report.md"
FIGURES = "report.csv"
ACTIONS = "actions.png"
SUCCESS = "success.png"

_COLUMNS = (
    *("part", "variant", "against", "quantity"),
    *("value", "low", "high", "heaps"),
)


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


def write_report(report: Report, folder: Path) -> tuple[Path, ...]:
    """Writes the report as Markdown and CSV with two figures.

    The same records give the same files, whatever order they came in.

    Args:
        report: what to write.
        folder: made if it does not exist.

    Returns:
        The files.

    Raises:
        OSError: they cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {v.label: actions(r) for v, r in report.by_variant.items()}
    rollouts = {v.label: len(r) for v, r in report.by_variant.items()}
    rates = {
        variant.label: success_within(records, report.horizon)
        for variant, records in report.by_variant.items()
    }
    contents = {
        folder / REPORT: markdown(report).encode(),
        folder / FIGURES: comma_separated(report).encode(),
    }
    for name, figure in (
        (ACTIONS, actions_figure(numbers, rollouts, horizon=report.horizon)),
        (SUCCESS, success_figure(rates)),
    ):
        image = io.BytesIO()
        figure.savefig(image, format="png")
        contents[folder / name] = image.getvalue()
    for path, data in contents.items():
        write_whole_file(path, data)
    return tuple(contents)


def markdown(report: Report) -> str:
    """Returns the whole report as Markdown."""
    paper = f" (the paper's {report.paper.name})" if report.paper else ""
    below = ["", report.made_by, ""]
    return "\n".join(
        [
            f"# Benchmark of the scenario `{report.scenario}`",
            "",
            *_heaps(report),
            "",
            f"## Success{paper}",
            "",
            *success_table(report),
            "",
            f"![Number of actions]({ACTIONS})",
            "",
            "## Differences",
            "",
            *_differences(report),
            *below,
            "## Success within k actions",
            "",
            *_success_within(report),
            *below,
            f"![Success within k actions]({SUCCESS})",
            "",
            "## Success by how the target starts",
            "",
            *_success_by_part(report),
            *below,
            "## How rollouts end",
            "",
            *_ends(report),
            *below,
            "## Time",
            "",
            *_times(report),
            *below,
            "## Inference",
            "",
            *_inference(report),
            *below,
        ]
    )


def success_table(report: Report) -> list[str]:
    """Returns rates and actions by policy as Markdown.

    The figures of the paper's Table II or III stand beside those of the
    scenario that is modelled on it, as it is.
    """
    theirs = report.paper
    rows = []
    for variant, records in report.by_variant.items():
        row = [
            variant.label,
            *_rate_cells(success_rate(records)),
            _quartiles(records),
        ]
        if theirs:
            paper = theirs.rows.get(variant.policy)
            row += [
                f"{100 * paper.rate:.0f} %" if paper else "",
                ", ".join(f"{q:g}" for q in paper.quartiles) if paper else "",
            ]
        rows.append(row)
    note = (
        "Quartiles are of the number of actions over successes. Intervals are "
        "Wilson's."
    )
    if theirs:
        note += (
            f" The paper's figures ({theirs.name}) are of {theirs.heaps:,} "
            f"{theirs.what}, its X-Ray of its own network."
        )
    head = ("policy", "success rate", "95 % interval", "rollouts")
    return [
        *_table(
            (
                *(*head, "actions, quartiles"),
                *(("paper: rate", "paper: actions") if theirs else ()),
            ),
            rows,
        ),
        "",
        note,
        "",
        report.made_by,
    ]


def comma_separated(report: Report) -> str:
    """Returns all figures of the report, one a line, as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in _quantities(report):
        writer.writerow(
            {
                key: round(value, 6) if isinstance(value, float) else value
                for key, value in row.items()
                if not (isinstance(value, float) and math.isnan(value))
            }
        )
    return text.getvalue()


def _heaps(report: Report) -> list[str]:
    heaps: dict[HeapKey, None] = dict.fromkeys(map(heap_of, report.records))
    targets = sorted({target for target, _ in heaps})
    seeds = sorted({seed for _, seed in heaps})
    shares = ", ".join(
        f"{_percent(share)} {name}"
        for name, share in start_shares(report.records).items()
    )
    count = draws(report.records)
    lines = [
        f"{len(report.records)} rollouts on {len(heaps)} heaps (seeds "
        f"{seeds[0]} to {seeds[-1]}) with the target {', '.join(targets)}; "
        f"horizon {report.horizon}. Targets at the start: {shares or '–'}.",
    ]
    if count["drawn"]:
        lines += [
            "",
            f"Of {count['drawn']} heaps drawn, {count['visible']} "
            f"({_percent(count['visible'] / count['drawn'])}) showed too much "
            f"of the target and {count['failed']} did not come to rest; they "
            "were drawn again.",
        ]
    left_out = len(report.records) - len(report.counted)
    if left_out:
        lines += [
            "",
            "Rollouts left out below, since their targets start more than "
            f"{100 * MOST_VISIBLE:.0f} % visible: {left_out}.",
        ]
    if report.changed:
        lines += [
            "",
            f"Changed on the scenario `{report.scenario}`: "
            f"{'; '.join(report.changed)}.",
        ]
    return lines


def _pairs(report: Report) -> Iterator[tuple[Variant, Variant]]:
    """Yields pairs of variants, the later one of the order first."""
    found = list(report.by_variant)
    for i, variant in enumerate(found):
        for other in found[:i]:
            yield variant, other


def _differences(report: Report) -> list[str]:
    rows = []
    for variant, other in _pairs(report):
        ours, theirs = report.by_variant[variant], report.by_variant[other]
        fewer = action_difference(ours, theirs)
        rows.append(
            [
                f"{variant.label} − {other.label}",
                *(
                    _points(
                        success_difference(within(ours, p), within(theirs, p))
                    )
                    for p in report.parts
                ),
                _interval(fewer, "{:+.2f}"),
            ]
        )
    if not rows:
        return ["There is one variant alone."]
    return [
        *_table(
            (
                "difference",
                *_titles(report.parts),
                "actions where both succeed",
            ),
            rows,
        ),
        "",
        "Success rates in percentage points on the heaps that both searched, "
        "with the 95 % interval of a bootstrap that draws heaps.",
        *_about_parts(report),
    ]


def _success_within(report: Report) -> list[str]:
    steps = range(1, report.horizon + 1)
    return _table(
        ("policy", *map(str, steps)),
        [
            [
                variant.label,
                *map(_percent, success_within(records, report.horizon)),
            ]
            for variant, records in report.by_variant.items()
        ],
    )


def _success_by_part(report: Report) -> list[str]:
    rows = []
    for variant, records in report.by_variant.items():
        cells = []
        for part in report.parts:
            rate = success_rate(within(records, part))
            cells.append(
                f"{_percent(rate.value)} ({_range(rate)})" if rate.heaps else ""
            )
        rows.append([variant.label, *cells])
    return [
        *_table(("policy", *_titles(report.parts)), rows),
        *_about_parts(report),
    ]


def _about_parts(report: Report) -> list[str]:
    """Says what the thirds by cover are, where there are some."""
    if not any(part.key.startswith("cover") for part in report.parts):
        return []
    return [
        "",
        "Cover: visible pixels of the object that covers most of the target "
        "at the start, in multiples of the target's own silhouette; a third "
        "of the heaps each.",
    ]


def _ends(report: Report) -> list[str]:
    found = {v: ends(records) for v, records in report.by_variant.items()}
    names = sorted({end for counts in found.values() for end in counts})
    names.sort(key=lambda end: end != "success")
    tried = {v: outcomes(records) for v, records in report.by_variant.items()}
    kinds = sorted({kind for counts in tried.values() for kind in counts})
    lines = _table(
        ("policy", *names, *(f"attempts: {kind}" for kind in kinds)),
        [
            [
                variant.label,
                *(str(found[variant][end]) for end in names),
                *(str(tried[variant][kind]) for kind in kinds),
            ]
            for variant in report.by_variant
        ],
    )
    reasons = sorted(
        {
            f"- seed {record['seed']}, {Variant.of(record).label}: "
            f"{record.get('reason', '')}"
            for record in report.counted
            if record["end"] == "error"
        }
    )
    return [*lines, *([""] if reasons else []), *reasons]


def _times(report: Report) -> list[str]:
    found = {v: stage_seconds(r) for v, r in report.by_variant.items()}
    stages = list(dict.fromkeys(s for times in found.values() for s in times))
    lines = _table(
        (
            "policy",
            *(f"{stage}, ms" for stage in stages),
            "rollout, core-seconds",
        ),
        [
            [
                variant.label,
                *(
                    _number(1000 * found[variant].get(stage, math.nan), ".1f")
                    for stage in stages
                ),
                _number(rollout_seconds(records), ".2f"),
            ]
            for variant, records in report.by_variant.items()
        ],
    )
    lines += ["", "Stages are means of a decision's wall time."]
    total = seconds_a_rollout(report.records)
    if not math.isnan(total):
        lines[-1] += (
            f" The drop of a heap took {drop_seconds(report.records):.2f} "
            f"core-seconds; counted once a heap, it makes {total:.2f} "
            "core-seconds a rollout."
        )
    return lines


def _inference(report: Report) -> list[str]:
    used: dict[str, list[Record]] = {}
    for record in report.counted:
        if record.get("actions"):
            used.setdefault(record["occupancy"], []).append(record)
    rows = []
    for occupancy in sorted(used):
        some, whole = containment(used[occupancy])
        heaps = len({heap_of(record) for record in used[occupancy]})
        rows.append([occupancy, _percent(some), _percent(whole), str(heaps)])
    return [
        "Heaps at whose first decision the support held at least 95 % of the "
        "target's true amodal mask, and all of it:",
        "",
        *_table(("inference", "95 %", "all", "heaps"), rows),
    ]


def _quantities(report: Report) -> Iterator[dict[str, Any]]:
    """Yields the lines of the CSV file."""
    for part in report.parts:
        for variant, records in report.by_variant.items():
            own = within(records, part)
            if own:
                yield from _of_variant(part, variant, own, report.horizon)
        for variant, other in _pairs(report):
            pair = [
                within(report.by_variant[v], part) for v in (variant, other)
            ]
            for quantity, estimate in (
                ("success_rate", success_difference(*pair)),
                ("actions_where_both_succeed", action_difference(*pair)),
            ):
                if estimate.heaps:
                    yield {
                        "part": part.key,
                        "variant": variant.label,
                        "against": other.label,
                        "quantity": quantity,
                        **_columns(estimate),
                    }
    yield from _of_paper(report.paper)
    yield {
        "part": "all",
        "quantity": "core_seconds_a_rollout",
        "value": seconds_a_rollout(report.records),
        "heaps": len(starts(report.records)),
    }
    yield {"part": "all", "quantity": "manifest", "value": report.made_by}


def _of_paper(table: PaperTable | None) -> Iterator[dict[str, Any]]:
    for policy, row in table.rows.items() if table else ():
        for quantity, value in (
            ("success_rate", row.rate),
            *zip(_QUARTILES, row.quartiles, strict=True),
        ):
            yield {
                "part": "paper",
                "variant": policy,
                "quantity": quantity,
                "value": value,
                "heaps": table.heaps if table else 0,
            }


_QUARTILES = (
    "actions_lower_quartile",
    "actions_median",
    "actions_upper_quartile",
)


def _of_variant(
    part: Part, variant: Variant, records: list[Record], horizon: int
) -> Iterator[dict[str, Any]]:
    base = {"part": part.key, "variant": variant.label}
    rate = success_rate(records)
    yield base | {"quantity": "success_rate", **_columns(rate)}
    values: dict[str, float] = dict(
        zip(_QUARTILES, action_quartiles(records), strict=True)
    )
    for k, value in enumerate(success_within(records, horizon), 1):
        values[f"success_within_{k}"] = value
    values |= {f"end_{end}": n for end, n in sorted(ends(records).items())}
    values |= {
        f"attempts_{kind}": n for kind, n in sorted(outcomes(records).items())
    }
    values |= {
        f"seconds_{stage}": value
        for stage, value in stage_seconds(records).items()
    }
    values["core_seconds"] = rollout_seconds(records)
    for quantity, value in values.items():
        yield base | {
            "quantity": quantity,
            "value": value,
            "heaps": len(records),
        }


def _columns(estimate: Estimate) -> dict[str, float]:
    return {
        "value": estimate.value,
        "low": estimate.low,
        "high": estimate.high,
        "heaps": estimate.heaps,
    }


def _titles(found: Sequence[Part]) -> list[str]:
    return [f"{part.title} ({len(part.heaps)})" for part in found]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [
        f"| {' | '.join(cells)} |"
        for cells in (head, ["---"] * len(head), *rows)
    ]


def _quartiles(records: Sequence[Record]) -> str:
    if not actions(records):
        return "–"
    return ", ".join(_number(number) for number in action_quartiles(records))


def _rate_cells(rate: Estimate) -> list[str]:
    return [_percent(rate.value), _range(rate), str(rate.heaps)]


def _range(rate: Estimate) -> str:
    return f"{_percent(rate.low)} to {_percent(rate.high)}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _points(difference: Estimate) -> str:
    """Returns a difference of rates in percentage points."""
    scaled = Estimate(
        100 * difference.value,
        100 * difference.low,
        100 * difference.high,
        difference.heaps,
    )
    return _interval(scaled, "{:+.1f}")


def _interval(estimate: Estimate, form: str) -> str:
    if not estimate.heaps:
        return ""
    value, low, high = (
        form.format(number).replace("-", "−")
        for number in (estimate.value, estimate.low, estimate.high)
    )
    return f"{value} ({low} to {high})"


def _number(value: float, form: str = "g") -> str:
    return "–" if math.isnan(value) else format(value, form)
