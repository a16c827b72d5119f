"""What stands on a terminal as a picture, for the documentation."""

from __future__ import annotations

import io
from pathlib import Path

from rich.console import Console, RenderableType
from rich.terminal_theme import TerminalTheme

THEME = TerminalTheme(
    (16, 20, 28),
    (214, 220, 230),
    [(16, 20, 28), (240, 96, 96), (94, 200, 120), (235, 190, 80), (84, 130, 230), (200, 130, 230), (90, 200, 220),
     (214, 220, 230)],
    [(110, 120, 135), (255, 130, 130), (130, 230, 150), (255, 215, 110), (120, 165, 255), (225, 165, 255),
     (110, 235, 255), (255, 255, 255)],
)  # fmt: skip
"""Colours that are told apart on a dark ground, by most people who do not tell red from green too."""


def save_svg(
    shown: RenderableType, path: Path, width: int = 120, height: int = 35, *, title: str = "stadimeter"
) -> None:
    """Write what a terminal shows as an SVG picture.

    Args:
        shown: What stands there.
        path: The file to write.
        width: Columns of the terminal in the picture.
        height: Its rows.
        title: What stands in the window's title bar.

    Raises:
        OSError: The file cannot be written.
    """
    console = Console(
        record=True, width=width, height=height, file=io.StringIO(), force_terminal=True, color_system="truecolor",
        no_color=False, legacy_windows=False, _environ={},
    )  # fmt: skip
    console.print(shown, end="")
    path.write_text(console.export_svg(title=title, theme=THEME, unique_id="stadimeter"), encoding="utf-8")
