"""The provenance of what a scenario gives."""

from collections.abc import Iterable

from xray_drake.choices import WITHOUT_NETWORK
from xray_drake.provenance import Provenance, current
from xray_drake.station.scenario import Scenario, weights_path


def scenario_provenance(
    scenario: Scenario, occupancies: Iterable[str] | None = None
) -> Provenance:
    """Returns the provenance of rollouts of a scenario.

    Args:
        scenario: to be run.
        occupancies: what infers the distribution; by default the scenario's.
    """
    perception = scenario.perception
    used = set(occupancies or [perception.occupancy])
    if used <= {"", *WITHOUT_NETWORK}:
        return current()
    return current(
        weights=[weights_path(perception)],
        dtype=perception.dtype,
    )
