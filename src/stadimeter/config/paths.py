"""Paths in a configuration, which are relative to the folder of the file that they stand in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, ValidationInfo

FOLDER = "folder"
"""The key of the validation context under which the loader names the configuration's folder."""


def validation_context(file: Path) -> dict[str, Any]:
    """Return the context with which options are validated, so that their paths are relative to a file.

    Returns:
        What to give to ``model_validate`` as ``context``.
    """
    return {FOLDER: file.parent}


def path_from(folder: Path, written: str | Path) -> Path:
    """Return the path that stands in a file.

    Args:
        written: What stands there: relative to the folder, absolute, or below a home folder such as ``~``.

    Raises:
        ValueError: It cannot be a path.
    """
    if "\0" in str(written):
        raise ValueError("a path has no null character")
    try:
        return folder / Path(written).expanduser()
    except RuntimeError as error:
        raise ValueError(f"{str(written)!r}: there is no such home folder") from error


def _resolve(value: object, info: ValidationInfo) -> Path:
    if not isinstance(value, str | Path) or not str(value):
        raise ValueError(f"{value!r} is not a path; write it as text, such as 'pictures/desk.png'")
    return path_from((info.context or {}).get(FOLDER, Path()), value)


FilePath = Annotated[Path, BeforeValidator(_resolve)]
"""A path that is relative to the configuration's folder. Without a validation context it stays as it is written."""
