"""Runs jobs, each in a process of its own, and yields what comes of them.

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
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any, Generic, Literal, TypeVar

from xray_drake.faults import is_fault, one_line
from xray_drake.threads import one_thread_inherited

ATTEMPTS = 2
"""How often a job is tried whose process dies (killed for memory, say)."""

_LONGEST_TMPDIR = 70
"""Bytes; the names of a socket and of its folder follow."""

Job = TypeVar("Job")


class JobError(RuntimeError):
    """A job that was not done; its note is the traceback of a fault."""


@dataclass(frozen=True)
class Lost(Generic[Job]):
    """A job that was not done and is not tried again.

    Attributes:
        job: what was not done of it.
        cause: "failed": it raised an exception; "died": its process ended
            before it did; "overran": it took longer than its limit.
        reason: one line; the exception's message, after its kind where it is
            a fault of the program, see :func:`~xray_drake.faults.is_fault`.
        traceback: of a fault; empty where the message says it all.
        status: of a process that died; the negative number of a signal.
    """

    job: Job
    cause: Literal["failed", "died", "overran"]
    reason: str
    traceback: str = ""
    status: int | None = None

    def error(self, name: str, advice: str = "") -> JobError:
        """Returns an error to raise.

        Args:
            name: of the job.
            advice: what to do.
        """
        error = JobError(f"{name}: {self.reason}{advice and '; ' + advice}")
        if self.traceback:
            error.add_note(self.traceback)
        return error


def run_jobs(
    work: Callable[[Job], Any],
    jobs: Iterable[Job],
    *,
    workers: int,
    preload: Sequence[str] = (),
    name: Callable[[Job], str] = str,
    advice: str = "",
    lost: Callable[[Lost[Job]], Any] | None = None,
    remaining: Callable[[Job, Any], Job | None] | None = None,
    limit: float | None = None,
) -> Iterator[tuple[Job, Any]]:
    """Runs jobs over processes of one thread each; yields jobs and values.

    Ctrl-C, an exception or the end of the iteration stops all processes. A job
    whose process dies is tried again, :data:`ATTEMPTS` times in all.

    The program's main module is not imported by them: a script needs no
    ``if __name__ == "__main__"``, and nothing of what travels to them may be
    defined in it.

    Args:
        work: does a job: returns a value, or is a generator of several. A
            function of a module's top level, or a partial of one; what it is
            given and what it returns is pickled.
        jobs: in the order in which they are begun.
        workers: processes at a time; 0 runs the jobs in this process, as does
            a process that may have no others (a daemonic one).
        preload: modules imported once for all processes, by their names. All
            of one program share what the first asked for.
        name: of a job, for messages.
        advice: what to do where a job is lost, for messages.
        lost: returns a value in place of a job that was not done, or raises;
            by default a :class:`JobError` is raised.
        remaining: what is left of a job after a value: from there it is tried
            again, as often as a new one. ``None`` where nothing is left. By
            default the whole job is, whatever it yielded.
        limit: s that a job may take to each value, and to its end; ``None``
            for no limit. It does not hold in this process.

    Yields:
        A job, as it was then (see ``remaining``), and a value of it.

    Raises:
        JobError: a job was not done; the message names it.
    """
    pool = _Pool(work, jobs, workers, preload, remaining, limit)
    with closing(pool.events()) as events:
        for job, value in events:
            if not isinstance(value, Lost):
                yield job, value
                continue
            if lost is None:
                raise value.error(name(job), advice)
            answer = lost(value)
            yield job, answer
            pool.go_on(job, answer)


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


class _Pool(Generic[Job]):
    """The processes of :func:`run_jobs`; arguments as there."""

    def __init__(
        self,
        work: Callable[[Job], Any],
        jobs: Iterable[Job],
        workers: int,
        preload: Sequence[str],
        remaining: Callable[[Job, Any], Job | None] | None,
        limit: float | None,
    ) -> None:
        self._work = work
        self._waiting = [(job, 1) for job in jobs][::-1]
        self._workers = workers
        self._preload = list(preload)
        self._remaining = remaining
        self._limit = float("inf") if limit is None else limit
        self._running: dict[Connection, _Running[Job]] = {}

    def go_on(self, job: Job, value: Any) -> None:
        """Puts what is left of a job after a value first in the queue."""
        left = self._remaining(job, value) if self._remaining else None
        if left is not None:
            self._waiting.append((left, 1))

    def events(self) -> Generator[tuple[Job, Any], None, None]:
        """Yields jobs and what comes of them; stops the processes at last."""
        if not self._workers or multiprocessing.current_process().daemon:
            yield from self._here()
            return
        try:
            while self._waiting or self._running:
                while self._waiting and len(self._running) < self._workers:
                    self._start(*self._waiting.pop())
                first = min(one.deadline for one in self._running.values())
                patience = max(0.0, first - time.monotonic())
                ready = wait(
                    list(self._running),
                    None if patience == float("inf") else patience,
                )
                if not ready:
                    yield from self._stop_overdue()
                for connection in ready:
                    assert isinstance(connection, Connection)
                    yield from self._hear(connection)
        finally:
            for one in self._running.values():
                one.process.terminate()
            for one in self._running.values():
                one.process.join()

    def _here(self) -> Iterator[tuple[Job, Any]]:
        while self._waiting:
            job, _ = self._waiting.pop()
            try:
                for value in _values(self._work, job):
                    yield job, value
            except (Exception, SystemExit) as error:
                yield job, Lost(job, "failed", *_told(error))

    def _start(self, job: Job, attempt: int) -> None:
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
        self._running[receiver] = _Running(process, job, attempt)

    def _hear(self, connection: Connection) -> Iterator[tuple[Job, Any]]:
        """Takes one message of a process, or its end."""
        one = self._running[connection]
        kind, value = _receive(connection)
        one.deadline = time.monotonic() + self._limit
        if kind == "begun":
            return
        if kind == "sent":
            assert one.job is not None
            yield one.job, value
            if self._remaining is not None:
                one.job = self._remaining(one.job, value)
                one.attempt = 1
            return
        del self._running[connection]
        connection.close()
        one.process.join()
        if one.job is None or kind == "done":
            return
        if kind == "failed":
            yield one.job, Lost(one.job, "failed", *value)
        elif one.attempt < ATTEMPTS:
            self._waiting.append((one.job, one.attempt + 1))
        else:
            status = one.process.exitcode
            reason = f"its process {how_it_died(status)} ({ATTEMPTS} times)"
            yield one.job, Lost(one.job, "died", reason, status=status)

    def _stop_overdue(self) -> Iterator[tuple[Job, Lost[Job]]]:
        now = time.monotonic()
        for connection, one in list(self._running.items()):
            if one.deadline > now:
                continue
            del self._running[connection]
            # Not to be refused, as native code may refuse SIGTERM.
            one.process.kill()
            one.process.join()
            connection.close()
            if one.job is not None:
                reason = f"it takes longer than {self._limit:g} s"
                yield one.job, Lost(one.job, "overran", reason)


def how_it_died(status: int | None) -> str:
    """Says how a process ended, in words that follow "its process".

    Args:
        status: of the process; the negative number of a signal.
    """
    if status is None or status >= 0:
        return f"ended with status {status}"
    try:
        signal_name = signal.Signals(-status).name
    except ValueError:
        signal_name = f"signal {-status}"
    memory = ", perhaps since memory ran out" * (signal_name == "SIGKILL")
    return f"was killed by {signal_name}{memory}"


def _values(work: Callable[[Job], Any], job: Job) -> Iterator[Any]:
    found = work(job)
    if isinstance(found, Iterator):
        yield from found
    else:
        yield found


def _told(error: BaseException) -> tuple[str, str]:
    """Returns an error in one line, and the traceback of a fault."""
    return one_line(error), traceback.format_exc() if is_fault(error) else ""


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
        for value in _values(work, job):
            sender.send(("sent", value))
    except KeyboardInterrupt:
        return
    except (Exception, SystemExit) as error:  # the latter is Drake's
        sender.send(("failed", _told(error)))
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
