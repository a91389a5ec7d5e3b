import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import RenderLabel, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder
from scipy.spatial.transform import Rotation

from xray_drake.geometry.convex import half_thickness
from xray_drake.scene.contact import ContactConfig, hydroelastic_modulus
from xray_drake.scene.library import make_object
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.plant import (
    PlantObject,
    add_bin,
    add_object,
    add_objects,
    add_plant,
    default_plant_config,
    in_memory_mesh,
    inside_bin,
    inside_tote,
    over_tote,
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


class Station:
    """A finalized plant of bin, tote and objects."""

    def __init__(self, *models: ObjectModel) -> None:
        builder = DiagramBuilder()
        self.plant: MultibodyPlant
        self.scene_graph: SceneGraph
        self.plant, self.scene_graph = add_plant(
            builder, default_plant_config()
        )
        add_bin(self.plant, with_tote=True)
        self.items: list[PlantObject] = add_objects(self.plant, models)
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context: Context = self.plant.GetMyContextFromRoot(self.root)


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
    body = Station(model).items[0].body
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
    station = Station(model)
    inspector = station.scene_graph.model_inspector()
    body = station.items[0].body
    geometries = station.plant.GetCollisionGeometriesForBody(body)
    assert len(geometries) == len(model.pieces) == 2
    moduli = []
    for geometry, vertices in zip(geometries, model.pieces, strict=True):
        properties = inspector.GetProximityProperties(geometry)
        moduli.append(
            properties.GetProperty("hydroelastic", "hydroelastic_modulus")
        )
        friction = properties.GetProperty("material", "coulomb_friction")
        assert friction.dynamic_friction() == 0.3
        hull = inspector.GetShape(geometry).GetConvexHull()
        corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        np.testing.assert_allclose(
            corners[np.lexsort(corners.T.round(6))],
            vertices[np.lexsort(vertices.T.round(6))],
            atol=1e-6,
        )
    # Pressure rises at one rate in all, so thin pieces are not stiffer.
    thickness = [half_thickness(vertices) for vertices in model.pieces]
    assert thickness[1] > 1.2 * thickness[0]
    assert moduli[1] / moduli[0] == pytest.approx(thickness[1] / thickness[0])


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
    models = [hammer(), target_model("domino")]
    station = Station(*models)
    inspector = station.scene_graph.model_inspector()
    for model, item in zip(models, station.items, strict=True):
        frame = station.plant.GetBodyFrameIdOrThrow(item.body.index())
        (seen,) = inspector.GetGeometries(frame, Role.kPerception)
        properties = inspector.GetPerceptionProperties(seen)
        assert properties.GetProperty("label", "id") == RenderLabel(
            int(item.body.index())
        )
        rgba = properties.GetProperty("phong", "diffuse")
        assert (rgba.r(), rgba.g(), rgba.b(), rgba.a()) == model.color
    assert station.items[0].body.index() != station.items[1].body.index()


def test_free_rotation_decays_and_free_fall_does_not() -> None:
    model = hammer()
    joint = Station(model).items[0].joint
    mean_inertia = np.linalg.eigvalsh(model.inertia).mean()
    assert joint.default_angular_damping() == pytest.approx(
        mean_inertia / ContactConfig().tumble_time
    )
    assert joint.default_translational_damping() == 0.0


def test_two_objects_of_one_name() -> None:
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, default_plant_config())
    add_object(plant, hammer())
    with pytest.raises(RuntimeError, match="hammer"):
        add_object(plant, hammer())


def test_bin_and_tote_stand_still_and_are_not_the_world() -> None:
    plant = Station(hammer()).plant
    assert not plant.GetCollisionGeometriesForBody(plant.world_body())
    for name, x in (("bin", 0.0), ("tote", 0.62)):
        body = plant.GetBodyByName(name)
        assert plant.IsAnchored(body)
        assert len(plant.GetCollisionGeometriesForBody(body)) >= 5
        X = plant.CalcRelativeTransform(
            plant.CreateDefaultContext(),
            plant.world_frame(),
            body.body_frame(),
        )
        np.testing.assert_allclose(X.translation(), [x, 0, 0])
    assert plant.num_velocities() == 6  # the hammer's


def test_the_tote_is_there_on_request() -> None:
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, default_plant_config())
    add_bin(plant)
    assert plant.HasBodyNamed("bin")
    assert not plant.HasBodyNamed("tote")


def test_body_and_joint_of_an_object_belong_together() -> None:
    models = [hammer(), target_model("domino")]
    station = Station(*models)
    X = RigidTransform([0.1, 0.05, 0.2])
    station.items[1].joint.SetPose(station.context, X)
    moved = station.items[1].body.EvalPoseInWorld(station.context)
    np.testing.assert_array_equal(moved.GetAsMatrix4(), X.GetAsMatrix4())
    assert [item.name for item in station.items] == ["hammer", "domino"]


@pytest.mark.parametrize(
    ("p_W", "inside"),
    [
        ((0.0, 0.0, 0.0), True),
        ((0.249, -0.199, 0.3), True),
        ((0.251, 0.0, 0.1), False),
        ((-0.251, 0.0, 0.1), False),
        ((0.0, 0.201, 0.1), False),
        ((0.0, -0.201, 0.1), False),
        ((0.0, 0.0, -0.02), False),
        ((np.nan, 0.0, 0.0), False),
    ],
)
def test_inside_the_bin(p_W: tuple[float, float, float], inside: bool) -> None:
    assert inside_bin(np.array(p_W)) is inside


@pytest.mark.parametrize(
    ("p_W", "inside", "over"),
    [
        ((0.62, 0.0, 0.0), True, True),
        ((0.62 + 0.179, -0.179, 0.1), True, True),
        ((0.62, 0.0, 0.13), False, True),  # on a pile, or held above it
        ((0.62 - 0.181, 0.0, 0.05), False, False),
        ((0.62, 0.181, 0.05), False, False),
        ((0.62, 0.0, -40.0), False, False),
        ((0.0, 0.0, 0.05), False, False),
        ((np.nan, 0.0, 0.05), False, False),
    ],
)
def test_inside_the_tote(
    p_W: tuple[float, float, float], inside: bool, over: bool
) -> None:
    assert inside_tote(np.array(p_W)) is inside
    assert over_tote(np.array(p_W)) is over


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
