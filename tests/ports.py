"""Ports of systems, for tests."""

from pydrake.systems.framework import System


def inputs_of(system: System) -> list[str]:
    """Returns the names of the input ports, in their order."""
    return [
        system.get_input_port(i).get_name()
        for i in range(system.num_input_ports())
    ]


def outputs_of(system: System) -> list[str]:
    """Returns the names of the output ports, in their order."""
    return [
        system.get_output_port(i).get_name()
        for i in range(system.num_output_ports())
    ]


def ports(system: System) -> tuple[list[str], list[str]]:
    """Returns the names of the input and of the output ports."""
    return inputs_of(system), outputs_of(system)
