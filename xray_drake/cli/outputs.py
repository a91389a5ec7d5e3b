"""Places of results, looked at before the work for them is done."""

from pathlib import Path

PICTURES = (".png", ".pdf", ".svg")


def check_picture(path: Path | None) -> None:
    """Checks that a picture can have this name.

    Args:
        path: of the file; None for none.

    Raises:
        ValueError: no format is called so.
    """
    if path is not None and path.suffix.lower() not in PICTURES:
        raise ValueError(
            f"no picture can be written to {path}: its name should end in "
            ".png, .pdf or .svg"
        )


def check_output(path: Path | None) -> None:
    """Checks that a file can be written.

    Args:
        path: of the file; None for none.

    Raises:
        ValueError: it is a folder, or in none.
    """
    if path is not None and path.is_dir():
        raise ValueError(
            f"cannot write {path}: it is a folder; name a file in it"
        )
    if path is not None and not path.absolute().parent.is_dir():
        raise ValueError(
            f"cannot write {path}: the folder "
            f"{path.absolute().parent} does not exist"
        )
