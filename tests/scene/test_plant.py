from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import RenderLabel, Role
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from tests.nominal import BIN, TOTE
from tests.scene.placed import Placed
from xray_drake.scene.contact import ContactConfig, hydroelastic_modulus
from xray_drake.scene.library import make_object
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.plant import (
    add_bin,
    add_plant,
    add_tote,
    default_plant_config,
    in_memory_mesh,
)
from xray_drake.scene.shapes import box
from xray_drake.scene.targets import target_model


def hammer() -> ObjectModel:
    """A handle and a head; its centre of mass is far from its origin."""
    solid = box(0.1, 0.015, 0.015) + box(0.02, 0.05, 0.03, (0.05, 0.01, 0.004))
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_matrix()
    X[:3, 3] = 0.02, -0.03, 0.01
    return object_from_pieces(
        "hammer",
        list(solid.transformed(X).surfaces),
        density=800.0,
        recenter=False,
        friction=0.3,
        color=(0.1, 0.6, 0.2, 1.0),
    )


@pytest.mark.parametrize(
    "model",
    [hammer(), target_model("lid"), make_object("brick_003")],
    ids=lambda model: model.name,
)
def test_mass_and_inertia_are_the_models(model: ObjectModel) -> None:
    if model.name == "hammer":  # otherwise it would not tell much
        assert np.linalg.norm(model.p_OCom) > 0.03
        products = model.inertia - np.diag(np.diag(model.inertia))
        assert np.abs(products).max() > 0.05 * np.trace(model.inertia)
    body = Placed([model]).items[model.name].body
    inertia = body.default_spatial_inertia()
    assert inertia.get_mass() == pytest.approx(model.mass, rel=1e-12)
    np.testing.assert_allclose(inertia.get_com(), model.p_OCom, atol=1e-12)
    about_com = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
    np.testing.assert_allclose(
        about_com.CopyToFullMatrix3(),
        model.inertia,
        atol=1e-9 * np.trace(model.inertia),
    )


def test_pieces_become_compliant_convex_geometries() -> None:
    model = hammer()
    station = Placed([model])
    inspector = station.scene_graph.model_inspector()
    geometries = station.plant.GetCollisionGeometriesForBody(
        station.items["hammer"].body
    )
    assert len(geometries) == len(model.pieces) == 2
    for geometry, vertices in zip(geometries, model.pieces, strict=True):
        found = inspector.GetProximityProperties(geometry).GetProperty
        modulus = found("hydroelastic", "hydroelastic_modulus")
        assert modulus == hydroelastic_modulus(vertices, ContactConfig())
        assert found("material", "coulomb_friction").dynamic_friction() == 0.3
        hull = inspector.GetShape(geometry).GetConvexHull()
        corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        np.testing.assert_allclose(
            corners[np.lexsort(corners.T.round(6))],
            vertices[np.lexsort(vertices.T.round(6))],
            atol=1e-6,
        )


sides = st.floats(0.004, 0.12)


@settings(deadline=None, max_examples=40)
@given(sides, sides, sides, st.floats(1e6, 1e9))
def test_pressure_rises_with_depth_at_one_rate_in_all(
    x: float, y: float, z: float, gradient: float
) -> None:
    config = ContactConfig(pressure_gradient=gradient)
    modulus = hydroelastic_modulus(box(x, y, z).hulls[0], config)
    # Drake's compliant hull has the pressure E · depth / half thickness.
    assert modulus / (min(x, y, z) / 2) == pytest.approx(gradient, rel=1e-6)


def test_labels_are_body_indices_and_colours_the_models() -> None:
    station = Placed([hammer(), target_model("domino")])
    inspector = station.scene_graph.model_inspector()
    for item in station.items.values():
        frame = station.plant.GetBodyFrameIdOrThrow(item.body.index())
        (seen,) = inspector.GetGeometries(frame, Role.kPerception)
        properties = inspector.GetPerceptionProperties(seen)
        assert properties.GetProperty("label", "id") == RenderLabel(
            int(item.body.index())
        )
        rgba = properties.GetProperty("phong", "diffuse")
        assert (rgba.r(), rgba.g(), rgba.b(), rgba.a()) == item.model.color
    assert len({item.body_index for item in station.items.values()}) == 2


def test_free_rotation_decays_and_free_fall_does_not() -> None:
    model = hammer()
    joint = Placed([model]).items[model.name].joint
    mean_inertia = np.linalg.eigvalsh(model.inertia).mean()
    assert joint.default_angular_damping() == pytest.approx(
        mean_inertia / ContactConfig().tumble_time
    )
    assert joint.default_translational_damping() == 0.0


@pytest.mark.parametrize("with_tote", [True, False])
def test_bin_and_tote_stand_still_and_are_not_the_world(
    with_tote: bool,
) -> None:
    plant, _ = add_plant(DiagramBuilder(), default_plant_config())
    add_bin(plant, BIN)
    if with_tote:
        add_tote(plant, TOTE)
    plant.Finalize()
    assert plant.HasBodyNamed("tote") == with_tote
    assert not plant.GetCollisionGeometriesForBody(plant.world_body())
    assert plant.num_velocities() == 0
    context = plant.CreateDefaultContext()
    for name, x in (("bin", 0.0), ("tote", 0.62))[: 1 + with_tote]:
        body = plant.GetBodyByName(name)
        assert len(plant.GetCollisionGeometriesForBody(body)) >= 5
        X_WB = body.EvalPoseInWorld(context)
        np.testing.assert_allclose(X_WB.translation(), [x, 0, 0])


def test_body_and_joint_of_an_object_belong_together() -> None:
    station = Placed([hammer(), target_model("domino")])
    X = RigidTransform([0.1, 0.05, 0.2])
    station.items["domino"].joint.SetPose(station.context, X)
    moved = station.pose("domino")
    np.testing.assert_array_equal(moved, X.GetAsMatrix4())
    assert [i.name for i in station.items.values()] == ["hammer", "domino"]


@pytest.mark.parametrize(
    ("where", "inside", "p_W"),
    [
        (BIN.is_over, True, (0.0, 0.0, 0.0)),
        (BIN.is_over, True, (0.249, -0.199, 0.3)),
        (BIN.is_over, False, (0.251, 0.0, 0.1)),
        (BIN.is_over, False, (-0.251, 0.0, 0.1)),
        (BIN.is_over, False, (0.0, 0.201, 0.1)),
        (BIN.is_over, False, (0.0, -0.201, 0.1)),
        (BIN.is_over, False, (0.0, 0.0, -0.02)),
        (BIN.is_over, False, (np.nan, 0.0, 0.0)),
        *[
            (where, inside, p_W)
            for where, on_top in ((TOTE.holds, False), (TOTE.is_under, True))
            for inside, p_W in (
                (True, (0.62, 0.0, 0.0)),
                (True, (0.62 + 0.179, -0.179, 0.1)),
                # On a pile, or held above it.
                (on_top, (0.62, 0.0, 0.13)),
                (False, (0.62 - 0.181, 0.0, 0.05)),
                (False, (0.62, 0.181, 0.05)),
                (False, (0.62, 0.0, -40.0)),
                (False, (0.0, 0.0, 0.05)),
                (False, (np.nan, 0.0, 0.05)),
            )
        ],
    ],
)
def test_inside_bin_and_tote(
    where: Callable[[np.ndarray], bool],
    inside: bool,
    p_W: tuple[float, float, float],
) -> None:
    assert where(np.array(p_W)) is inside


def test_meshes_for_the_renderer_have_normals_and_sharp_edges() -> None:
    mesh = target_model("box_2to1").visual
    text = in_memory_mesh(mesh, "box").mesh_file.contents().decode()
    lines = text.splitlines()
    assert sum(line.startswith("f ") for line in lines) == len(mesh.faces)
    normals = np.array(
        [line.split()[1:] for line in lines if line.startswith("vn ")], float
    )
    # Flat faces: every normal is along an axis, none is an edge's mean.
    assert len(normals) >= 6
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1.0, atol=1e-6)
