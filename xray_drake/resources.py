"""Finds the models that travel with the package."""

from functools import cache
from pathlib import Path

PACKAGE_NAME = "xray_drake_models"
"""The name in ``models/package.xml``: ``package://xray_drake_models/...``."""


@cache
def models_dir() -> Path:
    """Returns the folder of models, in a wheel or in a checkout.

    Raises:
        FileNotFoundError: neither place holds ``package.xml``.
    """
    here = Path(__file__).resolve().parent
    for candidate in (here / "models", here.parent / "models"):
        if (candidate / "package.xml").is_file():
            return candidate
    raise FileNotFoundError(
        f"no models/package.xml in {here} or {here.parent}: reinstall "
        "xray-drake, or run it from a complete checkout"
    )
