"""Text of mesh files, whoever wrote it."""

import re
from collections.abc import Iterator

import numpy as np

_NO_NUMBER = re.compile(r"([-+]?)\d+\.#(?:IND|Q?NAN|SNAN|INF)\w*", re.I)
"""How Microsoft's C library writes what is not finite."""


def decoded(content: bytes) -> str:
    r"""Returns text with "\n" at line ends and without byte order mark.

    UTF-16 where its mark says so, else UTF-8, else Latin-1.
    """
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = content.decode("utf-16", errors="replace")
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return _NO_NUMBER.sub("nan", text) if ".#" in text else text


def logical_lines(text: str) -> Iterator[tuple[int, str]]:
    r"""Yields number and content of lines, joined where one ends in "\".

    Comments of whole lines and empty lines are left out.
    """
    begun, first = "", 0
    for number, line in enumerate(text.split("\n"), 1):
        stripped = line.strip()
        if stripped.startswith("#"):
            continue
        if not begun:
            first = number
        if stripped.endswith("\\"):
            begun += stripped[:-1] + " "
            continue
        whole, begun = (begun + stripped).strip(), ""
        if whole:
            yield first, whole
    if begun.strip():
        yield first, begun.strip()


def without_comment(line: str) -> str:
    """Cuts what follows "#"; for lines of numbers, where no name has one."""
    return line.split("#", 1)[0]


def number(word: str) -> float:
    """Reads a number; "D" as an exponent, as Fortran writes it, counts.

    Raises:
        ValueError: it is none.
    """
    try:
        return float(word)
    except ValueError:
        return float(re.sub("[dD]", "e", word, count=1))


def numbers(words: list[str]) -> np.ndarray:
    """Reads numbers.

    Raises:
        ValueError: one is none.
    """
    try:
        return np.array(words, dtype=float)
    except ValueError:
        return np.array([number(word) for word in words], dtype=float)
