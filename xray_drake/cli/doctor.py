"""``xray-drake doctor``: what this machine lacks."""

import ctypes.util
import os
import platform
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import typer

from xray_drake.threads import usable_cores

SYSTEM_LIBRARIES = {
    "EGL": "libegl1",
    "glib-2.0": "libglib2.0-0",
    "SM": "libsm6",
    "X11": "libx11-6",
}
"""Shared libraries to the Debian packages that bring them."""


@dataclass(frozen=True)
class Finding:
    """One thing looked at.

    Attributes:
        what: looked at.
        good: it is as it should be.
        detail: what was found.
        cure: a command that mends it; empty where nothing needs mending.
        required: a search cannot run without it.
    """

    what: str
    good: bool
    detail: str
    cure: str = ""
    required: bool = True


def findings() -> Iterator[Finding]:
    """Looks at one thing after another."""
    yield Finding(
        "Python",
        (3, 11) <= sys.version_info[:2] <= (3, 13),
        platform.python_version(),
        "use Python 3.11, 3.12 or 3.13",
    )
    for package in ("drake", "torch", "trimesh", "opencv-python-headless"):
        yield _package(package)
    missing = [
        package
        for name, package in SYSTEM_LIBRARIES.items()
        if sys.platform == "linux" and ctypes.util.find_library(name) is None
    ]
    yield Finding(
        "system libraries",
        not missing,
        f"missing {', '.join(missing)}" if missing else "found",
        f"apt-get install -y {' '.join(missing)} libgl1-mesa-dri",
    )
    yield _try("models", _models, "reinstall xray-drake")
    yield _try(
        "rendering without a screen",
        _render,
        f"apt-get install -y {' '.join(SYSTEM_LIBRARIES.values())} "
        "libgl1-mesa-dri",
    )
    yield _try(
        "weights",
        _weights,
        "reinstall xray-drake, or give a file with --weights",
    )
    yield _try("caches", _caches, "set TMPDIR to a folder that can be written")
    cores, usable = os.cpu_count() or 1, usable_cores()
    threads = os.environ.get("OMP_NUM_THREADS", "unset")
    yield Finding(
        "threads",
        True,
        f"{usable} of {cores} cores may be used, OMP_NUM_THREADS {threads}",
    )
    yield Finding(
        "graphviz",
        shutil.which("dot") is not None,
        shutil.which("dot") or "missing: no picture of the diagram",
        "apt-get install -y graphviz",
        required=False,
    )


def run() -> int:
    """Prints the findings; returns 1 where a search cannot run, else 0."""
    broken = False
    for finding in findings():
        mark = (
            "ok  " if finding.good else "LACK" if finding.required else "note"
        )
        typer.echo(f"{mark}  {finding.what}: {finding.detail}")
        if not finding.good:
            typer.echo(f"      mend it: {finding.cure}")
            broken |= finding.required
    return int(broken)


def _package(name: str) -> Finding:
    try:
        found = version(name)
    except PackageNotFoundError:
        return Finding(name, False, "not installed", f"pip install {name}")
    return Finding(name, True, found)


def _try(what: str, check: Callable[[], str], cure: str) -> Finding:
    try:
        return Finding(what, True, check())
    except Exception as error:
        return Finding(what, False, " ".join(str(error).split()), cure)


def _models() -> str:
    from xray_drake.resources import models_dir

    return str(models_dir())


def _weights() -> str:
    from xray_drake.occupancy.learned.inference import default_weights
    from xray_drake.occupancy.learned.weights import read_card

    path = default_weights()
    return f"{path}: {read_card(path).architecture}"


def _caches() -> str:
    from xray_drake.caches import cache_folder
    from xray_drake.kernels import cache_path

    compiled = cache_path() or "memory alone"
    return f"meshes in {cache_folder()}, compiled functions in {compiled}"


def _render() -> str:
    import time

    from pydrake.systems.framework import DiagramBuilder

    from xray_drake.cell.bin import Bin
    from xray_drake.cell.cameras import nominal_camera
    from xray_drake.scene.cameras import add_camera
    from xray_drake.scene.plant import add_bin, add_plant, default_plant_config

    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, default_plant_config())
    add_bin(plant, Bin())
    plant.Finalize()
    sensor, _ = add_camera(builder, scene_graph, nominal_camera())
    diagram = builder.Build()
    context = sensor.GetMyContextFromRoot(diagram.CreateDefaultContext())
    port = sensor.depth_image_32F_output_port()
    start = time.perf_counter()
    depth = port.Eval(context).data[192, 256, 0]
    seconds = time.perf_counter() - start
    if abs(depth - 0.8) > 0.001:
        raise RuntimeError(
            f"the bin's floor was rendered at {depth} m, not 0.8"
        )
    return f"a first depth image took {seconds:.2f} s"
