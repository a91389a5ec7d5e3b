"""The search as a Gymnasium environment, ``XRayDrake/MechanicalSearch-v0``.

Importing this registers it. It needs ``pip install 'xray-drake[gym]'``.
"""

from gymnasium.envs.registration import register, registry

ENV_ID = "XRayDrake/MechanicalSearch-v0"
"""What ``gymnasium.make`` knows it by."""

if ENV_ID not in registry:
    register(
        id=ENV_ID,
        entry_point="xray_drake.gym.environment:MechanicalSearchEnv",
    )
