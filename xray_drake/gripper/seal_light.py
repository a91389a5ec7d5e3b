"""Shows in Meshcat whether the suction cup draws air and has sealed."""

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus

from xray_drake.gripper.suction import CupState
from xray_drake.lifetimes import CollectableLeafSystem

_COLORS = {"drawing": Rgba(0.95, 0.75, 0.1), "sealed": Rgba(0.1, 0.75, 0.25)}
_WIDER, _HEIGHT = 0.0005, 0.0035
"""m: a sleeve around the cup's lip."""


class SealLight(CollectableLeafSystem):
    """Colours the suction cup's lip: yellow draws air, green has sealed.

    .. pydrake_system::

        name: SealLight
        input_ports:
        - cup_state

    It changes what Meshcat shows, in recordings too, when ``cup_state``
    (:class:`~xray_drake.gripper.suction.CupState`) does.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        X_BC: np.ndarray,
        *,
        path: str,
        radius: float,
        sealed: float = 0.9,
        period: float = 1 / 32,
    ) -> None:
        """Builds the light.

        Args:
            meshcat: shows the gripper.
            X_BC: 4×4 pose of the cup's lip in the gripper's base, m; z points
                out of it.
            path: where Meshcat shows that base.
            radius: of the lip, m.
            sealed: share of the full vacuum from which it counts as sealed.
            period: how often it looks, s.
        """
        super().__init__()
        self.set_name("seal_light")
        self._meshcat = meshcat
        self._X_BC = RigidTransform(X_BC)
        self._path = path
        self._radius = radius + _WIDER
        self._sealed = sealed
        self._shown: str | None = None
        self._cup = self.declare_input("cup_state", CupState())
        # Drake's visualizer deletes all that it has drawn when a simulation is
        # initialized, and the sleeves with it.
        self.DeclareInitializationPublishEvent(self._forget)
        self.DeclarePeriodicPublishEvent(period, 0.0, self._publish)

    def _forget(self, context: Context) -> EventStatus:
        self._shown = None
        return EventStatus.Succeeded()

    def _draw(self) -> None:
        X_CS = RigidTransform([0.0, 0.0, -_HEIGHT / 2])
        for name, color in _COLORS.items():
            path = f"{self._path}/{name}"
            sleeve = Cylinder(self._radius, _HEIGHT)
            self._meshcat.SetObject(path, sleeve, color)
            self._meshcat.SetTransform(path, self._X_BC @ X_CS)
            self._meshcat.SetProperty(path, "visible", False)

    def _publish(self, context: Context) -> EventStatus:
        state: CupState = self._cup.Eval(context)
        shown = ""
        if state.drawing:
            shown = "sealed" if state.vacuum >= self._sealed else "drawing"
        if shown == self._shown:
            return EventStatus.DidNothing()
        if self._shown is None:
            self._draw()
        for name in _COLORS:
            self._meshcat.SetProperty(
                f"{self._path}/{name}",
                "visible",
                name == shown,
                time_in_recording=context.get_time(),
            )
        self._shown = shown
        return EventStatus.Succeeded()
