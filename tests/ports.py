"""Ports of systems, for tests."""

from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, System
from pydrake.systems.sensors import (
    ImageDepth32F,
    ImageLabel16I,
    ImageRgba8U,
)

IMAGES = {
    "color_image": ImageRgba8U,
    "depth_image": ImageDepth32F,
    "label_image": ImageLabel16I,
}


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


def fix_inputs(system: System, context: Context, **inputs: Any) -> None:
    """Fixes input ports; arrays become vectors, or images of the port's kind.

    All else is an abstract value.
    """
    for name, value in inputs.items():
        if not isinstance(value, np.ndarray):
            value = AbstractValue.Make(value)
        elif value.ndim > 1:
            kind = IMAGES[name.removeprefix("seen_")]
            image = kind(value.shape[1], value.shape[0])
            image.mutable_data[:] = value.reshape(*value.shape[:2], -1)
            value = AbstractValue.Make(image)
        system.GetInputPort(name).FixValue(context, value)


def context_with(system: System, **inputs: Any) -> Context:
    """Returns a context of a system alone, with these inputs."""
    context = system.CreateDefaultContext()
    fix_inputs(system, context, **inputs)
    return context
