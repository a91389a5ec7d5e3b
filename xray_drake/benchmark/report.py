"""Writes a report: Markdown with the paper's tables, CSV, its Figure 6."""

import io
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from xray_drake.benchmark.comparison import Report, comma_separated
from xray_drake.benchmark.records import Record, heap_of
from xray_drake.benchmark.statistics import (
    MOST_VISIBLE,
    NONE,
    QUARTILES,
    Estimate,
    actions,
    causes,
    containment,
    draws,
    drop_seconds,
    seconds_a_rollout,
    start_shares,
    success_within,
)
from xray_drake.benchmark.variants import Variant
from xray_drake.choices import current_occupancy
from xray_drake.drawing.rollout_figures import actions_figure, success_figure
from xray_drake.files import write_whole_file

REPORT = "report.md"
FIGURES = "report.csv"
ACTIONS = "actions.png"
SUCCESS = "success.png"


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
    own, horizon = report.by_variant, report.horizon
    numbers = {v.label: actions(r) for v, r in own.items()}
    rollouts = {v.label: len(r) for v, r in own.items()}
    rates = {v.label: success_within(r, horizon) for v, r in own.items()}
    contents = {
        folder / REPORT: markdown(report).encode(),
        folder / FIGURES: comma_separated(report).encode(),
    }
    for name, figure in (
        (ACTIONS, actions_figure(numbers, rollouts, horizon=horizon)),
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
    lines = [
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
    ]
    for title, section in (
        ("Differences", _differences(report)),
        ("Success within k actions", _success_within(report)),
        ("Success by how the target starts", _success_by_part(report)),
        ("How rollouts end", _ends(report)),
        ("Why grasps fail", _failures(report)),
        ("Time", _times(report)),
        ("Inference", _inference(report)),
    ):
        if section:
            lines += [f"## {title}", "", *section, "", report.made_by, ""]
        if title == "Success within k actions":
            lines += [f"![{title}]({SUCCESS})", ""]
    return "\n".join(lines)


def success_table(report: Report) -> list[str]:
    """Returns rates and actions by policy as Markdown.

    The figures of the paper's Table II or III stand beside those of the
    scenario that is modelled on it, as it is.
    """
    theirs = report.paper
    head = ["policy", "success rate", "95 % interval", "rollouts"]
    head.append("actions, quartiles")
    rows = []
    for variant in report.by_variant:
        rate = report.figure(variant, "success_rate")
        quartiles = [report.figure(variant, q).value for q in QUARTILES]
        known = not math.isnan(quartiles[0])
        rows.append(
            [
                *(variant.label, _percent(rate.value), _range(rate)),
                str(rate.heaps),
                ", ".join(map(_number, quartiles)) if known else "–",
            ]
        )
    note = (
        "Quartiles are of the number of actions over successes. Intervals are "
        "Wilson's."
    )
    if theirs:
        head += ["paper: rate", "paper: actions"]
        for row, variant in zip(rows, report.by_variant, strict=True):
            paper = theirs.rows.get(variant.policy)
            row += [
                f"{100 * paper.rate:.0f} %" if paper else "",
                ", ".join(f"{q:g}" for q in paper.quartiles) if paper else "",
            ]
        note += (
            f" The paper's figures ({theirs.name}) are of {theirs.heaps:,} "
            f"{theirs.what}, its X-Ray of its own network."
        )
    return [*_table(head, rows), "", note, "", report.made_by]


def _heaps(report: Report) -> list[str]:
    heaps = dict.fromkeys(map(heap_of, report.records))
    targets = sorted({target for target, _ in heaps})
    seeds = sorted({seed for _, seed in heaps})
    shares = ", ".join(
        f"{_percent(share)} {name}"
        for name, share in start_shares(report.records).items()
    )
    paragraphs = [
        f"{len(report.records)} rollouts on {len(heaps)} heaps (seeds "
        f"{seeds[0]} to {seeds[-1]}) with the target {', '.join(targets)}; "
        f"horizon {report.horizon}. Targets at the start: {shares or '–'}.",
    ]
    count = draws(report.records)
    if count["drawn"]:
        paragraphs.append(
            f"Of {count['drawn']} heaps drawn, {count['visible']} "
            f"({_percent(count['visible'] / count['drawn'])}) showed too much "
            f"of the target and {count['failed']} did not come to rest; they "
            "were drawn again."
        )
    left_out = len(report.records) - len(report.counted)
    if left_out:
        paragraphs.append(
            "Rollouts left out below, since their targets start more than "
            f"{100 * MOST_VISIBLE:.0f} % visible: {left_out}."
        )
    if report.changed:
        paragraphs.append(
            f"Changed on the scenario `{report.scenario}`: "
            f"{'; '.join(report.changed)}."
        )
    return "\n\n".join(paragraphs).split("\n")


def _differences(report: Report) -> list[str]:
    rows = []
    for variant, other in report.pairs:
        labels = variant.label, other.label
        fewer = ("all", *labels, "actions_where_both_succeed")
        rows.append(
            [
                " − ".join(labels),
                *(
                    _interval(
                        report.figures.get(
                            (part.key, *labels, "success_rate"), NONE
                        ),
                        "{:+.1f}",
                        scale=100,
                    )
                    for part in report.parts
                ),
                _interval(report.figures.get(fewer, NONE), "{:+.2f}"),
            ]
        )
    if not rows:
        return ["There is one variant alone."]
    head = ("difference", *_titles(report), "actions where both succeed")
    return [
        *_table(head, rows),
        "",
        "Success rates in percentage points on the heaps that both searched, "
        "with the 95 % interval of a bootstrap that draws heaps.",
        *_about_parts(report),
    ]


def _success_within(report: Report) -> list[str]:
    steps = [str(k) for k in range(1, report.horizon + 1)]
    return _by_variant(
        report,
        steps,
        lambda v, k: _percent(report.figure(v, f"success_within_{k}").value),
    )


def _success_by_part(report: Report) -> list[str]:
    keys = dict(
        zip(_titles(report), (p.key for p in report.parts), strict=True)
    )

    def cell(variant: Variant, title: str) -> str:
        rate = report.figure(variant, "success_rate", keys[title])
        return f"{_percent(rate.value)} ({_range(rate)})" if rate.heaps else ""

    return [*_by_variant(report, keys, cell), *_about_parts(report)]


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
    ends = sorted(report.names("end_"), key=lambda end: (end != "success", end))
    quantities = {end: f"end_{end}" for end in ends} | {
        f"attempts: {kind}": f"attempts_{kind}"
        for kind in sorted(report.names("attempts_"))
    }
    lines = _by_variant(
        report,
        quantities,
        lambda v, title: (
            f"{report.figure(v, quantities[title]).value:.0f}".replace(
                "nan", "0"
            )
        ),
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


def _failures(report: Report) -> list[str]:
    found = {v: causes(records) for v, records in report.by_variant.items()}
    total = sum(found.values(), Counter())
    rows = [
        [cause, *(str(counts[cause]) for counts in found.values())]
        for cause, _ in total.most_common()
    ]
    return _table(("cause", *(v.label for v in found)), rows) if rows else []


def _times(report: Report) -> list[str]:
    stages = {f"{s}, ms": f"seconds_{s}" for s in report.names("seconds_")}

    def cell(variant: Variant, title: str) -> str:
        if title in stages:
            seconds = report.figure(variant, stages[title]).value
            return _number(1000 * seconds, ".1f")
        return _number(report.figure(variant, "core_seconds").value, ".2f")

    lines = _by_variant(report, [*stages, "rollout, core-seconds"], cell)
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
            name = current_occupancy(record["occupancy"])
            used.setdefault(name, []).append(record)
    rows = []
    for occupancy, records in sorted(used.items()):
        some, whole = containment(records)
        heaps = len({heap_of(record) for record in records})
        rows.append([occupancy, _percent(some), _percent(whole), str(heaps)])
    return [
        "Heaps at whose first decision the support held at least 95 % of the "
        "target's true amodal mask, and all of it:",
        "",
        *_table(("inference", "95 %", "all", "heaps"), rows),
    ]


def _titles(report: Report) -> list[str]:
    return [f"{part.title} ({len(part.heaps)})" for part in report.parts]


def _by_variant(
    report: Report,
    columns: Iterable[str],
    cell: Callable[[Variant, str], str],
) -> list[str]:
    """Returns a table with a row for each variant."""
    columns = list(columns)
    rows = [
        [variant.label, *(cell(variant, column) for column in columns)]
        for variant in report.by_variant
    ]
    return _table(("policy", *columns), rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [
        f"| {' | '.join(cells)} |"
        for cells in (head, ["---"] * len(head), *rows)
    ]


def _range(rate: Estimate) -> str:
    return f"{_percent(rate.low)} to {_percent(rate.high)}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _interval(estimate: Estimate, form: str, *, scale: float = 1) -> str:
    if not estimate.heaps:
        return ""
    value, low, high = (
        form.format(scale * number).replace("-", "−")
        for number in (estimate.value, estimate.low, estimate.high)
    )
    return f"{value} ({low} to {high})"


def _number(value: float, form: str = "g") -> str:
    return "–" if math.isnan(value) else format(value, form)
