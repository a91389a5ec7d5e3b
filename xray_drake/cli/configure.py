"""The scenario that the command line asks for."""

from collections.abc import Mapping
from typing import Any

from xray_drake.station.scenario import (
    Scenario,
    check_scenario,
    load_scenario,
)


def configure(
    name: str, overrides: Mapping[str, Any], *, searched: bool = True
) -> Scenario:
    """Loads a scenario and puts in what the command line says.

    Args:
        name: of a scenario, or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.
        searched: see :func:`xray_drake.station.scenario.check_scenario`.

    Raises:
        ScenarioError: see :func:`xray_drake.station.scenario.load_scenario`.
    """
    scenario = load_scenario(name, searched=searched)
    for path, value in overrides.items():
        *parents, field = path.split(".")
        owner: Any = scenario
        for parent in parents:
            owner = getattr(owner, parent)
        setattr(owner, field, value)
    check_scenario(scenario, "command line", searched=searched)
    return scenario
