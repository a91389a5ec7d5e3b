import os
from pathlib import Path

import pytest

from tests.disk import full_disk
from xray_drake.files import remove_leftovers, write_whole_file


def test_a_file_is_written_whole_or_left_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    write_whole_file(path, b"old")
    with full_disk(100), pytest.raises(OSError):
        write_whole_file(path, b"new" * 100)
    assert path.read_text(encoding="utf-8") == "old"
    write_whole_file(path, b"new" * 100)
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


def test_who_reads_meanwhile_reads_the_old_file_whole(tmp_path: Path) -> None:
    path = tmp_path / "x.txt"
    write_whole_file(path, b"old text")
    with path.open() as reader:
        write_whole_file(path, b"new")
        assert reader.read() == "old text"
    assert path.read_text() == "new"


def test_leftovers_are_removed_and_nothing_else(tmp_path: Path) -> None:
    write_whole_file(tmp_path / "x.txt", b"whole")
    (tmp_path / ".x.txt.7.part").write_bytes(b"half")
    (tmp_path / "y.part").write_bytes(b"somebody's")
    assert [p.name for p in remove_leftovers(tmp_path)] == [".x.txt.7.part"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["x.txt", "y.part"]
