"""``xray-drake benchmark``."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from xray_drake.benchmark.report import table
from xray_drake.benchmark.rollouts import read_rollouts, run_rollouts
from xray_drake.station.scenario import Scenario


def run(
    scenario: Scenario,
    *,
    policies: Sequence[str],
    seeds: Sequence[int],
    folder: Path,
    workers: int,
    console: Console,
) -> None:
    """Runs the rollouts that are missing and writes ``folder/table.md``.

    Raises:
        ValueError: the folder holds rollouts of another scenario.
        OSError: it cannot be written.
    """
    with Progress(
        TextColumn("rollouts"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    ) as bars:
        already = {(r["seed"], r["policy"]) for r in read_rollouts(folder)}
        wanted = {(seed, policy) for seed in seeds for policy in policies}
        task = bars.add_task(
            "", total=len(wanted), completed=len(wanted & already)
        )
        for _ in run_rollouts(
            scenario,
            policies=policies,
            seeds=seeds,
            folder=folder,
            workers=workers,
        ):
            bars.advance(task)
    records = [
        r for r in read_rollouts(folder) if (r["seed"], r["policy"]) in wanted
    ]
    # Workers end in any order; the table must not depend on it.
    records.sort(key=lambda r: (policies.index(r["policy"]), r["seed"]))
    text = table(records)
    (folder / "table.md").write_text(text + "\n", encoding="utf-8")
    console.print(text, soft_wrap=True, highlight=False)
