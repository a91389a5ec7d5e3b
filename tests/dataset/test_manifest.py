import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xray_drake.dataset.manifest import (
    SPLITS,
    DatasetError,
    Manifest,
    check_same,
    read_manifest,
    write_manifest,
)


def _manifest(**changes: Any) -> Manifest:
    arguments: dict[str, Any] = {
        "seed": 3,
        "targets": ("box_2to1", "lid"),
        "splits": {"train": 8, "test": 3},
        "shard_size": 4,
        "views_per_heap": 2,
        "height": 24,
        "width": 32,
        "scenario": "name: päper\n" * 30,
        "meshes": ("a", "b"),
        "options": {"rest": [1, 2]},
    }
    return Manifest(**(arguments | changes))


def test_a_manifest_comes_back_as_it_was(tmp_path: Path) -> None:
    manifest = _manifest()
    write_manifest(tmp_path, manifest)
    assert read_manifest(tmp_path) == manifest
    assert read_manifest(tmp_path).fingerprint() == manifest.fingerprint()
    check_same(tmp_path, manifest)
    assert [p.name for p in tmp_path.iterdir()] == ["dataset.json"]


@given(
    counts=st.fixed_dictionaries(
        {split: st.integers(0, 50) for split in SPLITS}
    ),
    shard_size=st.integers(1, 12),
)
def test_shards_hold_every_sample_once(
    counts: dict[str, int], shard_size: int
) -> None:
    manifest = _manifest(splits=counts, shard_size=shard_size)
    shards = manifest.expected_shards()
    for split, count in counts.items():
        mine = [s for s in shards if s.split == split]
        covered = [i for s in mine for i in range(s.first, s.first + s.count)]
        assert covered == list(range(count))
        names = [f"{split}-{i:05d}.h5" for i in range(len(mine))]
        assert [s.name for s in mine] == names
        assert all(1 <= s.count <= shard_size for s in mine)
    assert manifest.num_samples == sum(counts.values())


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"seed": 4}, "begun with seed 3, not seed 4"),
        ({"targets": ("lid",)}, "begun with targets"),
        ({"splits": {"train": 9, "test": 3}}, "begun with splits"),
        ({"shard_size": 5}, "begun with shard_size 4"),
        ({"views_per_heap": 1}, "begun with views_per_heap 2"),
        ({"scenario": "name: other\n"}, "begun with another scenario"),
        ({"meshes": ("a",)}, "begun with meshes"),
        ({"options": {"rest": [1, 3]}}, "begun with options"),
        ({"color": True}, "begun with color False, not color True"),
        ({"drake_version": "2"}, "begun with drake_version"),
    ],
)
def test_another_dataset_is_not_continued(
    tmp_path: Path, changes: dict[str, Any], line: str
) -> None:
    write_manifest(tmp_path, _manifest())
    other = _manifest(**changes)
    assert other.fingerprint() != _manifest().fingerprint()
    with pytest.raises(ValueError, match=line) as error_info:
        check_same(tmp_path, other)
    assert str(tmp_path) in str(error_info.value)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"splits": {"training": 1}}, "no split is called 'training'"),
        ({"splits": {"train": -1}}, "has -1 samples"),
        ({"shard_size": 0}, "shard_size is 0"),
        ({"targets": ()}, "targets is empty"),
    ],
)
def test_what_cannot_be_made_is_refused(
    changes: dict[str, Any], line: str
) -> None:
    with pytest.raises(ValueError, match=line):
        _manifest(**changes)


_CHANGED = [f'"{name}"' for name in ("splits", "seed", "fingerprint", "meshes")]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (None, "is no dataset"),
        ("{", "is damaged"),
        ("\xff", "is damaged"),
        ("[]", "format version None"),
        ('{"format_version": 99}', "format version 99"),
        ('{"format_version": 1}', "is damaged"),
        ('{"format_version": 1, "typo": 1}', "is damaged"),
        *((name, "is damaged, or was changed") for name in _CHANGED),
    ],
)
def test_a_folder_that_is_no_dataset(
    tmp_path: Path, text: str | None, line: str
) -> None:
    """A name alone is that of a key that was changed by hand."""
    path = tmp_path / "dataset.json"
    if text in _CHANGED:
        write_manifest(tmp_path, _manifest())
        tree = json.loads(path.read_text("utf-8"))
        text = json.dumps({**tree, json.loads(text): None})
    if text is not None:
        path.write_bytes(text.encode("latin-1"))
    with pytest.raises(DatasetError, match=line) as error_info:
        read_manifest(tmp_path)
    assert str(tmp_path) in str(error_info.value)
