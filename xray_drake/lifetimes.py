"""Lets Python free systems, diagrams and contexts that nobody uses any more.

Drake frees systems written in Python from 1.58 on; in earlier versions they
stay until the process ends. Python's garbage collector does not see all that
keeps something of Drake's, so this has to be avoided:

- an output port or a cache entry that is computed by a method of its system:
  :class:`CollectableLeafSystem`;
- a system, or what a diagram has as an attribute, that keeps a body, joint,
  frame or port of a MultibodyPlant: keep the plant, and their indices;
- ``system.GetMyContextFromRoot(root)`` where the root is the system's own
  context: :func:`my_context`.
"""

import inspect
from collections.abc import Callable
from typing import Any
from weakref import WeakMethod

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import (
    Context,
    DependencyTicket,
    InputPort,
    LeafOutputPort,
    LeafSystem,
    System,
    ValueProducer,
)


class CollectableLeafSystem(LeafSystem):
    """A LeafSystem that is freed when nobody uses it any more.

    A port or a cache entry keeps the function that computes it. If that is one
    of the system's own methods, as it usually is, it keeps the system, and with
    it the whole diagram. Here the method is referred to weakly. Other functions
    are kept as they are, so a lambda must not refer to the system.
    """

    def DeclareAbstractOutputPort(
        self, *args: Any, **kwargs: Any
    ) -> LeafOutputPort:
        """As LeafSystem's, with the same arguments."""
        return super().DeclareAbstractOutputPort(
            *map(_weak, args),
            **{name: _weak(value) for name, value in kwargs.items()},
        )

    def DeclareVectorOutputPort(
        self, *args: Any, **kwargs: Any
    ) -> LeafOutputPort:
        """As LeafSystem's, with the same arguments."""
        return super().DeclareVectorOutputPort(
            *map(_weak, args),
            **{name: _weak(value) for name, value in kwargs.items()},
        )

    def declare_input(self, name: str, model: Any) -> InputPort:
        """Declares an abstract input port that takes what ``model`` is."""
        return self.DeclareAbstractInputPort(name, Value(model))

    def declare_output(
        self,
        name: str,
        model: Any,
        compute: Callable[[Context], Any],
        *sources: Any,
    ) -> LeafOutputPort:
        """Declares an abstract output port.

        Args:
            name: of the port.
            model: what it gives is of the type of this.
            compute: returns what it gives.
            *sources: the input ports, cache entries and tickets that this
                depends on; by default all input ports.
        """
        computed = _weak(compute)
        tickets = {
            s if isinstance(s, DependencyTicket) else s.ticket()
            for s in sources
        }
        return super().DeclareAbstractOutputPort(
            name,
            alloc=lambda: Value(model),
            calc=lambda context, output: output.set_value(computed(context)),
            prerequisites_of_calc=tickets or {self.all_input_ports_ticket()},
        )

    def DeclareCacheEntry(
        self,
        *,
        description: str,
        allocate: Callable[[], AbstractValue],
        calc: Callable[[Context, AbstractValue], None],
        prerequisites_of_calc: set[DependencyTicket],
    ) -> "CachedValue":
        """As LeafSystem's, but takes the functions of the ValueProducer.

        Args:
            description: of the value, for messages.
            allocate: returns a value of the right type.
            calc: computes it.
            prerequisites_of_calc: what it depends on.
        """
        entry = super().DeclareCacheEntry(
            description=description,
            value_producer=ValueProducer(
                allocate=_weak(allocate), calc=_weak(calc)
            ),
            prerequisites_of_calc=prerequisites_of_calc,
        )
        return CachedValue(self, entry.cache_index())


class CachedValue:
    """A cache entry of a system, which, unlike Drake's, does not keep it."""

    def __init__(self, system: LeafSystem, index: Any) -> None:
        """Refers to an entry by its index."""
        self._system = system
        self._index = index

    def ticket(self) -> DependencyTicket:
        """Returns what depends on the value needs as a prerequisite."""
        return self._system.get_cache_entry(self._index).ticket()

    def Eval(self, context: Context) -> Any:
        """Returns the value, computed if need be."""
        return self._system.get_cache_entry(self._index).Eval(context)


def my_context(system: System, root: Context) -> Context:
    """Returns a system's context, as ``system.GetMyContextFromRoot(root)``.

    Args:
        system: the root's own, or one that it contains.
        root: a root context.
    """
    try:
        system.ValidateContext(root)
    except RuntimeError:
        return system.GetMyContextFromRoot(root)
    return root


def _weak(argument: Any) -> Any:
    """Returns a bound method as a function that does not keep its object."""
    if not inspect.ismethod(argument):
        return argument
    method = WeakMethod(argument)

    def call(*args: Any) -> Any:
        bound = method()
        assert bound is not None, "the system that computes this is gone"
        return bound(*args)

    return call
