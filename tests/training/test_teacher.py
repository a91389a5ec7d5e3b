"""What an image tells of its label, and that nothing else does."""

import dataclasses

import numpy as np
import pytest

from tests.dataset.conftest import synthetic_sample
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.virtual import make_target
from xray_drake.occupancy.label.ground_truth import occupancy_label
from xray_drake.occupancy.metrics import pixel_counts
from xray_drake.training.teacher import expected_occupancy

SHAPE = (192, 256)


def _sample(cover: float, name: str = "") -> Sample:
    sample = synthetic_sample(3, cover=cover, shape=SHAPE)
    name = name or make_target("box", sample.target_size).name
    return dataclasses.replace(sample, target_name=name)


@pytest.mark.parametrize("cover", [0.0, 0.4, 0.7])
def test_it_is_near_the_label(cover: float) -> None:
    sample = _sample(cover)
    label = occupancy_label(
        np.where(sample.target_amodal, sample.camera.plane_depth(0.005), 0.0),
        sample.depth_without_target,
        sample.camera,
        sample.X_WT[:3, 3],
        observed=sample.target_modal,
    ).distribution
    answer = expected_occupancy(sample)
    assert answer.shape == SHAPE
    assert answer.dtype == np.float32
    assert 0 <= answer.min() < answer.max() <= 1
    assert pixel_counts(label, answer).iou > 0.75


def test_the_image_alone_decides() -> None:
    sample = _sample(0.4)
    other = dataclasses.replace(
        sample,
        occupancy=np.zeros(SHAPE, np.float32),
        target_amodal=np.zeros(SHAPE, bool),
        depth_without_target=np.zeros(SHAPE, np.float32),
        X_WT=np.eye(4),
    )
    np.testing.assert_array_equal(
        expected_occupancy(sample), expected_occupancy(other)
    )


def test_of_another_target_it_is_another() -> None:
    sample = _sample(0.4)
    size = sample.target_size * [0.7, 1, 1]
    shorter = dataclasses.replace(
        sample, target_size=size, target_name=make_target("box", size).name
    )
    long, short = expected_occupancy(sample), expected_occupancy(shorter)
    assert np.count_nonzero(long > 0.5) > 1.1 * np.count_nonzero(short > 0.5)
    # One of the package has its own size, whatever the sample says.
    named = _sample(0.4, "box_2to1")
    answer = expected_occupancy(named)
    for other in (named.occupancy, long):
        assert not np.array_equal(answer, other)


@pytest.mark.parametrize(
    ("cover", "name"),
    [(1.0, "box_2to1"), (1.0, ""), (0.4, "mug"), (0.4, "of_a_stranger")],
)
def test_where_it_knows_no_better_the_label_stays(
    cover: float, name: str
) -> None:
    sample = _sample(cover, name)
    assert sample.target_modal.any() == (cover < 1)
    assert expected_occupancy(sample) is sample.occupancy
