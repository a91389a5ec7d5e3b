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
from xray_drake.scene.contact import (
    ContactConfig,
    hydroelastic_modulus,
)
from xray_drake.scene.library import make_object
from xray_drake.scene.meshes import load_meshes
from xray_drake.scene.sdf import write_sdf, write_targets
from xray_drake.scene.targets import target_model


def parse(path):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    return plant, scene_graph.model_inspector()


def spatial_inertia(plant, name):
    return plant.GetBodyByName(name).default_spatial_inertia()


def rotational_inertia_about_com(M):
    G = M.Shift(M.get_com()).CalcRotationalInertia()
    return G.CopyToFullMatrix3()


@pytest.mark.parametrize(
    "model",
    [
        target_model("box_4to1"),
        target_model("lid"),
        target_model("flute"),
        make_object("bracket_004"),
        make_object("saucepan_000"),
    ],
    ids=lambda model: model.name,
)
def test_drake_reads_back_what_was_written(model, tmp_path):
    path = write_sdf(model, tmp_path / "new" / "folder")
    assert path.name == f"{model.name}.sdf"
    plant, inspector = parse(path)
    M = spatial_inertia(plant, model.name)
    assert M.get_mass() == pytest.approx(model.mass, rel=1e-5)
    np.testing.assert_allclose(M.get_com(), model.p_OCom, atol=1e-8)
    np.testing.assert_allclose(
        rotational_inertia_about_com(M),
        model.inertia,
        atol=1e-5 * model.inertia.max(),
    )
    body = plant.GetBodyByName(model.name)
    pieces = plant.GetCollisionGeometriesForBody(body)
    assert len(pieces) == len(model.pieces)
    for geometry in pieces:
        properties = inspector.GetProximityProperties(geometry)
        index = int(inspector.GetName(geometry).rsplit("_", 1)[1])
        assert properties.GetProperty(
            "hydroelastic", "hydroelastic_modulus"
        ) == pytest.approx(
            hydroelastic_modulus(model.pieces[index], ContactConfig()), rel=1e-5
        )
        assert (
            properties.GetProperty("material", "hunt_crossley_dissipation")
            == ContactConfig().dissipation
        )
        friction = properties.GetProperty("material", "coulomb_friction")
        assert friction.dynamic_friction() == model.friction
    (visual,) = plant.GetVisualGeometriesForBody(body)
    for role in (Role.kPerception, Role.kIllustration):
        assert inspector.GetProperties(visual, role) is not None
    diffuse = inspector.GetPerceptionProperties(visual).GetProperty(
        "phong", "diffuse"
    )
    np.testing.assert_allclose(diffuse.rgba, model.color, atol=1e-5)


def geometry_types(plant, inspector, name):
    body = plant.GetBodyByName(name)
    return [
        type(inspector.GetShape(geometry)).__name__
        for geometry in (
            *plant.GetVisualGeometriesForBody(body),
            *plant.GetCollisionGeometriesForBody(body),
        )
    ]


def test_boxes_stay_boxes_and_the_rest_is_convex(tmp_path):
    plant, inspector = parse(write_sdf(target_model("domino"), tmp_path))
    assert geometry_types(plant, inspector, "domino") == ["Box", "Box"]
    assert not list(tmp_path.glob("*.obj"))
    plant, inspector = parse(write_sdf(make_object("bracket_000"), tmp_path))
    types = geometry_types(plant, inspector, "bracket_000")
    assert types[0] == "Mesh"
    assert types[1:3] == ["Box", "Box"]
    plant, inspector = parse(write_sdf(target_model("flute"), tmp_path))
    assert geometry_types(plant, inspector, "flute") == ["Mesh", "Convex"]


def test_visual_mesh_is_complete_and_has_normals(tmp_path):
    model = target_model("lid")
    write_sdf(model, tmp_path)
    path = tmp_path / "lid_visual.obj"
    assert path.read_text().count("\nvn ") > 100
    mesh = trimesh.load_mesh(path)
    assert mesh.volume == pytest.approx(model.visual.volume, rel=1e-5)


def test_imported_names_make_flat_file_names(tmp_path):
    (tmp_path / "in").mkdir()
    trimesh.creation.icosphere(2, 0.03).export(tmp_path / "in" / "ball.obj")
    (model,) = load_meshes(tmp_path / "in")
    path = write_sdf(model, tmp_path / "out")
    assert path == tmp_path / "out" / "in_ball.sdf"
    plant, _ = parse(path)
    M = spatial_inertia(plant, "in/ball")
    assert M.get_mass() == pytest.approx(model.mass, rel=1e-5)


def vertices(path):
    values = []
    for line in path.read_text().splitlines():
        if line.startswith("v "):
            values.append([float(word) for word in line.split()[1:]])
    return np.array(values)


def test_targets_on_disk_are_what_the_generator_writes(tmp_path):
    stored = models_dir() / "targets"
    written = write_targets(tmp_path)
    assert [path.stem for path in written] == list(TARGET_NAMES)
    names = sorted(path.name for path in stored.iterdir())
    assert names == sorted(path.name for path in tmp_path.iterdir())
    for path in written:
        fresh = ElementTree.canonicalize(from_file=path, strip_text=True)
        old = ElementTree.canonicalize(
            from_file=stored / path.name, strip_text=True
        )
        assert fresh == old, path.name
    # Meshes are compared as shapes: their triangles are the choice of the
    # version of the boolean engine.
    for path in tmp_path.glob("*.obj"):
        fresh, old = (
            trimesh.load_mesh(path),
            trimesh.load_mesh(stored / path.name),
        )
        np.testing.assert_allclose(fresh.bounds, old.bounds, atol=1e-7)
        assert fresh.volume == pytest.approx(old.volume, rel=1e-5)
        assert fresh.area == pytest.approx(old.area, rel=1e-5)
        corners = [
            np.unique(vertices(file).round(6), axis=0)
            for file in (path, stored / path.name)
        ]
        np.testing.assert_array_equal(*corners, err_msg=path.name)
