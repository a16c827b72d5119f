"""What the set-up asks about a sheet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec.structs import replace

from stadimeter.config.named_sizes import PAPER
from stadimeter.config.units import split_quantities
from stadimeter.detectors.setup_kinds import SetupKind, size_question


def _sides(size: str) -> Mapping[str, Any]:
    width, *height = split_quantities(size.replace(" x ", ", "))
    return {"width": width, "height": ", ".join(height)} if height else {"size": size}


def sheet_kinds() -> tuple[SetupKind, ...]:
    """Return the sheet."""
    names = tuple(PAPER)
    form = f"width and height, such as 11 in, 8.5 in, or a name: {', '.join(names)}; cut by hand or not flat: A4 ± 3 mm"
    size = replace(size_question("sheet", _sides, "A4", form, names), sides=2)
    return (SetupKind("sheet", "a sheet of paper or a card, lying flat", (size,), rank=2),)
