"""The policies by name: the package's, those of installed ones, and yours.

Imports nothing but what is asked for, so that ``--help`` can list the names.
"""

import pickle
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from xray_drake.policy.ranking import Ranking

GROUP = "xray_drake.policies"
"""Entry points of this group name policies of installed packages."""


class PolicyError(ValueError):
    """A policy that cannot be used; the message is one line."""


@dataclass(frozen=True)
class Policy:
    """What a policy consists of: a ranking, and what it must be given.

    Attributes:
        ranking: scores the objects.
        memory: the inference sees the depth image as remembered.
        outlook: the ranking imagines removals.
        truth: the ranking knows where the target is.
        blind: the ranking does not look at the distribution: whatever infers
            it, the policy does the same.
        source: where a policy that is not the package's own comes from, for
            the record.
    """

    ranking: "Ranking"
    memory: bool = False
    outlook: bool = False
    truth: bool = False
    blind: bool = False
    source: str = ""


_OWN = (
    *("xray", "largest", "random"),
    *("oracle", "memory", "lookahead", "grasp_aware", "combined"),
)
"""The paper's, and those beyond; see :mod:`xray_drake.policy.policies`."""


class Policies(Mapping[str, Policy]):
    """Name to policy; one that is asked for is imported.

    Names are those of the package, of :func:`register_policy`, and of entry
    points of :data:`GROUP`. A name ``module:object``, which needs no
    registration, is found as well. An entry point, or such an object, is a
    :class:`Policy` or a ranking alone. The package's own names stand for its
    own policies.

    Attributes:
        registered: the policies of :func:`register_policy`.
    """

    def __init__(self) -> None:
        """Finds the names; nothing is imported."""
        place = "xray_drake.policy.policies"
        self._points = {
            name: EntryPoint(name, f"{place}:{name.upper()}", GROUP)
            for name in _OWN
        }
        for point in sorted(entry_points(group=GROUP)):
            self._points.setdefault(point.name, point)
        self._loaded: dict[str, Policy] = {}
        self.registered: dict[str, Policy] = {}

    def __iter__(self) -> Iterator[str]:
        return iter((*self._points, *self.registered))

    def __len__(self) -> int:
        return len(self._points) + len(self.registered)

    def __getitem__(self, name: str) -> Policy:
        """Returns a policy.

        Raises:
            PolicyError: there is none of that name, or it cannot be imported.
        """
        if name in self.registered:
            return self.registered[name]
        if name not in self._loaded:
            self._loaded[name] = self._load(name)
        return self._loaded[name]

    def register(self, name: str, policy: Policy) -> None:
        """Adds a policy; see :func:`register_policy`."""
        if name in self._points or not name or {*name} & {*",: \n"}:
            raise PolicyError(
                f"{name!r} cannot be registered: choose a name without commas, "
                f"colons and spaces that is none of {', '.join(self._points)}"
            )
        self.registered[name] = policy

    def _load(self, name: str) -> Policy:
        point = self._points.get(name)
        if point is None and ":" in name:
            point = EntryPoint(name, name, GROUP)
        if point is None:
            raise PolicyError(
                f"no policy {name!r}: choose one of {', '.join(self)}, or "
                "module:object of your own"
            )
        try:
            found = point.load()
        # Whatever the user's module raises.
        except Exception as error:
            raise PolicyError(
                f"the policy {name!r} cannot be imported from {point.value}: "
                f"{type(error).__name__}: {' '.join(str(error).split())}"
            ) from error
        if not callable(getattr(found, "ranking", found)):
            raise PolicyError(
                f"the policy {name!r}: {point.value} is neither a Policy nor a "
                f"ranking, but {found!r}"
            )
        policy = found if isinstance(found, Policy) else Policy(found)
        if name in _OWN:
            return policy
        source = point.value
        if point.dist is not None:
            source += f" ({point.dist.name} {point.dist.version})"
        return replace(policy, source=source)


POLICIES = Policies()
"""All policies, by the names that scenario, command line and records use."""


def register_policy(
    name: str,
    ranking: "Ranking",
    *,
    memory: bool = False,
    outlook: bool = False,
    truth: bool = False,
    blind: bool = False,
) -> Policy:
    """Gives a policy of your own a name, in this process and its workers.

    Args:
        name: for scenarios, commands and records. One that was registered
            before is replaced.
        ranking: scores the objects; see
            :class:`~xray_drake.policy.ranking.Ranking`. Workers import it, so
            for a benchmark it must stand in a module.
        memory: see :class:`Policy`, as for the others.
        outlook: the ranking imagines removals.
        truth: the ranking knows where the target is.
        blind: the ranking does not look at the distribution.

    Returns:
        The policy.

    Raises:
        PolicyError: the name is another policy's, or no name.
    """
    place: Any = ranking
    if not hasattr(place, "__qualname__"):
        place = type(ranking)
    source = f"{place.__module__}:{place.__qualname__}"
    policy = Policy(ranking, memory, outlook, truth, blind, source)
    POLICIES.register(name, policy)
    return policy


def for_workers(names: Iterable[str]) -> dict[str, Policy]:
    """Returns those of the policies that worker processes have to be told.

    They are pickled on their way there.

    Raises:
        PolicyError: a policy that another process cannot import.
    """
    told = {
        n: POLICIES.registered[n] for n in names if n in POLICIES.registered
    }
    for name, policy in told.items():
        try:
            importable = b"__main__" not in pickle.dumps(policy)
        except (AttributeError, TypeError, pickle.PicklingError):
            importable = False
        if not importable:
            raise PolicyError(
                f"worker processes cannot import the policy {name!r} "
                f"({policy.source}): put its ranking into a module"
            )
    return told
