"""Connects a system to what is called as its input ports are."""

from collections.abc import Collection, Mapping

from pydrake.systems.framework import (
    DiagramBuilder,
    OutputPort,
    PortDataType,
    System,
)

_KINDS = {
    PortDataType.kAbstractValued: "abstract-valued",
    PortDataType.kVectorValued: "vector-valued",
}


def connect_inputs(
    builder: DiagramBuilder,
    system: System,
    sources: Mapping[str, OutputPort],
    *,
    open_ports: Collection[str] = (),
) -> None:
    """Connects each input port of a system to the output of its name.

    Args:
        builder: holds the system and the outputs' systems.
        system: with inputs, of which some may be connected already.
        sources: name to output.
        open_ports: inputs that stay open.

    Raises:
        ValueError: an input that no output is for, or one of another kind.
    """
    for index in range(system.num_input_ports()):
        port = system.get_input_port(index)
        name = port.get_name()
        if name in open_ports or builder.IsConnectedOrExported(port):
            continue
        if name not in sources:
            raise ValueError(
                f"{system.get_name()} has an input {name!r}, and nothing here "
                f"gives that; there are {', '.join(sorted(sources))}"
            )
        source = sources[name]
        if port.get_data_type() != source.get_data_type():
            raise ValueError(
                f"the input {name!r} of {system.get_name()} must be "
                f"{_KINDS[source.get_data_type()]}, as the output of that name "
                "is"
            )
        builder.Connect(source, port)


def check_output(system: System, name: str) -> None:
    """Checks that a system that takes another's place gives what that did.

    Raises:
        ValueError: it has no output of that name.
    """
    if not system.HasOutputPort(name):
        outputs = [
            system.get_output_port(i).get_name()
            for i in range(system.num_output_ports())
        ]
        raise ValueError(
            f"{system.get_name()} needs an output {name!r}; it has "
            f"{', '.join(outputs) or 'none'}"
        )
