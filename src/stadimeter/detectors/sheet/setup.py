"""What the set-up asks about a sheet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stadimeter.config.named_sizes import PAPER
from stadimeter.config.units import split_quantities
from stadimeter.detectors.setup_kinds import SetupKind, size_question


def _sides(size: str) -> Mapping[str, Any]:
    width, *height = split_quantities(size.replace(" x ", ", "))
    return {"width": width, "height": ", ".join(height)} if height else {"size": size}


def sheet_kinds() -> tuple[SetupKind, ...]:
    """Return the sheet."""
    names = ", ".join(PAPER)
    form = f"width and height, such as 11 in, 8.5 in, or a name: {names}; cut by hand or not flat: A4 ± 3 mm"
    size = size_question(_sides, "A4", form, thing="the sheet", names=tuple(PAPER))
    return (SetupKind(name="sheet", meaning="a sheet of paper or a card, lying flat", questions=(size,), rank=2),)
