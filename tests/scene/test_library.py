import subprocess
import sys
from itertools import combinations

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from xray_drake.scene.colors import distractor_color
from xray_drake.scene.families import FAMILIES
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


BOUND = 0.03
"""Two objects of the library differ by more; 1 is the mean radius."""

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


def test_names_of_the_splits_and_their_families():
    split_names = [object_names(split=split) for split in SPLITS]
    assert list(map(len, split_names)) >= [1296, 144, 160]
    assert object_names() == split_names[0]
    assert len(set(ALL_NAMES)) == len(ALL_NAMES)
    assert "bottle_003" in split_names[0]
    for split, names in zip(SPLITS, split_names, strict=True):
        assert {split_of(name) for name in names} == {split}
        families = {name.rsplit("_", 1)[0] for name in names}
        assert families == set(families_of(split))
    assert families_of("train") == families_of("validation")
    assert len(families_of("train")) >= 20
    assert len(families_of("test")) >= 8
    assert not set(families_of("train")) & set(families_of("test"))
    assert families_of() == tuple(FAMILIES)


def test_names_of_chosen_families():
    chosen = object_names("ring", "can")
    count = len(object_names("ring"))
    assert chosen[0] == "ring_000"
    assert chosen[count - 1 : count + 1] == (f"ring_{count - 1:03d}", "can_000")
    assert {split_of(name) for name in chosen} == {"train", "validation"}
    only = object_names("ring", split="validation")
    assert only == tuple(n for n in chosen[:count] if split_of(n) != "train")


@pytest.mark.parametrize(
    "name", ["unicorn_000", "bottle_999", "bottle_3", "bottle_-01", "bottle"]
)
def test_unknown_object(name):
    for look_up in (make_object, split_of):
        with pytest.raises(ValueError, match=r"there are|has bottle_000"):
            look_up(name)


def test_the_first_draws_are_what_they_were_before_the_table():
    before = {"carton": 0.0253298, "hook": 0.0155682, "tube": 0.0750490}
    for family, mass in before.items():
        assert drawn_object("x", family, 4).mass == pytest.approx(
            mass, rel=1e-5
        )


def test_surfaces_are_single_bodies_with_their_mass(library):
    for model in library:
        assert model.visual.is_volume, model.name
        assert model.visual.body_count == 1, model.name
        assert 0.002 < model.mass < 0.5, model.name
        for center in (model.p_OCom, model.visual.center_mass):
            np.testing.assert_allclose(center, 0, atol=1e-9, err_msg=model.name)
        a, b, c = np.linalg.eigvalsh(model.inertia)
        assert 0 < a <= b <= c <= a + b, model.name
    assert 0.02 < np.median([model.mass for model in library]) < 0.2


def test_sizes_suit_the_bin(library):
    longest = np.array([model.extents.max() for model in library])
    assert longest.min() > 0.02
    assert longest.max() < 0.20
    # What hides a target is mostly 7 to 14 cm; a share is small or thin.
    assert np.mean((longest > 0.07) & (longest < 0.14)) > 0.5
    thin = [np.sort(model.extents)[1] < 0.04 for model in library]
    assert 0.1 < np.mean(thin) < 0.4


def test_pieces_are_few_small_hulls_that_agree_with_the_surface(library, hulls):
    for model in library:
        assert 1 <= len(model.pieces) <= 10, model.name
        for piece, hull in zip(model.pieces, hulls[model.name], strict=True):
            assert 6 <= len(piece) <= 16, model.name
            assert len(hull.vertices) == len(piece), model.name
        visual = model.visual
        union = trimesh.boolean.union(hulls[model.name], engine="manifold")
        both = trimesh.boolean.intersection([union, visual], engine="manifold")
        difference = union.volume + visual.volume - 2 * both.volume
        assert difference / visual.area < LARGEST_MEAN_GAP, model.name
        gap = np.abs(union.bounds - visual.bounds).max()
        assert gap < LARGEST_GAP, model.name
        assert union.volume == pytest.approx(visual.volume, rel=0.01)


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
        f"for m in map(make_object, {names!r}):\n"
        "    print(m.mass.hex(), m.color, m.pieces[-1].tobytes().hex())"
    )
    told = subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.splitlines()
    assert told == [
        f"{m.mass.hex()} {m.color} {m.pieces[-1].tobytes().hex()}"
        for m in map(make_object, names)
    ]


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


ROTATIONS = Rotation.create_group("O").as_matrix()
"""(24, 3, 3) that map axes to axes."""


class Likeness:
    """Points and surface of a shape of unit size, in two frames."""

    def __init__(self, mesh):
        surface, _ = trimesh.sample.sample_surface(mesh, 16384, seed=0)
        surface = surface - surface.mean(axis=0)
        surface /= np.sqrt(np.mean(np.sum(surface**2, axis=1)))
        _, principal = np.linalg.eigh(surface.T @ surface)
        principal[:, 0] *= np.sign(np.linalg.det(principal))
        frames = [surface, surface @ principal]
        self.points = [frame[::32] for frame in frames]
        self.trees = [cKDTree(frame) for frame in frames]

    def distance(self, other):
        """Chamfer distance: the least over the turns of either frame."""
        least = np.inf
        for one, tree, two, there in zip(
            self.points, self.trees, other.points, other.trees, strict=True
        ):
            # A few of the points tell which turns come near.
            far = 6 * BOUND
            rough, _ = there.query(
                one[::16] @ ROTATIONS, distance_upper_bound=far
            )
            rough = np.minimum(rough, far).mean(axis=1)
            for R in ROTATIONS[rough < 2 * BOUND]:
                away = there.query(one @ R)[0] + tree.query(two @ R.T)[0]
                least = min(least, float(away.mean()) / 2)
        return least


def test_size_and_turn_do_not_count_but_a_longer_brick_is_another():
    brick = trimesh.creation.box((0.08, 0.05, 0.02))
    found = []
    for factor in (1, 1.4):
        other = brick.copy().apply_scale((2 * factor, 2, 2))
        other.apply_transform(trimesh.transformations.euler_matrix(1, 2, 3))
        found.append(Likeness(brick).distance(Likeness(other)))
    assert found[0] < 0.02
    assert found[1] > BOUND


def test_no_two_objects_of_a_sample_are_alike():
    """Neighbours in a family are the most alike: some of these, and others."""
    sample = ALL_NAMES[5:9] + ALL_NAMES[400:404] + ALL_NAMES[::60]
    shapes = [Likeness(make_object(name).visual) for name in sample]
    for one, other in combinations(range(len(sample)), 2):
        found = shapes[one].distance(shapes[other])
        assert found > BOUND, (sample[one], sample[other], found)
