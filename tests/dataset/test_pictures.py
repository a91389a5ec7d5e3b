from dataclasses import replace

import numpy as np
import pytest

from tests.nominal import BIN
from xray_drake.cell.cameras import (
    CameraSampling,
    nominal_camera,
    sample_camera,
)
from xray_drake.dataset.pictures import Photographer
from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import TexturedMesh
from xray_drake.testing.tiny import Observation


@pytest.fixture(scope="module")
def photographer(tiny_heap: Heap) -> Photographer:
    made = Photographer(
        tiny_heap.target, tiny_heap.objects, nominal_camera(), BIN
    )
    made.place(tiny_heap)
    return made


def test_a_picture_is_what_the_station_sees(
    photographer: Photographer, recorded_observation: Observation
) -> None:
    photographer.look_from(nominal_camera())
    picture = photographer.take()
    np.testing.assert_allclose(
        picture.depth, recorded_observation.depth, atol=1e-6
    )
    labels = recorded_observation.label_of
    for number, name in enumerate(picture.names, start=2):
        np.testing.assert_array_equal(
            picture.instances == number,
            recorded_observation.labels == labels[name],
        )
    assert picture.color is None


def test_without_the_target_only_its_pixels_change(
    photographer: Photographer,
) -> None:
    photographer.look_from(nominal_camera())
    picture = photographer.take()
    target = picture.instances == 1
    assert target.any()
    same = picture.depth == picture.depth_without_target
    assert same[~target].all()
    assert (picture.depth[target] < picture.depth_without_target[target]).all()
    # And it is put back.
    np.testing.assert_array_equal(photographer.depth(), picture.depth)


def test_drawn_cameras_see_the_target_where_geometry_says(
    photographer: Photographer, tiny_heap: Heap
) -> None:
    rng = np.random.default_rng(4)
    sampling = CameraSampling(enabled=True, most_angle=10)
    for _ in range(3):
        config = sample_camera(nominal_camera(), sampling, rng)
        photographer.look_from(config)
        picture = photographer.take()
        amodal = project_mesh_mask(
            tiny_heap.target.visual.vertices,
            tiny_heap.target.visual.faces,
            tiny_heap.poses[tiny_heap.target.name],
            picture.camera,
        )
        modal = picture.instances == 1
        assert modal.any()
        assert np.count_nonzero(modal & ~amodal) <= 0.01 * amodal.sum()


def test_an_object_that_is_not_placed_is_not_seen(
    photographer: Photographer, tiny_heap: Heap
) -> None:
    name = tiny_heap.target.name
    poses = {name: tiny_heap.poses[name]}
    alone = replace(tiny_heap, objects=(), poses=poses)
    photographer.place(alone)
    photographer.look_from(nominal_camera())
    picture = photographer.take()
    photographer.place(tiny_heap)
    assert set(np.unique(picture.instances)) == {0, 1}
    # Seen: the bare floor around the target.
    floor = picture.depth_without_target[192, 256]
    assert floor == pytest.approx(0.8, abs=1e-4)
    bare = Photographer(tiny_heap.target, (), nominal_camera(), BIN)
    with pytest.raises(KeyError, match="not in this scene"):
        bare.place(tiny_heap)


def test_colour_has_the_texture(tiny_heap: Heap) -> None:
    model = tiny_heap.objects[0]
    mesh = model.visual
    stripes = np.zeros((8, 8, 3), np.uint8)
    stripes[:, ::2, 1] = stripes[:, 1::2, 2] = 255
    uv = (mesh.vertices[:, :2] - mesh.bounds[0, :2]) / mesh.extents[:2]
    textured = TexturedMesh(
        np.array(mesh.vertices, np.float32),
        np.array(mesh.faces, np.int32),
        uv.astype(np.float32),
        stripes,
    )
    objects = [replace(model, textured=textured), *tiny_heap.objects[1:]]
    made = Photographer(
        tiny_heap.target, objects, nominal_camera(), BIN, color=True
    )
    made.place(tiny_heap)
    made.look_from(nominal_camera())
    picture = made.take()
    assert picture.color is not None
    seen = picture.color[picture.instances == 2].astype(int)
    assert (seen[:, 1] > seen[:, 2] + 40).mean() > 0.2  # greenish
    assert (seen[:, 2] > seen[:, 1] + 40).mean() > 0.2  # bluish
    target = picture.color[picture.instances == 1].astype(int)
    assert (target[:, 0] > target[:, 1] + 40).all()
