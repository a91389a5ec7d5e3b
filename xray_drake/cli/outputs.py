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


def check_outputs(*paths: Path | None, picture: Path | None = None) -> None:
    """Checks that files can be written.

    Args:
        *paths: of the files; None for none.
        picture: of one more, that is a picture.

    Raises:
        ValueError: one is a folder, or in none, or see :func:`check_picture`.
    """
    check_picture(picture)
    for path in (*paths, picture):
        if path is None:
            continue
        if path.is_dir():
            raise ValueError(
                f"cannot write {path}: it is a folder; name a file in it"
            )
        folder = path.absolute().parent
        if not folder.is_dir():
            raise ValueError(
                f"cannot write {path}: the folder {folder} does not exist"
            )
