"""Connects each input of a system to the output of its name."""

from collections.abc import Callable, Collection, Mapping

from pydrake.systems.framework import (
    DiagramBuilder,
    InputPort,
    OutputPort,
    PortDataType,
    System,
)

_KINDS = {
    PortDataType.kAbstractValued: "abstract-valued",
    PortDataType.kVectorValued: "vector-valued",
}


class Boxes:
    """Adds boxes to a diagram, and connects their inputs by name.

    Attributes:
        builder: of the diagram.
        replaced: name of a box to the system that takes its place.
        known: name to the output that the next box is given.
        added: all boxes so far.
    """

    def __init__(
        self,
        builder: DiagramBuilder,
        replaced: Mapping[str, System],
        known: Mapping[str, OutputPort],
    ) -> None:
        """Begins with no boxes; see the attributes."""
        self.builder = builder
        self.replaced = replaced
        self.known = dict(known)
        self.added: list[System] = []

    def add(
        self,
        build: Callable[[], System],
        output: str,
        *,
        name: str = "",
        known_as: str = "",
        sources: Mapping[str, OutputPort] | None = None,
        later: Collection[str] = (),
    ) -> System:
        """Adds a box.

        Args:
            build: makes it.
            output: of it, which later boxes are given.
            name: of a box that can be replaced: ``build`` is not called then.
            known_as: what the output is called; by default its own name.
            sources: what it is given, in place of ``known``.
            later: inputs that are not connected yet.

        Raises:
            ValueError: an input that no output is for, or one of another kind.
        """
        system = self.replaced.get(name) or build()
        self.builder.AddSystem(system)
        self.added.append(system)
        given = self.known if sources is None else sources
        for index in range(system.num_input_ports()):
            port = system.get_input_port(index)
            if port.get_name() not in later:
                self._connect(system, port, given)
        self.known[known_as or output] = system.GetOutputPort(output)
        return system

    def _connect(
        self, system: System, port: InputPort, given: Mapping[str, OutputPort]
    ) -> None:
        name, box = port.get_name(), system.get_name()
        if name not in given:
            raise ValueError(
                f"{box} has an input {name!r}, and nothing here gives that; "
                f"there are {', '.join(sorted(given))}"
            )
        source = given[name]
        if port.get_data_type() != source.get_data_type():
            raise ValueError(
                f"the input {name!r} of {box} must be "
                f"{_KINDS[source.get_data_type()]}, as the output of that name "
                "is"
            )
        self.builder.Connect(source, port)


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
