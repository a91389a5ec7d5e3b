"""What a field of a configuration may be, and how a message says so."""

import math
import numbers
import re
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np


class Rule(Protocol):
    """What a field may be."""

    def broken_by(self, value: Any) -> str:
        """Returns what is wrong with a value, e.g. "it must be from 0 to 1".

        Empty where nothing is.
        """


@dataclass(frozen=True)
class Interval:
    """Numbers between two finite bounds.

    Attributes:
        low, high: the bounds.
        with_low, with_high: they are in it.
        whole: whole numbers only.
    """

    low: float
    high: float
    with_low: bool = True
    with_high: bool = True
    whole: bool = False

    @staticmethod
    def of(text: str, *, whole: bool = False) -> "Interval":
        """Reads an interval as it is written: "[0, 1]", "(0, 5]".

        Raises:
            ValueError: it is none, is empty, or has an infinite bound.
        """
        found = re.fullmatch(r"([\[(])([^,]+),([^,]+)([\])])", text)
        if found is None:
            raise ValueError(f"{text!r} is not an interval as [0, 1] is")
        low, high = (
            int(bound) if re.fullmatch(r"\s*-?\d+", bound) else float(bound)
            for bound in found.group(2, 3)
        )
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"{text!r} is empty or has no end")
        return Interval(
            low, high, found.group(1) == "[", found.group(4) == "]", whole
        )

    def __str__(self) -> str:
        low, high = (
            str(bound) if isinstance(bound, int) else f"{bound:g}"
            for bound in (self.low, self.high)
        )
        if self.with_low and self.with_high:
            return f"from {low} to {high}"
        return (
            f"{'at least' if self.with_low else 'above'} {low} and "
            f"{'at most' if self.with_high else 'below'} {high}"
        )

    def broken_by(self, value: Any) -> str:
        """Returns what is wrong with a value."""
        kind = numbers.Integral if self.whole else numbers.Real
        if not isinstance(value, kind) or isinstance(value, bool | np.bool_):
            what = "whole number" if self.whole else "number"
            return f"it must be a {what} {self}"
        number: Any = value
        after = self.low <= number if self.with_low else self.low < number
        before = number <= self.high if self.with_high else number < self.high
        return "" if after and before else f"it must be {self}"


@dataclass(frozen=True)
class Numbers:
    """A list of numbers.

    Attributes:
        each: what each may be.
        lengths: how many there may be.
    """

    each: Interval
    lengths: tuple[int, ...]

    def broken_by(self, value: Any) -> str:
        """Returns what is wrong with a value."""
        if not isinstance(value, list | tuple | np.ndarray):
            return "it must be a list of numbers"
        if len(value) not in self.lengths:
            *others, last = map(str, self.lengths)
            wanted = f"{', '.join(others)} or {last}" if others else last
            return f"it must be {wanted} numbers, not {len(value)}"
        said = next(filter(None, map(self.each.broken_by, value)), "")
        return said.replace("it", "each", 1)


@dataclass(frozen=True)
class Choice:
    """One of some names."""

    names: tuple[str, ...]

    def broken_by(self, value: Any) -> str:
        """Returns what is wrong with a value."""
        if value in self.names:
            return ""
        return f"choose one of {', '.join(self.names)}"
