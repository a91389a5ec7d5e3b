import numpy as np
import pytest
import trimesh
from pydrake.geometry import Role
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from xray_drake.resources import models_dir
from xray_drake.scene.parsing import ConfigureParser, configure_parser


def parse(name, *, weld=False):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    parser = Parser(plant)
    configure_parser(parser)
    parser.AddModelsFromUrl(f"package://xray_drake_models/{name}/{name}.sdf")
    if weld:
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(name))
    plant.Finalize()
    return plant, scene_graph, builder


@pytest.mark.parametrize(
    ("name", "size"),
    [("bin", (0.50, 0.40, 0.12)), ("tote", (0.36, 0.36, 0.12))],
)
def test_inside_is_as_the_protocol_says(name, size):
    _, scene_graph, builder = parse(name, weld=True)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    query = scene_graph.get_query_output_port().Eval(
        scene_graph.GetMyContextFromRoot(context)
    )

    def clearance(point):
        results = query.ComputeSignedDistanceToPoint(point, threshold=1.0)
        return min(result.distance for result in results)

    x, y, z = np.array(size) / [2, 2, 1]
    for sign in (-1, 1):
        for point, distance in (
            ([sign * (x - 0.03), 0, 0.06], 0.03),
            ([0, sign * (y - 0.03), 0.06], 0.03),
            ([sign * (x + 0.005), 0, z + 0.01], 0.01),
        ):
            assert clearance(point) == pytest.approx(distance)
        assert clearance([sign * (x + 0.005), 0, z - 0.005]) < 0
    assert clearance([0, 0, 0.02]) == pytest.approx(0.02)
    assert clearance([0, 0, -0.005]) == pytest.approx(-0.005)
    assert clearance([x + 0.005, y + 0.005, 0.06]) < 0  # closed corners


@pytest.mark.parametrize("name", ["bin", "tote"])
def test_one_link_of_rigid_boxes_seen_and_felt_alike(name):
    plant, scene_graph, _ = parse(name)
    inspector = scene_graph.model_inspector()
    body = plant.GetBodyByName(name)
    assert plant.num_bodies() == 2
    assert plant.num_velocities() == 6  # free until the caller welds it

    def boxes(ids):
        return {
            tuple(inspector.GetPoseInFrame(g).translation()): tuple(
                inspector.GetShape(g).size()
            )
            for g in ids
        }

    collisions = plant.GetCollisionGeometriesForBody(body)
    visuals = plant.GetVisualGeometriesForBody(body)
    # What is inside the floor catches what is knocked below its top.
    inside = [g for g in collisions if "mm_down" in inspector.GetName(g)]
    assert len(inside) == (6 if name == "bin" else 0)
    for p_BG, size in boxes(inside).items():
        assert p_BG[2] + size[2] / 2 <= -0.002 + 1e-9
        assert p_BG[2] - size[2] / 2 == pytest.approx(-0.02)
    outer = [g for g in collisions if g not in inside]
    assert boxes(outer) == boxes(visuals)
    assert len(outer) == 5
    for geometry in collisions:
        found = inspector.GetProximityProperties(geometry)
        assert found.HasProperty("hydroelastic", "compliance_type")
        # What has no modulus but takes part is rigid.
        assert not found.HasProperty("hydroelastic", "hydroelastic_modulus")
        friction = found.GetProperty("material", "coulomb_friction")
        assert friction.static_friction() == friction.dynamic_friction() == 0.5
    for geometry in visuals:
        for role in (Role.kPerception, Role.kIllustration):
            assert inspector.GetProperties(geometry, role) is not None
    # The inertia is that of the boxes.
    M = body.default_spatial_inertia()
    assert M.get_mass() > 0.5
    parts = [
        (trimesh.creation.box(size).apply_translation(p), np.prod(size))
        for p, size in boxes(visuals).items()
    ]
    density = M.get_mass() / sum(volume for _, volume in parts)
    whole = trimesh.util.concatenate([part for part, _ in parts])
    whole.density = density
    np.testing.assert_allclose(M.get_com(), whole.center_mass, atol=1e-6)
    np.testing.assert_allclose(
        M.Shift(M.get_com()).CalcRotationalInertia().CopyToFullMatrix3(),
        whole.moment_inertia,
        atol=1e-4 * M.get_mass(),
    )


def test_every_model_opens_without_the_package_map():
    paths = sorted(models_dir().glob("targets/*.sdf"))
    paths += [models_dir() / f"{n}/{n}.sdf" for n in ("bin", "tote")]
    assert len(paths) == 15
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    for path in paths:
        assert "package://" not in path.read_text()
        Parser(plant).AddModels(str(path))
    plant.Finalize()
    assert plant.num_bodies() == 1 + len(paths)


def test_parser_can_be_configured_twice():
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.001)
    parser = Parser(plant)
    ConfigureParser(parser)
    configure_parser(parser)
    path = parser.package_map().GetPath("xray_drake_models")
    assert (models_dir() / "package.xml").samefile(f"{path}/package.xml")
