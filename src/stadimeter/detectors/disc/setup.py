"""What the set-up asks about a disc."""

from __future__ import annotations

from stadimeter.detectors.setup_kinds import SetupKind, size_question


def disc_kinds() -> tuple[SetupKind, ...]:
    """Return the disc."""
    form = "its diameter, such as 12 cm"
    size = size_question(lambda size: {"diameter": size}, "12 cm", form, thing="the disc")
    meaning = "a flat disc of one brightness, such as a lid or a plate"
    return (SetupKind(name="disc", meaning=meaning, questions=(size,), rank=4, learns_size=True),)
