import dataclasses
import errno
import multiprocessing
import pickle
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from xray_drake import files
from xray_drake.dataset.sample import Sample, encode_occupancy
from xray_drake.dataset.shards import (
    ShardAttributes,
    ShardError,
    ShardReader,
    read_shard,
    verify_shard,
    write_shard,
)
from xray_drake.files import remove_leftovers

_MakeSample = Callable[..., Sample]

_ATTRIBUTES = ShardAttributes(
    split="test",
    scenario="name: päper\n",
    package_version="0.1.0",
    drake_version="1.51.1",
    dataset="0123456789abcdef",
)


@pytest.fixture(scope="module")
def shard(make_sample: _MakeSample, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("shard") / "test-00000.h5"
    samples = [make_sample(seed, color=True) for seed in range(3)]
    write_shard(path, samples, _ATTRIBUTES)
    return path


def assert_same(a: Sample, b: Sample) -> None:
    for field in dataclasses.fields(Sample):
        expected, found = getattr(a, field.name), getattr(b, field.name)
        if field.name == "occupancy":
            expected, found = (
                encode_occupancy(expected),
                encode_occupancy(found),
            )
        if isinstance(expected, np.ndarray):
            assert expected.dtype == found.dtype
            np.testing.assert_array_equal(expected, found)
        else:
            assert expected == found


@settings(
    max_examples=20,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    seeds=st.lists(
        st.integers(0, 2**63 - 1), min_size=1, max_size=4, unique=True
    ),
    color=st.booleans(),
    shape=st.sampled_from([(24, 32), (40, 48)]),
    names=st.lists(st.text(), max_size=3),
)
def test_a_shard_gives_back_what_was_written(
    make_sample: _MakeSample,
    tmp_path: Path,
    seeds: list[int],
    color: bool,
    shape: tuple[int, int],
    names: list[str],
) -> None:
    samples = [
        dataclasses.replace(
            make_sample(seed, color=color, shape=shape),
            object_names=tuple(names),
        )
        for seed in seeds
    ]
    path = tmp_path / "train-00000.h5"
    write_shard(path, samples, _ATTRIBUTES)
    for written, read in zip(samples, read_shard(path), strict=True):
        assert_same(written, read)
    with ShardReader(path) as reader:
        assert reader.keys == tuple(sample.key for sample in samples)
        assert reader.shape == shape
        assert reader.has_color == color
        assert reader.attributes == _ATTRIBUTES


def test_the_same_samples_give_the_same_bytes(
    make_sample: _MakeSample, shard: Path, tmp_path: Path
) -> None:
    time.sleep(1.1)  # HDF5 counts in seconds
    samples = [make_sample(seed, color=True) for seed in range(3)]
    write_shard(tmp_path / "again.h5", samples, _ATTRIBUTES)
    assert (tmp_path / "again.h5").read_bytes() == shard.read_bytes()
    # What was read can be written again, too.
    write_shard(tmp_path / "copy.h5", read_shard(shard), _ATTRIBUTES)
    assert (tmp_path / "copy.h5").read_bytes() == shard.read_bytes()


def test_any_hdf5_tool_can_read_it(shard: Path) -> None:
    with h5py.File(shard) as file:
        assert file.userblock_size == 512
        assert file["depth"].shape == (3, 24, 32)
        assert file["depth"].dtype == np.uint16
        assert file["depth"].chunks == (1, 24, 32)
        assert all(dataset.fletcher32 for dataset in file.values())
        assert file["object_names"].asstr()[0] == '["plate", "Löffel"]'
        assert file.attrs["metres_per_count"] == 1e-4
        assert file.attrs["scenario"] == "name: päper\n"


def test_a_shell_can_verify_it(shard: Path) -> None:
    found = subprocess.run(
        f"tail -c +513 {shard} | sha256sum",
        shell=True,
        capture_output=True,
        check=True,
    ).stdout.split()[0]
    assert found in shard.read_bytes()[:512]


@settings(max_examples=200, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_any_flipped_bit_is_found(shard: Path, where: float, bit: int) -> None:
    data = bytearray(shard.read_bytes())
    data[int(where * len(data))] ^= 1 << bit
    broken = shard.with_name("broken.h5")
    broken.write_bytes(data)
    with pytest.raises(ShardError, match=r"broken\.h5 is damaged"):
        verify_shard(broken)
    with pytest.raises(ShardError, match=r"broken\.h5 is damaged"):
        read_shard(broken)


@pytest.mark.parametrize("bit", range(8))
def test_any_flipped_bit_of_the_header_is_found(shard: Path, bit: int) -> None:
    data = shard.read_bytes()
    broken = shard.with_name("broken.h5")
    for where in range(512):
        flipped = bytearray(data)
        flipped[where] ^= 1 << bit
        broken.write_bytes(flipped)
        with pytest.raises(ShardError, match=r"broken\.h5 is damaged"):
            verify_shard(broken)


@settings(max_examples=60, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True))
def test_any_truncation_is_found_at_once(shard: Path, where: float) -> None:
    data = shard.read_bytes()
    broken = shard.with_name("short.h5")
    broken.write_bytes(data[: int(where * len(data))])
    for use in (verify_shard, len_of, read_shard):
        with pytest.raises(ShardError, match=r"short\.h5 is damaged"):
            use(broken)


def len_of(path: Path) -> int:
    with ShardReader(path) as reader:
        return len(reader)


@settings(max_examples=100, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_lazy_reading_gives_the_truth_or_an_error(
    shard: Path, where: float, bit: int
) -> None:
    """The checksums of HDF5 cover what the reader uses."""
    data = bytearray(shard.read_bytes())
    data[int(where * len(data))] ^= 1 << bit
    broken = shard.with_name("lazy.h5")
    broken.write_bytes(data)
    try:
        with ShardReader(broken) as reader:
            samples = [reader.sample(i) for i in range(3)]
    except ShardError as error:
        assert "lazy.h5" in str(error)
        return
    for expected, found in zip(read_shard(shard), samples, strict=True):
        assert_same(expected, found)


def test_bytes_after_the_end_are_found(shard: Path, tmp_path: Path) -> None:
    path = tmp_path / "long.h5"
    path.write_bytes(shard.read_bytes() + b"\0")
    for use in (verify_shard, len_of):
        with pytest.raises(ShardError, match=r"long\.h5 is damaged"):
            use(path)


def test_a_foreign_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["depth"] = np.zeros((3, 4, 4))
    with pytest.raises(ShardError, match="no shard"):
        verify_shard(path)


def test_a_missing_file_is_no_damage(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        verify_shard(tmp_path / "none.h5")
    with pytest.raises(FileNotFoundError):
        len_of(tmp_path / "none.h5")


def test_samples_that_do_not_fit_are_refused(
    make_sample: _MakeSample, tmp_path: Path
) -> None:
    path = tmp_path / "train-00000.h5"
    sample = make_sample()
    for samples, line in (
        ([], "at least one"),
        ([sample, sample], "sample twice in one shard: heap 0, box_2to1"),
        ([sample, make_sample(1, color=True)], "without colour"),
        ([sample, make_sample(1, shape=(40, 48))], "in one shard"),
    ):
        with pytest.raises(ValueError, match=line):
            write_shard(path, samples, _ATTRIBUTES)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_nothing_behind(
    make_sample: _MakeSample, shard: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    before = sorted(shard.parent.iterdir())
    content = shard.read_bytes()
    for name in ("test-00001.h5", shard.name):
        with pytest.raises(OSError, match="no space left") as error_info:
            write_shard(shard.with_name(name), [make_sample(9)], _ATTRIBUTES)
        assert error_info.value.errno == errno.ENOSPC
        assert name in str(error_info.value)
        assert "\n" not in str(error_info.value)
    assert sorted(shard.parent.iterdir()) == before
    assert shard.read_bytes() == content


@pytest.mark.skipif(
    not Path("/dev/full").exists(), reason="needs Linux's /dev/full"
)
def test_a_device_that_is_full_says_so(
    make_sample: _MakeSample, tmp_path: Path
) -> None:
    (tmp_path / f".x.h5.{files.os.getpid()}.part").symlink_to("/dev/full")
    with pytest.raises(OSError, match="no space left"):
        write_shard(tmp_path / "x.h5", [make_sample()], _ATTRIBUTES)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_named(
    make_sample: _MakeSample, tmp_path: Path
) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere"):
        write_shard(tmp_path / "nowhere/x.h5", [make_sample()], _ATTRIBUTES)


def test_leftovers_are_removed(tmp_path: Path) -> None:
    part = tmp_path / ".train-00003.h5.4711.part"
    part.touch()
    (tmp_path / "train-00002.h5").touch()
    assert remove_leftovers(tmp_path) == [part]
    assert [p.name for p in tmp_path.iterdir()] == ["train-00002.h5"]


def test_a_reader_travels_to_other_processes(shard: Path) -> None:
    with ShardReader(shard) as reader:
        expected = reader.image("depth", 1)
        copy = pickle.loads(pickle.dumps(reader))
        np.testing.assert_array_equal(copy.image("depth", 1), expected)
        copy.close()
        fork = multiprocessing.get_context("fork")
        with fork.Pool(2) as pool:  # with the file open here
            for found in pool.starmap(reader.image, [("depth", 1)] * 4):
                np.testing.assert_array_equal(found, expected)


def test_an_index_beyond_the_end(shard: Path) -> None:
    with ShardReader(shard) as reader:
        for index in (-1, 3):
            with pytest.raises(IndexError):
                reader.image("depth", index)
