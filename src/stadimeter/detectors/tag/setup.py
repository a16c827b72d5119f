"""What the set-up asks about tags."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stadimeter.detectors.setup_kinds import SEVERAL, SetupKind, SetupQuestion, count_of, size_question

# Families that are looked for, those that are least often seen in mere clutter first.
FAMILIES = ("36h11", "5x5-50", "4x4-50", "6x6-50", "25h9", "16h5", "aruco-original")

_ONE = "a family such as 36h11 or 4x4-50, and the number unless any will do, such as 36h11 7"
_SEVERAL = "a family and the numbers, such as 36h11 3 7 9; or how many there are at most, such as 36h11 any 4"


def _numbers(texts: list[str]) -> list[int | str]:
    return [int(text) if text.isdecimal() else text for text in texts]


def _one(text: str) -> Mapping[str, Any]:
    """Return the keys for a family and, behind it, the number of a tag."""
    family, _, number = text.strip().partition(" ")
    return {**({"family": family} if family else {}), **({"id": _numbers([number.strip()])[0]} if number else {})}


def _several(text: str) -> Mapping[str, Any]:
    """Return the keys for a family and, behind it, the numbers of tags; or how many there are, as ``any 4``."""
    family, *numbers = text.replace(",", " ").split()
    which = count_of(" ".join(numbers[1:])) if numbers[:1] == ["any"] else {"ids": _numbers(numbers)}
    return {"family": family, **which}


def tag_kinds() -> tuple[SetupKind, ...]:
    """Return one tag, and several."""
    size = size_question("tag", lambda size: {"side": size}, "8 cm", "the side of its black square, such as 8 cm")
    tag = SetupQuestion("tag", "Which family of tags, and which number?", _one, "36h11", _ONE, tries=FAMILIES)
    tags = SetupQuestion("tags", "Which family of tags, and which numbers?", _several, "36h11 1 2 3", _SEVERAL)
    one = "a printed AprilTag or ArUco tag (`stadimeter print tag` makes one)"
    several = "several tags of one size, each with a distance of its own"
    return (
        SetupKind("tag", one, (size, tag), rank=3, learns_size=True),
        SetupKind("tags", several, (size, tags), thing="tag", group=SEVERAL, rank=31),
    )
