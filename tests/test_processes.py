import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from xray_drake.processes import (
    ATTEMPTS,
    Died,
    Failed,
    JobProcesses,
    Overran,
    Sent,
)

Send = Callable[[int], None]


def count_up(job: int, send: Send) -> None:
    for value in range(job):
        send(value)


def test_a_job_sends_in_order_and_all_are_done() -> None:
    events = list(JobProcesses(count_up, [2, 0, 3], workers=2))
    assert all(isinstance(event, Sent) for event in events)
    for job in (2, 0, 3):
        sent = [e.value for e in events if e.job == job]
        assert sent == list(range(job))


def wait_for_file(folder: Path, job: str, send: Callable[[str], None]) -> None:
    """Job "slow" is done after "quick", whose result was received."""
    if job == "slow":
        while not (folder / "received").exists():
            time.sleep(0.01)
    send(job)


def test_results_come_as_they_end(tmp_path: Path) -> None:
    order = []
    for event in JobProcesses(
        partial(wait_for_file, tmp_path), ["slow", "quick"], workers=2
    ):
        order.append(event.job)
        (tmp_path / "received").touch()
    assert order == ["quick", "slow"]


def test_no_more_processes_than_workers(tmp_path: Path) -> None:
    events = list(JobProcesses(partial(crowd, tmp_path), range(4), workers=2))
    assert len({e.value[0] for e in events}) == 4  # a process for each
    assert max(e.value[1] for e in events) <= 2


def crowd(folder: Path, job: int, send: Callable) -> None:
    mine = folder / str(os.getpid())
    mine.touch()
    send((os.getpid(), len(list(folder.iterdir()))))
    mine.unlink()


def die_at_two(job: tuple[int, ...], send: Send) -> None:
    for value in job:
        if value == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        send(value)


def test_a_job_whose_process_is_killed_is_tried_again_then_told() -> None:
    events = list(JobProcesses(die_at_two, [(1, 2, 3), (4,)], workers=1))
    killed = -signal.SIGKILL
    assert events == [
        Sent((1, 2, 3), 1),
        Died((1, 2, 3), killed, 1, again=True),
        Sent((1, 2, 3), 1),
        Died((1, 2, 3), killed, ATTEMPTS, again=False),
        Sent((4,), 4),
    ]


@pytest.mark.parametrize(
    ("status", "attempts", "reason"),
    [
        (-signal.SIGSEGV, 1, "was killed by SIGSEGV"),
        (-signal.SIGSEGV, 2, "was killed by SIGSEGV (2 times)"),
        (-signal.SIGKILL, 1, "was killed by SIGKILL, perhaps since memory"),
        (-63, 1, "was killed by signal 63"),
        (3, 1, "ended with status 3"),
    ],
)
def test_how_a_process_died_is_told(
    status: int, attempts: int, reason: str
) -> None:
    assert Died("job", status, attempts, False).reason.startswith(reason)


def send_then_stay(job: tuple[int, ...], send: Send) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    for value in job:
        send(value)
    if len(job) == 2:
        time.sleep(600)


def test_a_job_that_takes_too_long_is_stopped_and_others_go_on() -> None:
    events = list(
        JobProcesses(
            send_then_stay,
            [(1, 2), (3,)],
            workers=1,
            remaining=without,
            limit=0.3,
        )
    )
    assert events == [Sent((1, 2), 1), Sent((2,), 2), Sent((3,), 3)]
    (first, *_, last) = JobProcesses(
        send_then_stay, [(1, 2)], workers=2, limit=0.3
    )
    assert first == Sent((1, 2), 1)
    assert last == Overran((1, 2), 0.3)


SCRIPT = """
import os
from tests.test_processes import count_up
from xray_drake.processes import JobProcesses
print([event.value for event in JobProcesses(count_up, [2], workers=1)])
print(os.environ.get("OMP_NUM_THREADS"))
"""


def test_a_script_needs_no_guard_and_keeps_its_threads(tmp_path: Path) -> None:
    """Also where the temporary folder's name is too long for a socket."""
    long = tmp_path / ("long" * 25)
    long.mkdir()
    (tmp_path / "script.py").write_text(SCRIPT)
    root = Path(__file__).parents[1]
    environment = {
        **os.environ,
        "PYTHONPATH": str(root),
        "TMPDIR": str(long),
    }
    environment.pop("OMP_NUM_THREADS", None)
    made = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert made.stdout == "[0, 1]\nNone\n", made.stderr


def without(job: tuple[int, ...], value: int) -> tuple[int, ...] | None:
    return tuple(v for v in job if v != value) or None


def test_what_was_sent_is_not_done_again() -> None:
    processes = JobProcesses(
        die_at_two, [(1, 2, 3)], workers=1, remaining=without
    )
    events = []
    for event in processes:
        events.append(event)
        if isinstance(event, Died) and not event.again:
            processes.add(event.job[1:])
    killed = -signal.SIGKILL
    assert events == [
        Sent((1, 2, 3), 1),
        Died((2, 3), killed, 1, again=True),
        Died((2, 3), killed, ATTEMPTS, again=False),
        Sent((3,), 3),
    ]


def send_then_die(job: tuple[int, ...], send: Send) -> None:
    for value in job:
        send(value)
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_process_that_dies_with_nothing_left_to_do_is_done() -> None:
    processes = JobProcesses(
        send_then_die, [(1, 2)], workers=1, remaining=without
    )
    assert list(processes) == [Sent((1, 2), 1), Sent((2,), 2)]


def send_pid_and_much(job: int, send: Callable[[int | bytes], None]) -> None:
    send(os.getpid())
    send(bytes(job))


def test_a_process_killed_in_the_middle_of_a_message_died() -> None:
    """A message longer than a pipe holds waits for whom it is sent to."""
    events = []
    for event in JobProcesses(send_pid_and_much, [10_000_000], workers=1):
        events.append(type(event))
        if isinstance(event, Sent):
            time.sleep(0.2)
            os.kill(event.value, signal.SIGKILL)
    assert events == [Sent, Died] * ATTEMPTS


def fail(job: str, send: Send) -> None:
    # Imported here: other jobs need not wait for it.
    from pydrake.multibody.plant import MultibodyPlant

    from xray_drake.scene.library import make_object

    if job == "message":
        make_object("no_such")
    elif job == "file":
        Path("no\nfile").read_bytes()
    elif job == "assertion":
        MultibodyPlant(time_step=-1.0)
    elif job == "numpy":
        np.zeros(3) + np.zeros(4)
    else:
        MultibodyPlant(time_step=0.0).GetBodyByName("x")


@pytest.mark.parametrize(
    ("job", "reason", "traceback"),
    [
        ("message", "no family is called 'no'", ""),
        ("file", "[Errno 2] No such file or directory: 'no\\nfile'", ""),
        ("numpy", "ValueError: operands could not be", "in fail"),
        ("drake", "RuntimeError: ", "in fail"),
        ("assertion", "SystemExit: Failure at ", "in fail"),
    ],
)
def test_an_exception_is_one_line_and_a_fault_keeps_its_traceback(
    job: str, reason: str, traceback: str
) -> None:
    """So a fault of NumPy's or Drake's is told from a message for the user."""
    (event,) = JobProcesses(fail, [job], workers=1)
    assert isinstance(event, Failed)
    assert event.reason.startswith(reason)
    assert "\n" not in event.reason
    assert traceback in event.traceback
    assert bool(event.traceback) == bool(traceback)
    notes = getattr(event.error("it failed"), "__notes__", [])
    assert notes == [event.traceback] * bool(traceback)


def send_what_cannot_be(job: int, send: Callable) -> None:
    send(lambda: job)


def test_a_value_that_cannot_be_sent_is_told() -> None:
    (event,) = JobProcesses(send_what_cannot_be, [1], workers=1)
    assert isinstance(event, Failed)
    assert send_what_cannot_be.__name__ in event.reason


def send_pid_and_stay(job: int, send: Send) -> None:
    send(os.getpid())
    time.sleep(600)


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_who_stops_listening_stops_the_processes() -> None:
    events = iter(JobProcesses(send_pid_and_stay, [1, 2], workers=2))
    pids = [next(events).value, next(events).value]
    assert not any(map(gone, pids))
    events.close()
    assert all(map(gone, pids))


INTERRUPTED = """
import signal
from tests.test_processes import send_pid_and_stay
from xray_drake.processes import JobProcesses
# A shell's background job ignores it.
signal.signal(signal.SIGINT, signal.default_int_handler)
for event in JobProcesses(send_pid_and_stay, [1, 2, 3], workers=2):
    print(event.value, flush=True)
"""


@pytest.mark.parametrize("to_all", [True, False])
def test_ctrl_c_leaves_no_process(to_all: bool) -> None:
    """Sent to the program alone, or to all its processes as terminals do."""
    program = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=Path(__file__).parents[1],
    )
    assert program.stdout is not None
    try:
        pids = [int(program.stdout.readline()) for _ in range(2)]
        assert not any(map(gone, pids))
        if to_all:
            os.killpg(program.pid, signal.SIGINT)
        else:
            program.send_signal(signal.SIGINT)
        out, err = program.communicate(timeout=60)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
    assert out == ""  # the third was not begun
    assert program.returncode == -signal.SIGINT
    assert err.splitlines()[-1] == "KeyboardInterrupt"
    assert all(map(gone, pids))
