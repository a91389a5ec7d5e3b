"""Runs jobs, each in a process of its own, and tells what comes of them.

A process ends with its job, so that memory does not grow from job to job.
"""

import gc
import multiprocessing
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, Generic, TypeVar

from xray_drake.faults import is_fault, one_line
from xray_drake.threads import one_thread_inherited

ATTEMPTS = 2
"""How often a job is tried whose process dies (killed for memory, say)."""

_LONGEST_TMPDIR = 70
"""Bytes; the names of a socket and of its folder follow."""

Job = TypeVar("Job")
Value = TypeVar("Value")


class JobError(RuntimeError):
    """What a job raised; its note is the traceback, where that is a fault's."""


@dataclass(frozen=True)
class Sent(Generic[Job, Value]):
    """A job sent a value.

    Attributes:
        job: as it was then, see ``remaining`` of :class:`JobProcesses`.
        value: what it sent.
    """

    job: Job
    value: Value


@dataclass(frozen=True)
class Failed(Generic[Job]):
    """A job raised an exception; it is not tried again.

    Attributes:
        job: which.
        reason: one line; the exception's message, after its kind where it is
            a fault of the program, see :func:`~xray_drake.faults.is_fault`.
        traceback: of a fault; empty where the message says it all.
    """

    job: Job
    reason: str
    traceback: str = ""

    def error(self, message: str) -> JobError:
        """Returns an error to raise."""
        error = JobError(message)
        if self.traceback:
            error.add_note(self.traceback)
        return error


@dataclass(frozen=True)
class Died(Generic[Job]):
    """The process of a job ended before the job did.

    Attributes:
        job: what was not done of it.
        status: of the process; the negative number of a signal.
        attempts: so many processes died over it.
        again: it is tried again.
    """

    job: Job
    status: int | None
    attempts: int
    again: bool

    @property
    def reason(self) -> str:
        """How, in words that follow "its process"."""
        if self.status is None or self.status >= 0:
            text = f"ended with status {self.status}"
        else:
            try:
                name = signal.Signals(-self.status).name
            except ValueError:
                name = f"signal {-self.status}"
            text = f"was killed by {name}"
            if name == "SIGKILL":
                text += ", perhaps since memory ran out"
        return f"{text} ({self.attempts} times)" if self.attempts > 1 else text


@dataclass(frozen=True)
class Overran(Generic[Job]):
    """A job took too long; it was stopped, and is not tried again.

    Attributes:
        job: what was not done of it.
        limit: s.
    """

    job: Job
    limit: float


@dataclass
class _Running(Generic[Job]):
    """A process at work.

    Attributes:
        process: it.
        job: what is left to do; ``None`` where nothing is.
        attempt: how many were begun over it.
        deadline: ``time.monotonic()`` at which it is stopped.
    """

    process: BaseProcess
    job: Job | None
    attempt: int
    deadline: float = float("inf")


class JobProcesses(Generic[Job, Value]):
    """Runs jobs over processes of one thread each; an iterator of events.

    Iterate over it once. Ctrl-C, an exception or the end of the iteration
    stops all processes.

    The program's main module is not imported by them: a script needs no
    ``if __name__ == "__main__"``, and nothing of what travels to them may be
    defined in it.

    Args:
        work: ``work(job, send)`` does a job in a process, and sends what comes
            of it. A function of a module's top level, or a partial of one;
            what it is given and what it sends is pickled.
        jobs: in the order in which they are begun.
        workers: processes at a time.
        preload: modules imported once for all processes, by their names. All
            of one program share what the first asked for.
        remaining: what is left of a job after a value: from there it is tried
            again, as often as a new one. ``None`` where nothing is left. By
            default the whole job is, whatever it sent.
        limit: s that a job may take to each value, and to its end; ``None``
            for no limit.
    """

    def __init__(
        self,
        work: Callable[[Job, Callable[[Value], None]], None],
        jobs: Iterable[Job],
        *,
        workers: int,
        preload: Sequence[str] = (),
        remaining: Callable[[Job, Value], Job | None] | None = None,
        limit: float | None = None,
    ) -> None:
        self._work = work
        self._waiting = [(job, 1) for job in jobs][::-1]
        self._workers = workers
        self._preload = list(preload)
        self._remaining = remaining
        self._limit = float("inf") if limit is None else limit

    def add(self, job: Job) -> None:
        """Adds a job while others run; it comes next."""
        self._waiting.append((job, 1))

    def __iter__(
        self,
    ) -> Iterator[Sent[Job, Value] | Failed[Job] | Died[Job] | Overran[Job]]:
        running: dict[Connection, _Running[Job]] = {}
        with ExitStack() as stack:
            stack.callback(_stop, running)
            while self._waiting or running:
                while self._waiting and len(running) < self._workers:
                    job, attempt = self._waiting.pop()
                    receiver, process = self._start(job)
                    running[receiver] = _Running(process, job, attempt)
                first = min(one.deadline for one in running.values())
                patience = max(0.0, first - time.monotonic())
                ready = wait(
                    list(running),
                    None if patience == float("inf") else patience,
                )
                if not ready:
                    yield from self._stop_overdue(running)
                for connection in ready:
                    assert isinstance(connection, Connection)
                    yield from self._hear(running, connection)

    def _start(self, job: Job) -> tuple[Connection, BaseProcess]:
        context = multiprocessing.get_context("forkserver")
        # Forked from a server that has imported everything, a process starts
        # at once; one that is spawned takes seconds.
        context.set_forkserver_preload(self._preload)
        receiver, sender = context.Pipe(duplex=False)
        process: BaseProcess = context.Process(
            target=_run, args=(self._work, job, sender)
        )
        with _without_main(), _short_paths(), one_thread_inherited():
            process.start()
        sender.close()
        return receiver, process

    def _hear(
        self, running: dict[Connection, _Running[Job]], connection: Connection
    ) -> Iterator[Sent[Job, Value] | Failed[Job] | Died[Job]]:
        """Takes one message of a process, or its end."""
        one = running[connection]
        kind, value = _receive(connection)
        one.deadline = time.monotonic() + self._limit
        if kind == "begun":
            return
        if kind == "sent":
            assert one.job is not None
            yield Sent(one.job, value)
            if self._remaining is not None:
                one.job = self._remaining(one.job, value)
                one.attempt = 1
            return
        del running[connection]
        connection.close()
        one.process.join()
        if one.job is None or kind == "done":
            return
        if kind == "failed":
            yield Failed(one.job, *value)
            return
        again = one.attempt < ATTEMPTS
        if again:
            self._waiting.append((one.job, one.attempt + 1))
        yield Died(one.job, one.process.exitcode, one.attempt, again)

    def _stop_overdue(
        self, running: dict[Connection, _Running[Job]]
    ) -> Iterator[Overran[Job]]:
        now = time.monotonic()
        for connection, one in list(running.items()):
            if one.deadline > now:
                continue
            del running[connection]
            # Not to be refused, as native code may refuse SIGTERM.
            one.process.kill()
            one.process.join()
            connection.close()
            if one.job is not None:
                yield Overran(one.job, self._limit)


def can_start_processes() -> bool:
    """Says whether this process may have others; a daemonic one may not."""
    return not multiprocessing.current_process().daemon


def _receive(connection: Connection) -> tuple[str, Any]:
    try:
        return connection.recv()
    except (EOFError, OSError):  # the latter in the middle of a message
        return "died", None


def _run(work: Callable, job: object, sender: Connection) -> None:
    """Does a job; the body of its process."""
    # What is imported stays: the collector need not look at it.
    gc.freeze()
    try:
        sender.send(("begun", None))
        work(job, lambda value: sender.send(("sent", value)))
    except KeyboardInterrupt:
        return
    except (Exception, SystemExit) as error:  # the latter is Drake's
        trace = traceback.format_exc() if is_fault(error) else ""
        sender.send(("failed", (one_line(error), trace)))
    else:
        sender.send(("done", None))


@contextmanager
def _without_main() -> Iterator[None]:
    """Hides the main module from processes that are started meanwhile.

    Each would import it, and so run a script that is not guarded.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def _short_paths() -> Iterator[None]:
    """Puts the sockets of processes started meanwhile where they may be.

    A socket's path has 107 bytes at most; a TMPDIR of a cluster has more.
    """
    before = tempfile.tempdir
    if len(os.fsencode(tempfile.gettempdir())) > _LONGEST_TMPDIR:
        tempfile.tempdir = "/tmp"
    try:
        yield
    finally:
        tempfile.tempdir = before


def _stop(running: dict[Connection, _Running]) -> None:
    for one in running.values():
        one.process.terminate()
    for one in running.values():
        one.process.join()
