import numpy as np
import pytest
from pydrake.geometry import Meshcat

from tests.meshcat_probe import messages, pose, prop, tracks
from xray_drake.drawing.meshcat_layers import set_opacity
from xray_drake.inspector.layers import LAYERS
from xray_drake.inspector.replay import Replay
from xray_drake.inspector.view import STEP_TIME, ReplayView, look_at_heap


def position(meshcat: Meshcat, name: str) -> np.ndarray:
    return pose(meshcat, f"/drake/visualizer/{name}/{name}")[:3, 3]


def test_steps_put_the_objects_where_they_were(
    meshcat: Meshcat, replay: Replay
) -> None:
    look_at_heap(meshcat)
    view = ReplayView(replay, meshcat)
    assert (view.step, view.num_steps) == (1, 3)
    for step in (1, 2, 1):
        view.show(step)
        assert view.step == step
        for name, X_WO in replay.snapshots[step - 1].poses.items():
            np.testing.assert_allclose(position(meshcat, name), X_WO[:3, 3])
        for other in (1, 2):
            path = f"/inspect/caption/step_{other:02d}"
            if meshcat.HasPath(path):
                assert prop(meshcat, path, "visible") is (other == step)
    view.show(3)
    after = replay.snapshots[-1].poses_after
    assert after is not None
    for name, X_WO in after.items():
        np.testing.assert_allclose(position(meshcat, name), X_WO[:3, 3])
    for wrong in (0, 4):
        with pytest.raises(ValueError, match=f"no step {wrong}.*has 3"):
            view.show(wrong)


def test_x_ray(meshcat: Meshcat, looked_at: Replay) -> None:
    view = ReplayView(looked_at, meshcat)
    with pytest.raises(ValueError, match=r"'cup'.*ForcedPublish"):
        set_opacity(meshcat, "cup", 0.25)

    def opacities() -> set[float]:
        return {
            prop(meshcat, path.format(name), "modulated_opacity")
            for name in ("book", "pad", "block", "plank")
        }

    path = "visualizer/{0}/{0}/{0}/visual"
    view.set_heap_opacity(0.25)
    assert opacities() == {0.25}
    target = path.format("box_2to1")
    assert prop(meshcat, target, "modulated_opacity") == 1.0
    view.show(1)
    assert opacities() == {0.25}
    # The gripper is not in the way.
    assert prop(meshcat, "visualizer/drawn", "visible") is False


def test_what_is_said_of_a_step(
    meshcat: Meshcat, replay: Replay, looked_at: Replay
) -> None:
    view = ReplayView(replay, meshcat)
    title, what, seen = view.describe(1)
    assert title == "seed 7: box_2to1 under 4 objects"
    assert what.startswith("step 1 of 2, largest: book by ")
    assert what.endswith(": lifted")
    support = replay.record.actions[0].support_before
    assert seen.endswith(f"% visible, support {support} pixels")
    end = replay.record.end.replace("_", " ")
    assert view.describe(3) == (title, f"end: {end} after 2 actions")
    # Before it is executed, nobody knows what becomes of it.
    view = ReplayView(looked_at, meshcat)
    assert view.num_steps == 1
    assert view.describe(1)[1].startswith("step 1, largest: book by ")
    assert "lifted" not in view.describe(1)[1]


def test_a_static_page_goes_through_the_steps(
    meshcat: Meshcat, replay: Replay
) -> None:
    view = ReplayView(replay, meshcat)
    view.show(2)
    view.record()
    assert view.step == 2
    page = messages(meshcat.StaticHtml())
    objects = {m["path"] for m in page if m.get("type") == "set_object"}
    for layer in LAYERS:
        for step in (1, 2):
            path = f"/inspect/{layer.name}/step_{step:02d}"
            assert any(o == path or o.startswith(f"{path}/") for o in objects)
    keys = tracks(meshcat.StaticHtml())

    def visible(path: str, time: float) -> bool:
        *_, (_, value) = [k for k in keys[path, ".visible"] if k[0] <= time]
        return value

    for layer in LAYERS:
        paths = [f"/inspect/{layer.name}/step_{k:02d}" for k in (1, 2)]
        for time, shown in (
            (0.0, [True, False]),
            (0.9 * STEP_TIME, [False, False]),
            (STEP_TIME, [False, True]),
            (1.9 * STEP_TIME, [False, False]),
            (2 * STEP_TIME, [False, False]),
        ):
            assert [visible(path, time) for path in paths] == shown
    captions = [f"/inspect/caption/step_{k:02d}" for k in (1, 2, 3)]
    for step in (1, 2, 3):
        for share in (0.0, 0.7):
            time = STEP_TIME * (step - 1 + share)
            shown = [visible(path, time) for path in captions]
            assert shown == [k == step for k in (1, 2, 3)]
    book = keys["/drake/visualizer/book/book", ".position"]
    assert [key[0] for key in book[:2]] == [0.0, pytest.approx(2.4, abs=0.02)]
    assert book[0][1] == book[1][1] != book[2][1]
    # All tracks end together: what ended before could be left as it was.
    ends = {k[-1][0] for (path, name), k in keys.items() if name == ".visible"}
    assert len(ends) == 1


def test_a_heap_alone_has_nothing_to_be_recorded(
    meshcat: Meshcat, looked_at: Replay
) -> None:
    view = ReplayView(looked_at, meshcat)
    view.record()
    page = messages(meshcat.StaticHtml())
    assert not [m for m in page if m.get("type") == "set_animation"]
    objects = {m["path"] for m in page if m.get("type") == "set_object"}
    assert "/inspect/points/step_01" in objects
