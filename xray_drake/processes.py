"""Runs jobs, each in a process of its own, and tells what comes of them.

A process ends with its job, so that memory does not grow from job to job.
"""

import gc
import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from xray_drake.threads import limit_threads

ATTEMPTS = 2
"""How often a job is tried whose process dies (killed for memory, say)."""

Job = TypeVar("Job")
Value = TypeVar("Value")


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
            a fault of the program.
    """

    job: Job
    reason: str


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


class JobProcesses(Generic[Job, Value]):
    """Runs jobs over processes of one thread each; an iterator of events.

    Iterate over it once. Ctrl-C, an exception or the end of the iteration
    stops all processes.

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
    """

    def __init__(
        self,
        work: Callable[[Job, Callable[[Value], None]], None],
        jobs: Iterable[Job],
        *,
        workers: int,
        preload: Sequence[str] = (),
        remaining: Callable[[Job, Value], Job | None] | None = None,
    ) -> None:
        self._work = work
        self._waiting = [(job, 1) for job in jobs][::-1]
        self._workers = workers
        self._preload = list(preload)
        self._remaining = remaining

    def add(self, job: Job) -> None:
        """Adds a job while others run; it comes next."""
        self._waiting.append((job, 1))

    def __iter__(self) -> Iterator[Sent[Job, Value] | Failed[Job] | Died[Job]]:
        limit_threads()  # the processes', which inherit it
        context = multiprocessing.get_context("forkserver")
        # Forked from a server that has imported everything, a process starts
        # at once; one that is spawned takes seconds.
        context.set_forkserver_preload(self._preload)
        # A job of which nothing is left is None.
        running: dict[Connection, tuple[BaseProcess, Job | None, int]] = {}
        with ExitStack() as stack:
            stack.callback(_stop, running)
            while self._waiting or running:
                while self._waiting and len(running) < self._workers:
                    begun, attempt = self._waiting.pop()
                    receiver, sender = context.Pipe(duplex=False)
                    process: BaseProcess = context.Process(
                        target=_run, args=(self._work, begun, sender)
                    )
                    process.start()
                    sender.close()
                    running[receiver] = process, begun, attempt
                for ready in wait(list(running)):
                    assert isinstance(ready, Connection)
                    process, job, attempt = running[ready]
                    kind, value = _receive(ready)
                    if kind == "sent":
                        assert job is not None
                        yield Sent(job, value)
                        if self._remaining is not None:
                            left = self._remaining(job, value)
                            running[ready] = process, left, 1
                        continue
                    del running[ready]
                    ready.close()
                    process.join()
                    if job is None or kind == "done":
                        continue
                    if kind == "failed":
                        yield Failed(job, value)
                        continue
                    again = attempt < ATTEMPTS
                    if again:
                        self._waiting.append((job, attempt + 1))
                    yield Died(job, process.exitcode, attempt, again)


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
        work(job, lambda value: sender.send(("sent", value)))
    except KeyboardInterrupt:
        return
    except (ValueError, RuntimeError, OSError) as error:
        sender.send(("failed", " ".join(str(error).split())))
    except Exception as error:
        reason = " ".join(str(error).split())
        sender.send(("failed", f"{type(error).__name__}: {reason}"))
        raise  # for its traceback
    else:
        sender.send(("done", None))


def _stop(running: dict) -> None:
    for process, *_ in running.values():
        process.terminate()
    for process, *_ in running.values():
        process.join()
