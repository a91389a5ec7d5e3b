"""Tells errors that are meant for the user from faults of a program."""

import dis

BREAKDOWNS = (RuntimeError, SystemExit)
"""What a simulation raises that breaks down.

Drake's failed assertions arrive in Python as a ``SystemExit``.
"""

_RAISE = dis.opmap["RAISE_VARARGS"]


def is_fault(error: BaseException) -> bool:
    """Says whether an error is more than a message for the user.

    Messages are what the machine lacks (files, memory), errors of this
    package's own kinds, and a ``ValueError`` or ``RuntimeError`` that a
    ``raise`` of this package raised. The same of NumPy or Drake, and a
    ``SystemExit`` (see ``BREAKDOWNS``) are faults: only
    their kind and traceback tell where to look.
    """
    if isinstance(error, OSError | MemoryError | KeyboardInterrupt):
        return False
    if _is_ours(type(error).__module__):
        return False
    if not isinstance(error, ValueError | RuntimeError):
        return True
    at = error.__traceback__
    while at is not None and at.tb_next is not None:
        at = at.tb_next
    if at is None:
        return True
    raised = at.tb_frame.f_code.co_code[at.tb_lasti] == _RAISE
    module = at.tb_frame.f_globals.get("__name__", "")
    return not (raised and _is_ours(module))


def one_line(error: BaseException) -> str:
    """Returns an error's message, after its kind where it is a fault."""
    text = " ".join(str(error).split())
    kind = type(error).__name__
    if is_fault(error):
        return f"{kind}: {text}"
    return text or kind


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] == "xray_drake"
