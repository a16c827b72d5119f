"""Writing drawings to files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stadimeter.config.atomic_file import write_atomically
from stadimeter.core.drawing import Drawing
from stadimeter.errors import ConfigError, reason_of
from stadimeter.workbench.drawing.pdf import pdf_of
from stadimeter.workbench.drawing.svg import svg_of


def write_drawings(path: Path, pages: Sequence[Drawing]) -> None:
    """Write drawings to one file, whose ending says the kind: ``.pdf``, or ``.svg`` for a single one.

    Raises:
        ConfigError: The ending is another, there are too many drawings for it, or the file cannot be written.
    """
    kind = path.suffix.lower()
    if kind not in {".pdf", ".svg"}:
        raise ConfigError(f"{path}: drawings are written as .pdf or .svg; give the file one of these endings")
    if kind == ".svg" and len(pages) != 1:
        raise ConfigError(f"{path}: an SVG picture holds one page and there are {len(pages)}; write a .pdf file")
    data = pdf_of(pages) if kind == ".pdf" else svg_of(pages[0]).encode()
    try:
        write_atomically(path, data)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {reason_of(error)}") from error
