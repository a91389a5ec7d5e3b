import dataclasses
import errno
import multiprocessing
import pickle
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.dataset.whole import read_shard
from xray_drake import files
from xray_drake.dataset.sample import Sample, encode_occupancy
from xray_drake.dataset.shards import (
    ShardAttributes,
    ShardError,
    ShardReader,
    verify_shard,
    write_shard,
)

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
        assert file["depth"].shape == (3, 24, 32)
        assert file["depth"].dtype == np.uint16
        assert file["depth"].chunks == (1, 24, 32)
        assert all(dataset.fletcher32 for dataset in file.values())
        assert file["object_names"].asstr()[0] == '["plate", "Löffel"]'
        assert file.attrs["metres_per_count"] == 1e-4
        assert file.attrs["scenario"] == "name: päper\n"


def len_of(path: Path) -> int:
    with ShardReader(path) as reader:
        return len(reader)


@settings(max_examples=60, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True))
def test_any_truncation_is_found_at_once(shard: Path, where: float) -> None:
    data = shard.read_bytes()
    broken = shard.with_name("short.h5")
    broken.write_bytes(data[: int(where * len(data))])
    for use in (verify_shard, len_of, read_shard):
        with pytest.raises(ShardError, match=r"short\.h5 is damaged"):
            use(broken)


@settings(max_examples=300, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_is_found_or_changes_nothing(
    shard: Path, where: float, bit: int
) -> None:
    """The checksums of HDF5 cover what the reader uses."""
    data = bytearray(shard.read_bytes())
    data[int(where * len(data))] ^= 1 << bit
    broken = shard.with_name("lazy.h5")
    broken.write_bytes(data)
    try:
        samples = read_shard(broken)
    except ShardError as error:
        assert "lazy.h5" in str(error)
        return
    for expected, found in zip(read_shard(shard), samples, strict=True):
        assert_same(expected, found)


def test_a_shard_of_an_older_version_is_read(
    shard: Path, tmp_path: Path
) -> None:
    """Those begin with 512 bytes of text: length and SHA-256 of the rest."""
    old = tmp_path / "old.h5"
    header = b"xray_drake shard 1\nbytes 1\nsha256 0\n".ljust(512, b"\0")
    old.write_bytes(header + shard.read_bytes())
    for ours, theirs in zip(read_shard(shard), read_shard(old), strict=True):
        assert_same(ours, theirs)


def test_a_foreign_file_is_refused_but_a_missing_one_is_no_damage(
    tmp_path: Path,
) -> None:
    path = tmp_path / "other.h5"
    for use in (verify_shard, len_of):
        with pytest.raises(FileNotFoundError):
            use(path)
    with h5py.File(path, "w") as file:
        file["depth"] = np.zeros((3, 4, 4))
    with pytest.raises(ShardError, match="no shard"):
        verify_shard(path)


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
    before = {p: p.read_bytes() for p in shard.parent.iterdir()}
    for name in ("test-00001.h5", shard.name):
        with pytest.raises(OSError, match="no space left") as error_info:
            write_shard(shard.with_name(name), [make_sample(9)], _ATTRIBUTES)
        assert error_info.value.errno == errno.ENOSPC
        assert name in str(error_info.value)
        assert "\n" not in str(error_info.value)
    assert {p: p.read_bytes() for p in shard.parent.iterdir()} == before


def test_a_reader_travels_to_other_processes(shard: Path) -> None:
    with ShardReader(shard) as reader:
        expected = reader.image("depth", 1)
        for index in (-1, 3):
            with pytest.raises(IndexError):
                reader.image("depth", index)
        copy = pickle.loads(pickle.dumps(reader))
        np.testing.assert_array_equal(copy.image("depth", 1), expected)
        copy.close()
        fork = multiprocessing.get_context("fork")
        with fork.Pool(2) as pool:  # with the file open here
            for found in pool.starmap(reader.image, [("depth", 1)] * 4):
                np.testing.assert_array_equal(found, expected)
