import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from xray_drake.processes import ATTEMPTS, JobError, Lost, how_it_died, run_jobs


def count_up(job: int) -> Iterator[int]:
    yield from range(job)


def double(job: int) -> int:
    return 2 * job


@pytest.mark.parametrize("workers", [0, 2])
def test_all_jobs_are_done_and_values_come_in_order(workers: int) -> None:
    """In processes, or in this one; of generators and of functions."""
    found = list(run_jobs(count_up, [2, 0, 3], workers=workers))
    for job in (2, 0, 3):
        assert [v for j, v in found if j == job] == list(range(job))
    doubled = run_jobs(double, [1, 2], workers=workers)
    assert sorted(doubled) == [(1, 2), (2, 4)]


def crowd(folder: Path, job: str) -> Iterator[tuple[int, int]]:
    """Job "slow" is done after "quick", whose result was received."""
    mine = folder / str(os.getpid())
    mine.touch()
    while job == "slow" and not (folder / "received").exists():
        time.sleep(0.01)
    yield os.getpid(), len(list(folder.glob("[0-9]*")))
    mine.unlink()


def test_no_more_processes_than_workers_and_results_come_as_they_end(
    tmp_path: Path,
) -> None:
    jobs = ["slow", "quick", "a", "b"]
    order, found = [], []
    for job, value in run_jobs(partial(crowd, tmp_path), jobs, workers=2):
        order.append(job)
        found.append(value)
        (tmp_path / "received").touch()
    assert order.index("quick") < order.index("slow")
    pids, crowds = zip(*found, strict=True)
    assert len(set(pids)) == 4  # a process for each
    assert max(crowds) <= 2


def die_at_two(job: tuple[int, ...]) -> Iterator[int]:
    """Dies at 2, and after 0."""
    for value in job:
        if value == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        yield value
        if value == 0:
            os.kill(os.getpid(), signal.SIGKILL)


def test_a_job_whose_process_is_killed_is_tried_again_then_lost() -> None:
    jobs: Any = [(1, 2, 3), (4,)]
    found = list(run_jobs(die_at_two, jobs, workers=1, lost=lambda lost: lost))
    reason = "its process was killed by SIGKILL, perhaps since memory ran out"
    told = f"{reason} ({ATTEMPTS} times)"
    lost = Lost((1, 2, 3), "died", told, status=-signal.SIGKILL)
    assert found == [
        *[((1, 2, 3), 1)] * ATTEMPTS,
        ((1, 2, 3), lost),
        ((4,), 4),
    ]
    assert how_it_died(-63) == "was killed by signal 63"
    assert how_it_died(3) == "ended with status 3"
    named: Any = {"name": "job {}".format, "advice": "go on"}
    with pytest.raises(JobError, match=r"^job \(2,\): its .*times\); go on$"):
        list(run_jobs(die_at_two, [(2,)], workers=1, **named))


def without(job: tuple[int, ...], value: object) -> tuple[int, ...] | None:
    if isinstance(value, Lost):
        return job[1:] or None
    return tuple(v for v in job if v != value) or None


@pytest.mark.parametrize(
    ("job", "expected"),
    [
        pytest.param(
            (1, 2, 3),
            [((1, 2, 3), 1), ((2, 3), "died"), ((3,), 3)],
            id="nor what was lost, where that has a value in its place",
        ),
        pytest.param((5, 2), [((5, 2), 5), ((2,), "died")], id="nothing left"),
        pytest.param((5, 0), [((5, 0), 5), ((0,), 0)], id="it died when done"),
    ],
)
def test_what_was_yielded_is_not_done_again(
    job: tuple[int, ...], expected: list
) -> None:
    found = run_jobs(
        die_at_two, [job], workers=1, remaining=without, lost=lambda lost: lost
    )
    assert [
        (j, v.cause if isinstance(v, Lost) else v) for j, v in found
    ] == expected


def yield_then_stay(job: tuple[int, ...]) -> Iterator[int]:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    yield from job
    if len(job) == 2:
        time.sleep(600)


def test_a_job_that_takes_too_long_is_stopped_and_others_go_on() -> None:
    jobs: Any = [(1, 2), (3,)]
    assert list(
        run_jobs(yield_then_stay, jobs, workers=1, remaining=without, limit=0.3)
    ) == [((1, 2), 1), ((2,), 2), ((3,), 3)]
    first, *_, last = run_jobs(
        yield_then_stay, jobs[:1], workers=2, limit=0.3, lost=lambda lost: lost
    )
    assert first == ((1, 2), 1)
    assert last[1] == Lost((1, 2), "overran", "it takes longer than 0.3 s")


SCRIPT = """
import os
from tests.test_processes import count_up
from xray_drake.processes import run_jobs
print([value for _, value in run_jobs(count_up, [2], workers=1)])
print(os.environ.get("OMP_NUM_THREADS"))
"""


def test_a_script_needs_no_guard_and_keeps_its_threads(tmp_path: Path) -> None:
    """Also where the temporary folder's name is too long for a socket."""
    long = tmp_path / ("long" * 25)
    long.mkdir()
    (tmp_path / "script.py").write_text(SCRIPT)
    root = str(Path(__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": root, "TMPDIR": str(long)}
    environment.pop("OMP_NUM_THREADS", None)
    made = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert made.stdout == "[0, 1]\nNone\n", made.stderr


def yield_pid_and_much(job: int) -> Iterator[int | bytes]:
    yield os.getpid()
    yield bytes(job)


def test_a_process_killed_in_the_middle_of_a_message_died() -> None:
    """A message longer than a pipe holds waits for whom it is sent to."""
    found = []
    for _, value in run_jobs(
        yield_pid_and_much, [10_000_000], workers=1, lost=lambda lost: lost
    ):
        found.append(type(value))
        if isinstance(value, int):
            time.sleep(0.2)
            os.kill(value, signal.SIGKILL)
    assert found == [*[int] * ATTEMPTS, Lost]


def fail(job: str) -> object:
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
    elif job == "not to be sent":
        return lambda: job
    else:
        MultibodyPlant(time_step=0.0).GetBodyByName("x")
    return None


@pytest.mark.parametrize(
    ("job", "reason", "traceback", "workers"),
    [
        ("message", "no family is called 'no'", [], 0),
        ("message", "no family is called 'no'", [], 1),
        ("file", "[Errno 2] No such file or directory: 'no\\nfile'", [], 1),
        ("numpy", "ValueError: operands could not be", ["in fail"], 0),
        ("numpy", "ValueError: operands could not be", ["in fail"], 1),
        ("drake", "RuntimeError: ", ["in fail"], 1),
        ("assertion", "SystemExit: Failure at ", ["in fail"], 1),
        ("not to be sent", "", ["fail"], 1),
    ],
)
def test_an_exception_is_one_line_and_a_fault_keeps_its_traceback(
    job: str, reason: str, traceback: list[str], workers: int
) -> None:
    """So a fault of NumPy's or Drake's is told from a message for the user."""
    with pytest.raises(JobError) as caught:
        list(run_jobs(fail, [job], workers=workers))
    assert str(caught.value).startswith(f"{job}: {reason}")
    assert "\n" not in str(caught.value)
    notes = getattr(caught.value, "__notes__", [])
    assert len(notes) == len(traceback)
    assert all(t in note for t, note in zip(traceback, notes, strict=True))


def yield_pid_and_stay(job: int) -> Iterator[int]:
    yield os.getpid()
    time.sleep(600)


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.parametrize("how", ["close", "lost"])
def test_who_stops_listening_stops_the_processes(how: str) -> None:
    """By the end of the iteration, or by an error over a lost job."""
    found: Any = run_jobs(yield_pid_and_stay, [1, 2], workers=2)
    pids = [next(found)[1], next(found)[1]]
    assert not any(map(gone, pids))
    if how == "close":
        found.close()
    else:
        for _ in range(ATTEMPTS - 1):
            os.kill(pids[0], signal.SIGKILL)
            pids[0] = next(found)[1]
        os.kill(pids[0], signal.SIGKILL)
        with pytest.raises(JobError):
            next(found)
    assert all(map(gone, pids))


INTERRUPTED = """
import signal
from tests.test_processes import yield_pid_and_stay
from xray_drake.processes import run_jobs
# A shell's background job ignores it.
signal.signal(signal.SIGINT, signal.default_int_handler)
for _, pid in run_jobs(yield_pid_and_stay, [1, 2, 3], workers=2):
    print(pid, flush=True)
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
