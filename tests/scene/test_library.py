import subprocess
import sys

import cv2
import numpy as np
import pytest
import trimesh

from xray_drake.scene.colors import distractor_color
from xray_drake.scene.families import (
    FAMILIES,
    TEST_FAMILIES,
    TRAINING_FAMILIES,
)
from xray_drake.scene.library import (
    SPLITS,
    drawn_object,
    families_of,
    make_object,
    object_names,
    split_of,
)

LARGEST_MEAN_GAP = 0.0007
"""m between the surface seen and the collision pieces, averaged."""

LARGEST_GAP = 0.0025
"""m, along the axes."""

LARGEST_SILHOUETTE_GAP = 0.0035
"""m, between the outlines from three sides."""


ALL_NAMES = tuple(
    name for split in SPLITS for name in object_names(split=split)
)


@pytest.fixture(scope="module")
def library():
    """Two of every family: one drawn plainly, and the last."""
    return [
        make_object(names[i])
        for names in map(object_names, FAMILIES)
        for i in (3, -1)
    ]


@pytest.fixture(scope="module")
def hulls(library):
    return {
        model.name: [trimesh.Trimesh(p).convex_hull for p in model.pieces]
        for model in library
    }


def test_size_and_names():
    train, validation, test = (object_names(split=s) for s in SPLITS)
    assert len(train) >= 1296
    assert len(validation) >= 144
    assert len(test) >= 160
    assert object_names() == train
    assert len(set(ALL_NAMES)) == len(ALL_NAMES)
    assert "bottle_003" in train
    for split in SPLITS:
        assert {split_of(name) for name in object_names(split=split)} == {split}


def test_families_of_the_splits():
    assert families_of("train") == tuple(TRAINING_FAMILIES)
    assert families_of("validation") == tuple(TRAINING_FAMILIES)
    assert families_of("test") == tuple(TEST_FAMILIES)
    assert families_of() == tuple(FAMILIES)
    assert len(TRAINING_FAMILIES) >= 20
    assert len(TEST_FAMILIES) >= 8
    assert not set(TRAINING_FAMILIES) & set(TEST_FAMILIES)


def test_names_of_chosen_families():
    chosen = object_names("ring", "can")
    count = len(object_names("ring"))
    assert chosen[0] == "ring_000"
    assert chosen[count - 1] == f"ring_{count - 1:03d}"
    assert chosen[count] == "can_000"
    assert {split_of(name) for name in chosen} == {"train", "validation"}
    only = object_names("ring", split="validation")
    assert only == tuple(n for n in chosen[:count] if split_of(n) != "train")


@pytest.mark.parametrize(
    "name", ["unicorn_000", "bottle_999", "bottle_3", "bottle_-01", "bottle"]
)
def test_unknown_object(name):
    with pytest.raises(ValueError, match=r"there are|has bottle_000"):
        make_object(name)
    with pytest.raises(ValueError, match=r"there are|has bottle_000"):
        split_of(name)
    with pytest.raises(ValueError, match="exam"):
        object_names(split="exam")


def test_the_first_draws_are_what_they_were_before_the_table():
    before = {"carton": 0.0253298, "hook": 0.0155682, "tube": 0.0750490}
    for family, mass in before.items():
        assert drawn_object("x", family, 4).mass == pytest.approx(
            mass, rel=1e-5
        )


def test_surfaces_are_closed_single_bodies(library):
    for model in library:
        assert model.visual.is_volume, model.name
        assert model.visual.body_count == 1, model.name


def test_mass_properties(library):
    for model in library:
        assert 0.002 < model.mass < 0.5, model.name
        np.testing.assert_allclose(model.p_OCom, 0, atol=1e-9)
        np.testing.assert_allclose(
            model.visual.center_mass, 0, atol=1e-9, err_msg=model.name
        )
        a, b, c = np.linalg.eigvalsh(model.inertia)
        assert 0 < a <= b <= c <= a + b, model.name
    masses = [model.mass for model in library]
    assert 0.02 < np.median(masses) < 0.2


def test_sizes_suit_the_bin(library):
    longest = np.array([model.extents.max() for model in library])
    assert longest.min() > 0.02
    assert longest.max() < 0.20
    # What hides a target is mostly 7 to 14 cm; a share is small or thin.
    assert np.mean((longest > 0.07) & (longest < 0.14)) > 0.5
    thin = [np.sort(model.extents)[1] < 0.04 for model in library]
    assert 0.1 < np.mean(thin) < 0.4


def test_pieces_are_few_and_small_convex_hulls(library, hulls):
    for model in library:
        assert 1 <= len(model.pieces) <= 10, model.name
        for piece, hull in zip(model.pieces, hulls[model.name], strict=True):
            assert 6 <= len(piece) <= 16, model.name
            assert len(hull.vertices) == len(piece), model.name


def test_pieces_agree_with_the_surface(library, hulls):
    for model in library:
        union = trimesh.boolean.union(hulls[model.name], engine="manifold")
        both = trimesh.boolean.intersection(
            [union, model.visual], engine="manifold"
        )
        difference = union.volume + model.visual.volume - 2 * both.volume
        assert difference / model.visual.area < LARGEST_MEAN_GAP, model.name
        np.testing.assert_allclose(
            union.bounds,
            model.visual.bounds,
            atol=LARGEST_GAP,
            err_msg=model.name,
        )
        assert union.volume == pytest.approx(model.visual.volume, rel=0.01)


def test_silhouettes_agree(library, hulls):
    def silhouette(vertices, faces, axes):
        image = np.zeros((400, 400), np.uint8)
        pixels = np.rint(vertices[:, axes] * 2000 + 200).astype(np.int32)
        for triangle in pixels[faces]:
            cv2.fillConvexPoly(image, triangle, 1)
        return image.astype(bool)

    radius = round(2000 * LARGEST_SILHOUETTE_GAP)
    neighbourhood = cv2.getStructuringElement(
        cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)
    )
    for model in library[::4]:
        for axes in ([0, 1], [0, 2], [1, 2]):
            seen = silhouette(model.visual.vertices, model.visual.faces, axes)
            felt = np.zeros_like(seen)
            for hull in hulls[model.name]:
                felt |= silhouette(hull.vertices, hull.faces, axes)
            for one, other in ((seen, felt), (felt, seen)):
                near = cv2.dilate(other.astype(np.uint8), neighbourhood)
                assert not np.any(one & (near == 0)), (model.name, axes)


def test_another_process_makes_the_same_objects():
    names = [object_names(family)[-5] for family in list(FAMILIES)[::4]]
    names.append("bottle_003_packaged")
    code = (
        "from xray_drake.scene.library import make_object\n"
        f"for name in {names!r}:\n"
        "    m = make_object(name)\n"
        "    print(name, m.mass.hex(), m.color, m.pieces[-1].tobytes().hex())"
    )
    told = subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.splitlines()
    here = []
    for name in names:
        m = make_object(name)
        here.append(
            f"{name} {m.mass.hex()} {m.color} {m.pieces[-1].tobytes().hex()}"
        )
    assert told == here


def looks_red(color):
    pixel = np.float32(color[:3]).reshape(1, 1, 3)
    hue, saturation, _ = cv2.cvtColor(pixel, cv2.COLOR_RGB2HSV)[0, 0]
    return saturation > 0.15 and min(hue, 360 - hue) < 25


def test_no_colour_is_ever_red():
    assert looks_red((0.8, 0.05, 0.05))
    rng = np.random.default_rng(0)
    colors = [distractor_color(rng) for _ in range(3000)]
    assert not any(map(looks_red, colors))
    assert np.std(colors, axis=0)[:3].min() > 0.15
