"""What numbers and names may be in Drake's own configurations."""

from pydrake.systems.analysis import GetIntegrationSchemes

from xray_drake.configuration import Rules
from xray_drake.ranges import Choice, Interval, Numbers

_METRES = Interval(-100, 100)
_ROOM = Numbers(_METRES, (3,))
_DEGREES = Interval(-360, 360)
_FOCAL = Interval.of("(0, 100000]")
_ANGLE = Interval.of("(0, 180)")
_DEPTH = Interval.of("(0, 1000]")
_SIDE = Interval.of("[1, 8192]", whole=True)
_CENTER = Interval(-10000, 20000)
_SECONDS = Interval.of("[0, 3600]")

CONTACT_MODELS = ("point", "hydroelastic", "hydroelastic_with_fallback")
CONTACT_APPROXIMATIONS = ("tamsi", "lagged", "similar", "sap")
"""The first of each is not for execution by contact."""

DRAKE_RULES: Rules = {
    "CameraConfig": {
        "width": _SIDE,
        "height": _SIDE,
        "center_x": _CENTER,
        "center_y": _CENTER,
        "clipping_near": _DEPTH,
        "clipping_far": _DEPTH,
        "z_near": _DEPTH,
        "z_far": _DEPTH,
        "fps": Interval.of("(0, 10000]"),
        "capture_offset": _SECONDS,
        "output_delay": _SECONDS,
    },
    "CameraConfig.FocalLength": {"x": _FOCAL, "y": _FOCAL},
    "CameraConfig.FovDegrees": {"x": _ANGLE, "y": _ANGLE},
    "Transform": {"translation": _ROOM},
    "Rotation.Rpy": {"deg": Numbers(_DEGREES, (3,))},
    "Rotation.AngleAxis": {
        "angle_deg": _DEGREES,
        "axis": Numbers(Interval(-1000, 1000), (3,)),
    },
    "Rgba": {"rgba": Numbers(Interval(0, 1), (3, 4))},
    "MultibodyPlantConfig": {
        "time_step": Interval.of("(0, 0.1]"),
        "penetration_allowance": Interval.of("(0, 0.1]"),
        "stiction_tolerance": Interval.of("(0, 1]"),
        "sap_near_rigid_threshold": Interval.of("[0, 1000]"),
        "contact_model": Choice(CONTACT_MODELS),
        "discrete_contact_approximation": Choice(CONTACT_APPROXIMATIONS),
        "contact_surface_representation": Choice(("triangle", "polygon")),
    },
    "SimulatorConfig": {
        "integration_scheme": Choice(tuple(GetIntegrationSchemes())),
        "max_step_size": Interval.of("(0, 10]"),
        "accuracy": Interval.of("(0, 1]"),
        "start_time": Interval.of("[0, 1000000]"),
        "target_realtime_rate": Interval.of("[0, 1000]"),
    },
    "VisualizationConfig": {
        "publish_period": Interval.of("(0, 60]"),
        "initial_proximity_alpha": Interval.of("[0, 1]"),
        "mouse_interaction_stiffness": Interval.of("(0, 1000000]"),
    },
}
"""By class and field. A number that is not here must be finite."""
