"""What the set-up asks about a disc."""

from __future__ import annotations

from stadimeter.detectors.setup_kinds import SetupKind, size_question


def disc_kinds() -> tuple[SetupKind, ...]:
    """Return the disc."""
    size = size_question("disc", lambda size: {"diameter": size}, "12 cm", "its diameter, such as 12 cm")
    meaning = "a flat disc of one brightness, such as a lid or a plate"
    return (SetupKind("disc", meaning, (size,), rank=4, learns_size=True),)
