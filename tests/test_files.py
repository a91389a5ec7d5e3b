import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.disk import full_disk
from xray_drake.files import (
    InUseError,
    LinesError,
    append_json_lines,
    read_json_lines,
    remove_leftovers,
    sole_writer,
    write_whole_file,
)


def test_a_file_is_written_whole_or_left_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    write_whole_file(path, b"old")
    with full_disk(100), pytest.raises(OSError):
        write_whole_file(path, b"new" * 100)
    assert path.read_text(encoding="utf-8") == "old"
    # Who reads meanwhile reads the old file whole.
    with path.open() as reader:
        write_whole_file(path, b"new" * 100)
        assert reader.read() == "old"
    assert path.read_text(encoding="utf-8") == "new" * 100
    with pytest.raises(OSError):
        write_whole_file(tmp_path, b"over a folder")
    assert [p.name for p in tmp_path.iterdir()] == ["record.json"]


def test_links_are_followed_and_pipes_are_written_to(tmp_path: Path) -> None:
    real, link = tmp_path / "real.json", tmp_path / "link.json"
    real.write_text("old", encoding="utf-8")
    link.symlink_to(real)
    write_whole_file(link, b"new")
    assert link.is_symlink()
    assert real.read_text(encoding="utf-8") == "new"

    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_whole_file(pipe, b"through")
        assert pipe.is_fifo()
        assert os.read(reader, 100) == b"through"
    finally:
        os.close(reader)


def dead_pid() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_leftovers_are_removed_and_nothing_else(tmp_path: Path) -> None:
    write_whole_file(tmp_path / "x.txt", b"whole")
    name = f".x.txt.{dead_pid()}.part"
    (tmp_path / name).write_bytes(b"half")
    (tmp_path / "y.part").write_bytes(b"somebody's")
    # Of a worker that has outlived its program.
    (tmp_path / f".z.txt.{os.getppid()}.part").write_bytes(b"written now")
    assert [p.name for p in remove_leftovers(tmp_path)] == [name]
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *(f".z.txt.{os.getppid()}.part", "x.txt", "y.part")
    ]


_WRITER = """
import os, sys, time
from pathlib import Path
from xray_drake.files import sole_writer
with sole_writer(Path(sys.argv[1])):
    if not os.fork():
        # Here the child has let go of the lock.
        print(os.getpid(), flush=True)
    time.sleep(60)
"""


@pytest.fixture(params=["folder", "results.jsonl"])
def place(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    path = tmp_path / request.param
    if not path.suffix:
        path.mkdir()
    return path


@pytest.fixture
def other(place: Path) -> Iterator[tuple[subprocess.Popen, int]]:
    """Another process that writes there, and its child."""
    process = subprocess.Popen(
        [sys.executable, "-c", _WRITER, str(place)],
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    yield process, int(process.stdout.readline())
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()


def test_a_place_has_one_writer_until_it_is_killed(
    place: Path, other: tuple[subprocess.Popen, int]
) -> None:
    """The lock does not live on in a child, as in a reader of data."""
    writer, child = other
    link = place.with_name("link")
    link.symlink_to(place)
    for name in (place, link):
        with pytest.raises(InUseError, match=f"another process .{writer.pid}"):
            sole_writer(name).__enter__()
    writer.kill()
    writer.wait()
    for _ in range(2):
        with sole_writer(place):
            os.kill(child, 0)  # it lives
            with pytest.raises(InUseError):  # not twice in one process either
                sole_writer(place).__enter__()
    names = {p.name for p in place.parent.rglob("*")}
    assert names <= {"link", "folder"}


def test_a_copied_lock_blocks_nobody(tmp_path: Path) -> None:
    (tmp_path / ".lock").write_text(str(os.getppid()))
    with sole_writer(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("cut", [0, 1, 2, 7])
def test_lines_come_back_but_a_last_one_cut_short_and_that_is_said(
    tmp_path: Path, cut: int, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "x.jsonl"
    assert read_json_lines(path) == []
    items = [{"a": "ä\u2028"}, {"b": [1, None]}]
    for item in items:
        with append_json_lines(path) as add:
            add(item)
    path.write_text(path.read_text("utf-8")[: -cut or None], "utf-8")
    # Without its end of line alone it is whole.
    kept = items[: 2 if cut < 2 else 1]
    assert read_json_lines(path) == kept
    assert [f"{path}: line 2 is cut" in m for m in caplog.messages] == [
        *([True] if cut > 1 else [])
    ]
    with append_json_lines(path) as add:
        add({"c": 3})
    assert read_json_lines(path) == [*kept, {"c": 3}]


@pytest.mark.parametrize("line", [b"{", b"[1]", b"7", b"\xff", b"\0\0"])
def test_another_line_that_cannot_be_read_is_named_and_stays(
    tmp_path: Path, line: bytes
) -> None:
    path = tmp_path / "x.jsonl"
    data = b'{"a": 1}\n' + line + b'\n{"b": 2}\n'
    path.write_bytes(data)
    with pytest.raises(LinesError, match=r"x\.jsonl: line 2 cannot be read"):
        read_json_lines(path)
    with append_json_lines(path) as add:
        add({"c": 3})
    assert path.read_bytes() == data + b'{"c": 3}\n'
