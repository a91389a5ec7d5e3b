"""The paper's own figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from xray_drake.configuration import tree_of
from xray_drake.station.scenario import (
    Scenario,
    load_scenario,
    scenario_names,
)


@dataclass(frozen=True)
class PaperRow:
    """A policy in the paper.

    Attributes:
        rate: share of successes.
        quartiles: of the number of actions over successes.
    """

    rate: float
    quartiles: tuple[float, float, float]


@dataclass(frozen=True)
class PaperTable:
    """One of the paper's tables of policies.

    Attributes:
        name: as the paper counts it.
        heaps: how many.
        what: they were.
        rows: by the name of the policy; its X-Ray works with a network.
    """

    name: str
    heaps: int
    what: str
    rows: Mapping[str, PaperRow]


TABLE_II = PaperTable(
    "Table II",
    1000,
    "simulated heaps of its own objects and physics",
    {
        "random": PaperRow(0.42, (4, 7, 9)),
        "largest": PaperRow(0.67, (4, 5, 7)),
        "xray": PaperRow(0.82, (3, 5, 6)),
    },
)
TABLE_III = PaperTable(
    "Table III",
    20,
    "heaps before a real robot",
    {
        "random": PaperRow(0.85, (4, 6, 7)),
        "largest": PaperRow(0.85, (4, 6, 7)),
        "xray": PaperRow(1.00, (4, 5, 5.25)),
    },
)


_OURS = ("perception.weights", "perception.dtype", "perception.geometric")
"""What may be changed: how distributions are inferred, which is not theirs."""

_TARGETS = {"table3": ("scene.target domino",)}
"""What else may be, of single scenarios: the second target of PROTOCOL.md."""


def paper_table(
    scenario: str, changed: Sequence[str] = ()
) -> PaperTable | None:
    """Returns the paper's table that a scenario is modelled on, if any.

    Args:
        scenario: its name.
        changed: of :func:`changes`.
    """
    others = [
        change
        for change in changed
        if not change.startswith(_OURS)
        and not change.startswith(_TARGETS.get(scenario, ()))
    ]
    tables = {"table2": TABLE_II, "table3": TABLE_III}
    return None if others else tables.get(scenario)


def changes(scenario: Scenario) -> tuple[str, ...]:
    """Says in what a scenario is not the one that comes by its name.

    Seed, policy and inference are a rollout's own: they do not count.

    Returns:
        A few words a key, "horizon 5, not 10"; nothing where there is no such
        scenario.
    """
    if scenario.name not in scenario_names():
        return ()
    own, given = (
        _leaves(
            tree_of(
                replace(
                    each,
                    seed=0,
                    policy=replace(each.policy, name="", target_first=True),
                    perception=replace(each.perception, occupancy=""),
                )
            )
        )
        for each in (scenario, load_scenario(scenario.name, searched=False))
    )
    return tuple(
        f"{key} {own.get(key, 'none')}, not {given.get(key, 'none')}"
        for key in sorted(own.keys() | given.keys())
        if own.get(key) != given.get(key)
    )


def _leaves(tree: Mapping[str, Any], path: str = "") -> dict[str, str]:
    """Returns the path of each key and its value as text."""
    found: dict[str, str] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            found |= _leaves(value, f"{path}{key}.")
        else:
            found[f"{path}{key}"] = _text(value)
    return found


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)
