from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Role
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from xray_drake.choices import TARGET_NAMES
from xray_drake.resources import models_dir
from xray_drake.scene.contact import ContactConfig, hydroelastic_modulus
from xray_drake.scene.library import make_object
from xray_drake.scene.sdf import write_sdf, write_targets
from xray_drake.scene.targets import target_model


def parse(path):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    return plant, scene_graph.model_inspector()


MODELS = [
    *map(target_model, ("box_4to1", "lid", "flute")),
    *map(make_object, ("bracket_004", "saucepan_000")),
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_drake_reads_back_what_was_written(model, tmp_path):
    path = write_sdf(model, tmp_path / "new" / "folder")
    assert path.name == f"{model.name}.sdf"
    plant, inspector = parse(path)
    body = plant.GetBodyByName(model.name)
    M = body.default_spatial_inertia()
    assert M.get_mass() == pytest.approx(model.mass, rel=1e-5)
    np.testing.assert_allclose(M.get_com(), model.p_OCom, atol=1e-8)
    np.testing.assert_allclose(
        M.Shift(M.get_com()).CalcRotationalInertia().CopyToFullMatrix3(),
        model.inertia,
        atol=1e-5 * model.inertia.max(),
    )
    pieces = plant.GetCollisionGeometriesForBody(body)
    assert len(pieces) == len(model.pieces)
    contact = ContactConfig()
    for geometry in pieces:
        index = int(inspector.GetName(geometry).rsplit("_", 1)[1])
        found = inspector.GetProximityProperties(geometry).GetProperty
        modulus = found("hydroelastic", "hydroelastic_modulus")
        expected = hydroelastic_modulus(model.pieces[index], contact)
        assert modulus == pytest.approx(expected, rel=1e-5)
        dissipation = found("material", "hunt_crossley_dissipation")
        assert dissipation == contact.dissipation
        friction = found("material", "coulomb_friction")
        assert friction.dynamic_friction() == model.friction
    (visual,) = plant.GetVisualGeometriesForBody(body)
    for role in (Role.kPerception, Role.kIllustration):
        diffuse = inspector.GetProperties(visual, role).GetProperty(
            "phong", "diffuse"
        )
        np.testing.assert_allclose(diffuse.rgba, model.color, atol=1e-5)


@pytest.mark.parametrize(
    ("model", "types"),
    [
        (target_model("domino"), ["Box", "Box"]),
        (make_object("bracket_000"), ["Mesh", "Box", "Box"]),
        (target_model("flute"), ["Mesh", "Convex"]),
    ],
)
def test_boxes_stay_boxes_and_the_rest_is_convex(model, types, tmp_path):
    plant, inspector = parse(write_sdf(model, tmp_path))
    body = plant.GetBodyByName(model.name)
    geometries = plant.GetVisualGeometriesForBody(body)
    geometries += plant.GetCollisionGeometriesForBody(body)
    found = [type(inspector.GetShape(g)).__name__ for g in geometries]
    assert found[: len(types)] == types
    assert bool(list(tmp_path.glob("*.obj"))) == ("Mesh" in types)


def test_visual_mesh_is_complete_and_has_normals(tmp_path):
    model = target_model("lid")
    write_sdf(model, tmp_path)
    path = tmp_path / "lid_visual.obj"
    assert path.read_text().count("\nvn ") > 100
    mesh = trimesh.load_mesh(path)
    assert mesh.volume == pytest.approx(model.visual.volume, rel=1e-5)


def vertices(path):
    lines = path.read_text().splitlines()
    rows = [line.split()[1:] for line in lines if line.startswith("v ")]
    return np.unique(np.array(rows, float).round(6), axis=0)


def test_targets_on_disk_are_what_the_generator_writes(tmp_path):
    stored = models_dir() / "targets"
    written = write_targets(tmp_path)
    assert [path.stem for path in written] == list(TARGET_NAMES)
    names = sorted(path.name for path in stored.iterdir())
    assert names == sorted(path.name for path in tmp_path.iterdir())
    for path in written:
        fresh, old = (
            ElementTree.canonicalize(from_file=file, strip_text=True)
            for file in (path, stored / path.name)
        )
        assert fresh == old, path.name
    # Meshes are compared as shapes: their triangles are the choice of the
    # version of the boolean engine.
    for path in tmp_path.glob("*.obj"):
        both = path, stored / path.name
        fresh, old = map(trimesh.load_mesh, both)
        assert fresh.volume == pytest.approx(old.volume, rel=1e-5)
        assert fresh.area == pytest.approx(old.area, rel=1e-5)
        np.testing.assert_array_equal(*map(vertices, both), err_msg=path.name)
