"""What the set-up asks about tags."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec.structs import replace

from stadimeter.detectors.setup_kinds import SEVERAL, SetupKind, SetupQuestion, count_of, size_question

# Families that are looked for, those that are least often seen in mere clutter first.
FAMILIES = ("36h11", "5x5-50", "4x4-50", "6x6-50", "25h9", "16h5", "aruco-original")


def _number(text: str) -> int | str:
    return int(text) if text.isdecimal() else text


def _one(text: str) -> Mapping[str, Any]:
    """Return the keys for a family and, behind it, the number of a tag."""
    family, _, number = text.strip().partition(" ")
    return {**({"family": family} if family else {}), **({"id": _number(number.strip())} if number else {})}


def _several(text: str) -> Mapping[str, Any]:
    """Return the keys for a family and, behind it, the numbers of tags; or how many there are, as ``any 4``."""
    family, *numbers = text.replace(",", " ").split()
    if numbers[:1] == ["any"]:
        return {"family": family, **count_of(" ".join(numbers[1:]))}
    return {"family": family, "ids": [_number(number) for number in numbers]}


def tag_kinds() -> tuple[SetupKind, ...]:
    """Return one tag, and several."""
    form = "the side of its black square, such as 8 cm"
    size = size_question(lambda size: {"side": size}, "8 cm", form, thing="the tag")
    tag = SetupQuestion(
        key="tag",
        text="Which family of tags, and which number?",
        keys=_one,
        ready="36h11",
        form="a family such as 36h11 or 4x4-50, and the number unless any will do, such as 36h11 7",
        tries=FAMILIES,
    )
    numbers = SetupQuestion(
        key="tags",
        text="Which family of tags, and which numbers?",
        keys=_several,
        ready="36h11 1 2 3",
        form="a family and the numbers, such as 36h11 3 7 9; or how many there are at most, such as 36h11 any 4",
    )
    each = replace(size, text=size.text.replace("the tag", "each tag"))
    meaning = "a printed AprilTag or ArUco tag (`stadimeter print tag` makes one)"
    return (
        SetupKind(name="tag", meaning=meaning, questions=(size, tag), rank=3, learns_size=True),
        SetupKind(
            name="tags",
            meaning="several tags of one size, each with a distance of its own",
            questions=(each, numbers),
            thing="tag",
            group=SEVERAL,
            rank=31,
        ),
    )
