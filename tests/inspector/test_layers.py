from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Meshcat

from tests.meshcat_probe import prop
from xray_drake.drawing.colors import heat
from xray_drake.inspector.layers import (
    LAYERS,
    SnapshotLayers,
    mask_colors,
    score_colors,
    seen_points,
)
from xray_drake.inspector.replay import Replay
from xray_drake.inspector.snapshot import Snapshot
from xray_drake.messages import (
    Grasp,
    InstanceMasks,
    OccupancyDistribution,
    RankedCandidate,
    SearchAction,
)

NAMES = [layer.name for layer in LAYERS]
SHOWN = {layer.name for layer in LAYERS if layer.opacity > 0}


def drawn(meshcat: Meshcat, step: int) -> set[str]:
    return {
        name
        for name in NAMES
        if meshcat.HasPath(f"/inspect/{name}/step_{step:02d}")
    }


def seen(meshcat: Meshcat, step: int) -> set[str]:
    """Returns the layers of a step that a browser shows."""
    return {
        name
        for name in drawn(meshcat, step)
        if prop(meshcat, f"/inspect/{name}", "visible")
        and prop(meshcat, f"/inspect/{name}/step_{step:02d}", "visible")
    }


def test_layers_are_drawn_when_they_are_first_seen(
    meshcat: Meshcat, replay: Replay
) -> None:
    layers = SnapshotLayers(meshcat, replay.snapshots)
    assert not drawn(meshcat, 1)
    layers.show(1)
    assert seen(meshcat, 1) == drawn(meshcat, 1) == SHOWN
    assert not drawn(meshcat, 2)

    layers.show(2)
    assert layers.step == 2
    assert seen(meshcat, 2) == SHOWN
    assert not seen(meshcat, 1)

    layers.set_opacity("instances", 0.5)
    assert seen(meshcat, 2) == SHOWN | {"instances"}
    assert drawn(meshcat, 1) == SHOWN
    layers.set_opacity("occupancy", 0.0)
    assert seen(meshcat, 2) == SHOWN - {"occupancy"} | {"instances"}
    layers.show(1)
    assert seen(meshcat, 1) == SHOWN - {"occupancy"} | {"instances"}
    # The end of a search has no decision.
    layers.show(3)
    assert not seen(meshcat, 1) | seen(meshcat, 2) | drawn(meshcat, 3)
    with pytest.raises(ValueError, match=r"no layer 'mask'.*occupancy"):
        layers.set_opacity("mask", 1.0)


def test_going_back_draws_nothing(meshcat: Meshcat, replay: Replay) -> None:
    calls: list[tuple[str, int]] = []
    counted = tuple(
        replace(
            layer,
            draw=lambda m, path, shot, layer=layer: (
                calls.append((layer.name, shot.step)),
                layer.draw(m, path, shot),
            ),
        )
        for layer in LAYERS
    )
    layers = SnapshotLayers(meshcat, replay.snapshots, counted)
    for step in (1, 2, 1, 2):
        layers.show(step)
    layers.set_opacity("occupancy", 0.25)
    assert sorted(calls) == sorted((n, s) for n in SHOWN for s in (1, 2))
    layers.draw_all()
    layers.draw_all()
    assert sorted(calls) == sorted((n, s) for n in NAMES for s in (1, 2))
    assert seen(meshcat, 2) == SHOWN
    assert not seen(meshcat, 1)


def test_opacity_follows_to_every_step(
    meshcat: Meshcat, replay: Replay
) -> None:
    layers = SnapshotLayers(meshcat, replay.snapshots)

    def opacity(step: int) -> object:
        path = f"/inspect/occupancy/step_{step:02d}/<object>"
        return prop(meshcat, path, "modulated_opacity")

    layers.show(1)
    assert opacity(1) == 0.75
    layers.set_opacity("occupancy", 0.25)
    assert opacity(1) == 0.25
    layers.show(2)
    assert opacity(2) == 0.25
    layers.set_opacity("occupancy", 1.0)
    layers.show(1)
    assert opacity(1) == opacity(2) == 1.0
    assert layers.opacity("occupancy") == 1.0


def test_an_earlier_search_is_deleted(meshcat: Meshcat, replay: Replay) -> None:
    SnapshotLayers(meshcat, replay.snapshots).draw_all()
    assert drawn(meshcat, 2) == set(NAMES)
    SnapshotLayers(meshcat, replay.snapshots[:1])
    assert not drawn(meshcat, 1) | drawn(meshcat, 2)


def test_masks_keep_their_colours(replay: Replay) -> None:
    colors = [
        dict(zip(shot.instances.names, mask_colors(shot).tolist(), strict=True))
        for shot in replay.snapshots
    ]
    both = set(colors[0]) & set(colors[1])
    assert len(both) > 2
    for name in both:
        assert colors[0][name] == colors[1][name]
    assert len({tuple(c) for c in colors[0].values()}) == len(colors[0])
    red, green, blue = colors[0]["box_2to1"]
    assert red > 3 * max(green, blue)


def test_segments_have_colours_too(replay: Replay) -> None:
    shot = replay.snapshots[0]
    labels = shot.instances.labels
    names = tuple(f"segment_{k}" for k in range(len(shot.instances.names)))
    segments = replace(
        shot, instances=InstanceMasks(labels, names), target="segment_2"
    )
    colors = mask_colors(segments)
    assert len(np.unique(colors, axis=0)) == len(names)
    assert colors[2, 0] > 3 * max(colors[2, 1:])


def test_scores_as_heat(replay: Replay) -> None:
    shot = replay.snapshots[0]
    names = shot.instances.names
    ranking = (
        RankedCandidate(names[0], 4.0, False),
        RankedCandidate(names[1], 1.0, False),
    )
    scored = SearchAction(1, ranking=ranking)
    colors = score_colors(replace(shot, action=scored))
    np.testing.assert_allclose(colors[0], heat(np.array(1.0)))
    np.testing.assert_allclose(colors[1], heat(np.array(0.0)))
    assert np.isnan(colors[2:]).all()


def test_the_points_lie_on_what_is_seen(replay: Replay) -> None:
    shot = replay.snapshots[0]
    points = seen_points(shot)
    reading = np.isfinite(shot.depth[::2, ::2])
    assert 0 < len(points.positions) == reading.sum() < reading.size
    depth = shot.camera.project(points.positions)[:, 2]
    np.testing.assert_allclose(depth, shot.depth[::2, ::2][reading], rtol=1e-6)
    np.testing.assert_array_equal(
        points.colors, shot.color[::2, ::2][reading] / 255
    )
    blind = replace(shot, seen_depth=np.zeros_like(shot.depth))
    assert len(seen_points(blind).positions) == 0


def test_a_blank_decision_draws_no_more_than_it_can(
    meshcat: Meshcat, replay: Replay
) -> None:
    shot = replay.snapshots[0]
    blank: Snapshot = replace(
        shot,
        action=SearchAction(1, Grasp()),
        instances=InstanceMasks(np.full(shot.camera.shape, -1), ()),
        occupancy=OccupancyDistribution(np.zeros(shot.camera.shape)),
        target="",
        target_amodal=np.zeros(shot.camera.shape, bool),
        seen_depth=np.zeros(shot.camera.shape),
        grasps={},
    )
    layers = SnapshotLayers(meshcat, [blank])
    layers.show(1)
    layers.draw_all()
    for name in set(NAMES) - {"camera"}:
        path = f"/inspect/{name}/step_01"
        assert not meshcat._GetPackedObject(path), name
