"""``xray-drake train``."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from xray_drake.cli.errors import complain, errors_as_lines
from xray_drake.cli.exits import INTERRUPTED
from xray_drake.cli.options import CORES, Incomplete, Mix, Workers
from xray_drake.cli.progress import counting_bar


@errors_as_lines()
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
    workers: Workers = CORES,
    accelerator: Annotated[
        str, typer.Option(help="auto, cpu or gpu.")
    ] = "auto",
    incomplete: Incomplete = False,
    devices: Annotated[
        int, typer.Option(min=1, help="GPUs; processes with --accelerator cpu.")
    ] = 1,
) -> None:
    """Train an occupancy network on datasets; writes weights and a card."""
    from xray_drake.training.config import check_config, load_config
    from xray_drake.training.run import CARD, CHECKPOINT, WEIGHTS, RunOptions
    from xray_drake.training.run import train as run

    chosen = load_config(config)
    for name in ("seed", "passes", "weights"):
        if (value := locals()[name]) is not None:
            setattr(chosen, name, value)
    check_config(chosen, config)
    console = Console()
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
    try:
        # The trainer draws a bar of its own.
        with counting_bar(console, "preparing shards") as prepared:
            card = run(datasets, chosen, options, prepared=prepared)
    except KeyboardInterrupt:
        raise complain(
            "interrupted; go on with --resume if there is a "
            f"{out / CHECKPOINT}",
            INTERRUPTED,
        ) from None
    for where, figures in card.figures.items():
        typer.echo(
            f"{where}: " + ", ".join(f"{k} {v}" for k, v in figures.items())
        )
    typer.echo(card.training["made by"])
    typer.echo(f"{out / WEIGHTS} and {out / CARD}")
