from pathlib import Path
from xml.etree import ElementTree

import pytest

from xray_drake import resources

find = resources.models_dir.__wrapped__  # past the cache


def test_the_models_of_this_package() -> None:
    manifest = ElementTree.parse(resources.models_dir() / "package.xml")
    assert manifest.findtext("name") == resources.PACKAGE_NAME
    assert resources.models_dir() is resources.models_dir()


@pytest.mark.parametrize(
    ("folders", "found"),
    [
        pytest.param(["models"], "models", id="a checkout"),
        pytest.param(["xray_drake/models"], "xray_drake/models", id="a wheel"),
        pytest.param(
            ["models", "xray_drake/models"],
            "xray_drake/models",
            id="models of somebody else beside it",
        ),
        pytest.param([], "", id="without a manifest"),
    ],
)
def test_models_are_found_in_a_checkout_and_in_a_wheel(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    folders: list[str],
    found: str,
) -> None:
    (tmp_path / "models").mkdir()
    for folder in folders:
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / "package.xml").touch()
    module = tmp_path / "xray_drake" / "resources.py"
    monkeypatch.setattr(resources, "__file__", str(module))
    root = tmp_path.resolve()
    if found:
        assert find() == root / found
        return
    with pytest.raises(FileNotFoundError, match=r"package\.xml") as caught:
        find()
    assert str(root) in str(caught.value)
    assert "\n" not in str(caught.value)
