from pathlib import Path
from xml.etree import ElementTree

import pytest

import xray_drake
from xray_drake import resources

find = resources.models_dir.__wrapped__  # past the cache


def install(root: Path, *, beside: bool, within: bool) -> Path:
    """Makes an empty package at ``root`` and returns its module's path."""
    package = root / "xray_drake"
    package.mkdir()
    for wanted, folder in ((beside, root), (within, package)):
        if wanted:
            (folder / "models").mkdir()
            (folder / "models" / "package.xml").touch()
    return package / "resources.py"


def test_the_models_of_this_package() -> None:
    manifest = ElementTree.parse(resources.models_dir() / "package.xml")
    assert manifest.findtext("name") == resources.PACKAGE_NAME
    assert resources.models_dir() is resources.models_dir()


@pytest.mark.parametrize(
    ("beside", "within", "expected"),
    [
        (True, False, "models"),  # a checkout
        (False, True, "xray_drake/models"),  # a wheel
        (True, True, "xray_drake/models"),  # models of somebody else beside it
    ],
)
def test_in_a_checkout_and_in_a_wheel(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    beside: bool,
    within: bool,
    expected: str,
) -> None:
    module = install(tmp_path, beside=beside, within=within)
    monkeypatch.setattr(resources, "__file__", str(module))
    assert find() == tmp_path.resolve() / expected


def test_a_folder_of_that_name_without_a_manifest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = install(tmp_path, beside=False, within=False)
    (tmp_path / "models").mkdir()
    monkeypatch.setattr(resources, "__file__", str(module))
    with pytest.raises(FileNotFoundError, match=r"package\.xml") as caught:
        find()
    message = str(caught.value)
    assert str(tmp_path.resolve()) in message
    assert "\n" not in message


def test_the_package_says_its_version() -> None:
    assert xray_drake.__version__[0].isdigit()
