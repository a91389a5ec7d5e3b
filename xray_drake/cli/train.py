"""``xray-drake train``."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress

from xray_drake.cli.errors import complain, errors_as_lines
from xray_drake.cli.exits import INTERRUPTED
from xray_drake.cli.options import CORES, Mix


def train(
    datasets: Annotated[
        list[Path],
        typer.Argument(metavar="DATASET", help="Made by generate."),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the run.")],
    config: Annotated[
        str, typer.Option(help="Name of a configuration, or a YAML file.")
    ] = "compact",
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the last checkpoint.")
    ] = False,
    mix: Mix = False,
    cache: Annotated[
        Path | None,
        typer.Option(help="Folder of prepared items. By default in OUT."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Instead of the configuration's.")
    ] = None,
    passes: Annotated[
        float | None, typer.Option(help="Instead of the configuration's.")
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(help="Begin with these, in place of random ones."),
    ] = None,
    workers: Annotated[
        int, typer.Option(min=1, help="Processes that prepare, or read.")
    ] = CORES,
    accelerator: Annotated[
        str, typer.Option(help="auto, cpu or gpu.")
    ] = "auto",
    incomplete: Annotated[
        bool,
        typer.Option(
            "--incomplete", help="Train on what is there of the datasets."
        ),
    ] = False,
    devices: Annotated[
        int, typer.Option(min=1, help="GPUs; processes with --accelerator cpu.")
    ] = 1,
) -> None:
    """Train an occupancy network on datasets; writes weights and a card."""
    from xray_drake.training.config import check_config, load_config
    from xray_drake.training.run import CARD, CHECKPOINT, WEIGHTS, RunOptions
    from xray_drake.training.run import train as run

    console = Console()
    with errors_as_lines():
        chosen = load_config(config)
        if seed is not None:
            chosen.seed = seed
        if passes is not None:
            chosen.passes = passes
        if weights is not None:
            chosen.weights = weights
        check_config(chosen, config)
        options = RunOptions(
            out=out,
            resume=resume,
            mix=mix,
            cache=cache,
            workers=workers,
            accelerator=accelerator,
            devices=devices,
            incomplete=incomplete,
            progress=console.is_terminal,
        )
        columns = (*Progress.get_default_columns(), MofNCompleteColumn())
        bars = Progress(
            *columns, console=console, disable=not console.is_terminal
        )
        task = bars.add_task("preparing shards", total=None)

        def prepared(done: int, total: int) -> None:
            if done == 0 or not bars.live.is_started:
                bars.start()
            bars.update(task, completed=done, total=total)
            if done == total:
                # The trainer draws a bar of its own.
                bars.stop()

        try:
            card = run(datasets, chosen, options, prepared=prepared)
        except KeyboardInterrupt:
            raise complain(
                "interrupted; go on with --resume if there is a "
                f"{out / CHECKPOINT}",
                INTERRUPTED,
            ) from None
        finally:
            bars.stop()
        for where, figures in card.figures.items():
            text = ", ".join(f"{k} {v}" for k, v in figures.items())
            console.print(f"{where}: {text}", highlight=False, soft_wrap=True)
        console.print(card.training["made by"], highlight=False, soft_wrap=True)
        console.print(
            f"{out / WEIGHTS} and {out / CARD}", highlight=False, soft_wrap=True
        )
