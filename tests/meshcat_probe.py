"""Reads back what a Meshcat was told, as its browser would."""

import base64
import re
from typing import Any

import numpy as np
import umsgpack
from pydrake.geometry import Meshcat

_FLOAT32 = 0x17
"""MessagePack extension of a Float32Array."""


def shown(meshcat: Meshcat, path: str) -> dict:
    """Returns the object at a path."""
    return umsgpack.unpackb(meshcat._GetPackedObject(path))["object"]


def vertices(meshcat: Meshcat, path: str) -> np.ndarray:
    """Returns the (n, 3) points of the geometry at a path."""
    (geometry,) = shown(meshcat, path)["geometries"]
    array = geometry["data"]["attributes"]["position"]["array"]
    assert array.type == _FLOAT32
    return np.frombuffer(array.data, np.float32).reshape(-1, 3)


def pose(meshcat: Meshcat, path: str) -> np.ndarray:
    """Returns the 4×4 pose of a path in its parent."""
    packed = umsgpack.unpackb(meshcat._GetPackedTransform(path))
    return np.array(packed["matrix"]).reshape(4, 4).T


def prop(meshcat: Meshcat, path: str, name: str) -> Any:
    """Returns a property of a path."""
    return umsgpack.unpackb(meshcat._GetPackedProperty(path, name))["value"]


def click(meshcat: Meshcat, name: str) -> None:
    """Does what a browser does when a button is clicked."""
    message = umsgpack.packb({"type": "button", "name": name})
    meshcat._InjectWebsocketMessage(message=message)


def messages(page: str) -> list[dict]:
    """Returns what a static page tells its viewer, but for binary assets."""
    packed = re.findall(r"octet-binary;base64,([A-Za-z0-9+/=]+)", page)
    return [umsgpack.unpackb(base64.b64decode(text)) for text in packed]


def tracks(page: str) -> dict[tuple[str, str], list[tuple[float, Any]]]:
    """Returns times (s) and values of a page's animation.

    By path and property; there is one animation.
    """
    (animation,) = [
        m for m in messages(page) if m.get("type") == "set_animation"
    ]
    return {
        (item["path"], track["name"]): [
            (key["time"] / item["clip"]["fps"], key["value"])
            for key in track["keys"]
        ]
        for item in animation["animations"]
        for track in item["clip"]["tracks"]
    }
