from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from xray_drake.scene.library import make_object, object_names, split_of
from xray_drake.scene.object_model import (
    ObjectModel,
    TexturedMesh,
    object_from_pieces,
)
from xray_drake.scene.packaging import (
    CARD_COLOR,
    CARD_DENSITY,
    CARD_THICKNESS,
    LARGEST_CARD,
    MARGIN,
    flattest_side,
    packaged_model,
)
from xray_drake.scene.shapes import box, box_of, rod

NAMES = ("bottle_003", "bowl_001", "gear_002", "figurine_000", "airplane_001")

BOX = object_from_pieces(
    "block", list(box(0.03, 0.1, 0.06).surfaces), density=500
)


def turned(model: ObjectModel, R: np.ndarray) -> ObjectModel:
    X = np.eye(4)
    X[:3, :3] = R
    return replace(
        model,
        visual=model.visual.copy().apply_transform(X),
        pieces=tuple(piece @ R.T for piece in model.pieces),
        p_OCom=R @ model.p_OCom,
        inertia=R @ model.inertia @ R.T,
    )


def card_of(both: ObjectModel) -> tuple[np.ndarray, np.ndarray]:
    """Its size and centre, m."""
    found = box_of(both.pieces[-1])
    assert found is not None
    return found


@pytest.mark.parametrize("name", NAMES)
def test_card_and_object_are_one_closed_body(name: str) -> None:
    model = make_object(name)
    both = packaged_model(model, 1)
    size, center = card_of(both)
    assert both.visual.is_volume
    assert both.visual.body_count == 1
    assert CARD_THICKNESS[0] <= size[2] <= CARD_THICKNESS[1]
    assert max(size) <= LARGEST_CARD
    # The object is on the card, nowhere over its edge and not under it.
    low, high = center - size / 2, center + size / 2
    np.testing.assert_allclose(both.visual.bounds[0], low, atol=1e-9)
    np.testing.assert_allclose(both.visual.bounds[1, :2], high[:2], atol=1e-9)
    # Masses add up.
    card_mass = CARD_DENSITY * size.prod()
    assert both.mass == pytest.approx(model.mass + card_mass)
    assert len(both.pieces) == len(model.pieces) + 1
    # The object moves rigidly, and the common centre is the origin.
    np.testing.assert_allclose(both.p_OCom, 0, atol=1e-12)
    before, after = (
        np.concatenate(m.pieces[: len(model.pieces)]) for m in (model, both)
    )
    X, _, cost = trimesh.registration.procrustes(
        before, after, reflection=False, scale=False
    )
    assert cost < 1e-16
    away = -card_mass * center / model.mass
    np.testing.assert_allclose(X[:3, 3], away, atol=1e-9 / model.mass)
    # The sum of the principal moments does not depend on the frame.
    a, b, c = np.linalg.eigvalsh(both.inertia)
    assert 0 < a <= b <= c <= a + b
    expected = (
        np.trace(model.inertia)
        + card_mass * (size @ size / 6 + 2 * center @ center)
        + 2 * model.mass * away @ away
    )
    assert np.trace(both.inertia) == pytest.approx(expected, rel=1e-6)


@given(turn=st.integers(0, 2**32 - 1), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_a_box_lies_on_its_largest_side_however_it_was_turned(
    turn: int, seed: int
) -> None:
    R = Rotation.random(random_state=turn).as_matrix()
    both = packaged_model(turned(BOX, R), seed)
    size, _ = card_of(both)
    height = both.extents[2] - size[2]
    assert height == pytest.approx(0.03 - 0.0005, abs=1e-6)
    assert 0.1 * MARGIN[0] - 1e-6 <= size[0] <= 0.1 * MARGIN[1] + 1e-6
    assert 0.06 * MARGIN[0] - 1e-6 <= size[1] <= 0.06 * MARGIN[1] + 1e-6


def test_it_does_not_lie_where_it_would_tip_over() -> None:
    solid = rod((0, 0, 0), (0, 0, 0.1), 0.02, 0.004) + box(
        0.06, 0.06, 0.02, (0, 0, -0.01)
    )
    model = object_from_pieces("spike", list(solid.surfaces), density=500)
    up = flattest_side(model) @ (0, 0, 1)
    assert abs(up[2]) < 0.99 or up[2] > 0


def test_an_open_mesh_with_masses_of_its_own() -> None:
    open_mesh = trimesh.creation.box((0.08, 0.05, 0.03))
    open_mesh.update_faces(np.arange(len(open_mesh.faces)) > 1)
    assert not open_mesh.is_volume
    model = ObjectModel(
        name="toys/shell",
        visual=open_mesh,
        pieces=(np.array(trimesh.creation.box((0.08, 0.05, 0.03)).vertices),),
        mass=0.05,
        p_OCom=np.array([0.01, 0, 0.002]),
        inertia=np.diag([2e-5, 3e-5, 4e-5]),
        friction=0.4,
    )
    both = packaged_model(model, 0)
    assert both.name == "toys/shell_packaged"
    assert both.friction == 0.4
    assert both.mass > 0.05
    np.testing.assert_allclose(both.p_OCom, 0)
    assert len(both.visual.faces) == len(open_mesh.faces) + 12


def test_a_texture_moves_along_and_the_card_is_plain() -> None:
    image = np.arange(8 * 6 * 3, dtype=np.uint8).reshape(8, 6, 3)
    corners = np.asarray(BOX.visual.vertices)
    uv = np.random.default_rng(0).random((len(corners), 2))
    model = replace(
        BOX,
        textured=TexturedMesh(
            corners.astype(np.float32),
            np.asarray(BOX.visual.faces, dtype=np.int32),
            uv.astype(np.float32),
            image,
        ),
    )
    both = packaged_model(model, 0)
    assert model.textured is not None
    assert both.textured is not None
    before, after = (
        mesh.image[
            np.floor((1 - mesh.uv[:, 1]) * mesh.image.shape[0]).astype(int),
            np.floor(mesh.uv[:, 0] * mesh.image.shape[1]).astype(int),
        ]
        for mesh in (model.textured, both.textured)
    )
    np.testing.assert_array_equal(after[:8], before)
    np.testing.assert_array_equal(after[8:], np.tile(CARD_COLOR, (8, 1)))
    np.testing.assert_allclose(
        np.ptp(both.textured.vertices, axis=0), both.extents, atol=1e-6
    )


def test_a_card_is_never_longer_than_allowed() -> None:
    bar = object_from_pieces(
        "bar", list(box(0.24, 0.02, 0.01).surfaces), density=500
    )
    size, _ = card_of(packaged_model(bar, 5))
    assert size[0] == pytest.approx(LARGEST_CARD)


def test_packaged_objects_of_the_library() -> None:
    plain = object_names(split="test")
    names = object_names(split="test", packaged=True)
    assert names[: len(plain)] == plain
    extra = names[len(plain) :]
    assert 0.18 < len(extra) / len(names) < 0.25  # the paper's: 13 of 59
    assert all(name.endswith("_packaged") for name in extra)
    assert {split_of(name) for name in extra} == {"test"}
    model = make_object(extra[0])
    assert model is make_object(extra[0])
    assert model.name == extra[0]
    # Every object has one, listed or not.
    assert make_object("bottle_000_packaged").name == "bottle_000_packaged"
    assert split_of("bottle_000_packaged") == split_of("bottle_000")
    with pytest.raises(ValueError, match="bottle_999_packaged"):
        make_object("bottle_999_packaged")
