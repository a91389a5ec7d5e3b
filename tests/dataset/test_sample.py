import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from xray_drake.dataset.sample import (
    MAX_DEPTH,
    Sample,
    SampleKey,
    decode_occupancy,
    depth_on_disk,
    encode_occupancy,
    problems,
)

_MakeSample = Callable[..., Sample]


@pytest.mark.parametrize("cover", [0.0, 0.3, 0.7, 1.0])
def test_sound_samples_have_no_problems(
    make_sample: _MakeSample, cover: float
) -> None:
    for heap_seed in range(5):
        sample = make_sample(heap_seed, cover=cover, color=True)
        assert problems(sample) == []
        assert sample.visible_fraction == pytest.approx(1 - cover, abs=0.15)
        assert sample.target_tilt == 0.0


_MASKS = ("target_amodal", "target_modal")


def _at(sample: Sample, axis: int, place: float) -> np.ndarray:
    """The target's pose with another coordinate."""
    return _with(sample.X_WT, (axis, 3), place)


def _with(array: np.ndarray, at: Any, value: Any) -> np.ndarray:
    changed = np.array(array)
    changed[at] = value
    return changed


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        (lambda s: {"X_WC": 2 * s.X_WC}, "X_WC is not a rigid pose"),
        (
            lambda s: {"X_WT": s.X_WT @ np.diag([1, 1, -1, 1])},
            "X_WT is not a rigid pose",
        ),
        (lambda s: {"X_WT": _at(s, 0, 0.3)}, "target_amodal reaches"),
        (lambda s: {"X_WT": _at(s, 2, 0.2)}, "m from the depth that X_WT and"),
        (lambda s: {"X_WT": _at(s, 2, 1.2)}, "not in front of the camera"),
        (
            lambda s: {"intrinsics": _with(s.intrinsics, (0, 1), 1.0)},
            "not a camera matrix",
        ),
        (lambda s: {"target_size": [0.1, 0.0, 0.1]}, "three positive lengths"),
        (lambda s: {"target_name": ""}, "target_name is empty"),
        (lambda s: {"object_names": ("a", "a")}, "a name twice"),
        (lambda s: {"object_names": ("box_2to1",)}, "holds the target"),
        (lambda s: {"num_dropped": 1}, "only 1 dropped"),
        (lambda s: {"object_names": ()}, "0 objects end at 1"),
        (
            lambda s: dict.fromkeys(_MASKS, np.zeros(s.shape)),
            "not in the image",
        ),
        (
            lambda s: {"target_modal": np.ones(s.shape)},
            "pixels of target_modal outside target_amodal",
        ),
        (
            lambda s: {"instances": np.zeros(s.shape)},
            "target_modal and instances == 1 differ",
        ),
        (lambda s: {"depth": -s.depth}, "negative or not finite"),
        (lambda s: {"depth": s.depth + np.inf}, "negative or not finite"),
        (lambda s: {"depth": 20 * s.depth}, "beyond 6.5535 m"),
        (
            lambda s: {"depth": _with(s.depth, (-1, -1), 0.7)},
            "differ in 1 pixels outside target_modal",
        ),
        (
            lambda s: {"depth": np.where(s.target_modal, 0.85, s.depth)},
            "lie behind the scene",
        ),
        (lambda s: {"occupancy": s.occupancy / 2}, "maximum 0.5, not 1"),
        (lambda s: {"occupancy": -s.occupancy}, "outside [0, 1]"),
        (
            lambda s: {"occupancy": _with(s.occupancy, s.target_modal, 0)},
            "occupancy is 0 in",
        ),
    ],
)
def test_each_defect_is_named(
    make_sample: _MakeSample,
    changes: Callable[[Sample], dict[str, Any]],
    line: str,
) -> None:
    sample = make_sample(3)
    broken = dataclasses.replace(sample, **changes(sample))
    assert any(line in problem for problem in problems(broken))


def test_a_visible_target_cannot_be_elsewhere(make_sample: _MakeSample) -> None:
    sample = make_sample(3, cover=0.0)
    spread = dataclasses.replace(sample, occupancy=np.ones(sample.shape))
    (line,) = problems(spread)
    assert "wholly visible" in line


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"depth": np.zeros(5)}, r"depth is \(5,\)"),
        ({"occupancy": np.zeros((2, 2))}, r"occupancy is \(2, 2\)"),
        ({"X_WC": np.eye(3)}, r"X_WC is \(3, 3\)"),
        ({"color": np.zeros((24, 32))}, r"color is \(24, 32\)"),
        ({"heap_seed": -1}, "heap_seed is -1"),
        ({"view": 2**63}, "view is"),
    ],
)
def test_what_no_sample_has_is_refused(
    make_sample: _MakeSample, changes: dict[str, Any], line: str
) -> None:
    with pytest.raises(ValueError, match=line):
        dataclasses.replace(make_sample(), **changes)


def test_a_sample_is_a_snapshot(make_sample: _MakeSample) -> None:
    depth = np.full((24, 32), 0.5)
    sample = dataclasses.replace(make_sample(), depth=depth)
    depth[:] = 0
    assert sample.depth.min() == 0.5
    assert sample.depth.dtype == np.float32
    with pytest.raises(ValueError, match="read-only"):
        sample.depth[0, 0] = 1


def test_keys_are_ordered_and_readable(make_sample: _MakeSample) -> None:
    key = make_sample(7, view=2).key
    assert key == SampleKey(7, "box_2to1", 2, 12)
    assert str(key) == "heap 7, box_2to1, view 2, 12 dropped"
    assert make_sample(6, view=3).key < key


@given(
    arrays(
        np.float32,
        (7,),
        elements=st.floats(width=32, allow_nan=True, allow_infinity=True),
    )
)
def test_any_depth_becomes_one_that_can_be_kept(depth: np.ndarray) -> None:
    kept = depth_on_disk(depth)
    assert np.all((kept >= 0) & (kept <= np.float32(MAX_DEPTH)))
    np.testing.assert_array_equal(depth_on_disk(kept), kept)
    inside = (depth > 1e-4) & (depth < MAX_DEPTH - 1e-4)
    np.testing.assert_allclose(kept[inside], depth[inside], atol=0.51e-4)
    assert not kept[~(depth > 0)].any()


@given(arrays(np.float32, (9,), elements=st.floats(0, 1, width=32)))
def test_a_distribution_keeps_its_support(rho: np.ndarray) -> None:
    kept = decode_occupancy(encode_occupancy(rho))
    np.testing.assert_array_equal(kept > 0, rho > 0)
    np.testing.assert_allclose(kept, rho, atol=1 / 255)
    np.testing.assert_array_equal(encode_occupancy(kept), encode_occupancy(rho))
