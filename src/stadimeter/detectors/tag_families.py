"""Families of tags: their names, and the codes of their members as black and white cells."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from functools import cache
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

APRILTAG, ARUCO = "apriltag-", "aruco-"

DICTIONARIES = {
    f"{ARUCO}{size}x{size}-{count}": f"DICT_{size}X{size}_{count}"
    for size in (4, 5, 6, 7)
    for count in (50, 100, 250, 1000)
} | {
    f"{ARUCO}original": "DICT_ARUCO_ORIGINAL",
    f"{ARUCO}mip-36h12": "DICT_ARUCO_MIP_36h12",
    f"{APRILTAG}16h5": "DICT_APRILTAG_16h5",
    f"{APRILTAG}25h9": "DICT_APRILTAG_25h9",
    f"{APRILTAG}36h10": "DICT_APRILTAG_36h10",
    f"{APRILTAG}36h11": "DICT_APRILTAG_36h11",
}
"""The families by the name that people write, each with OpenCV's name for it."""

SMALL_TAG_FAMILIES = {f"{APRILTAG}{name}": f"tag{name}" for name in ("16h5", "25h9", "36h11")}
"""The families that the AprilTag library knows as well, each with its name there."""

CORRECTED_SHARE = 0.6
"""The share of the errors that a family could correct which is accepted, as `cv2.aruco` does: correcting all of them
takes clutter for a tag."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TagFamily:
    """A set of square tags that differ in their code.

    Attributes:
        name: Such as ``apriltag-36h11``.
        cells: How many cells a side of the black square is long, its border of one cell included.
        members: How many tags there are; they are numbered from 0.
        codes: The cells inside the border, row by row, of each member: 1 for white, -1 for black. First all members
            upright, then all turned clockwise by one, two and three quarters, shape ``(4 * members, (cells - 2)²)``.
        rows: Where in `codes` a code is, by its cells as bytes, 1 for white and 0 for black.
        most_errors: How many wrong cells are accepted.
    """

    name: str
    cells: int
    members: int
    codes: NDArray[np.float32]
    rows: dict[bytes, int]
    most_errors: int


@cache
def tag_family(name: str) -> TagFamily:
    """Return the family of that name.

    OpenCV holds the AprilTag families turned by half a turn against the pictures that their authors publish; here they
    are turned back.

    Args:
        name: One of `DICTIONARIES`.

    Returns:
        The family.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[name]))
    size = int(dictionary.markerSize)
    rows = np.asarray(dictionary.bytesList)
    bits = [cv2.aruco.Dictionary.getBitsFromByteList(rows[i : i + 1], size) for i in range(len(rows))]
    upright = np.stack(bits).astype(np.float32) * 2 - 1
    if name.startswith(APRILTAG):
        upright = np.rot90(upright, 2, axes=(1, 2))
    turned = [np.rot90(upright, -quarters, axes=(1, 2)) for quarters in range(4)]
    codes = np.stack(turned).reshape(-1, size * size)
    codes.setflags(write=False)
    return TagFamily(
        name=name,
        cells=size + 2,
        members=len(rows),
        codes=codes,
        rows=_rows(codes),
        most_errors=int(_correctable(codes, len(rows)) * CORRECTED_SHARE),
    )


def _correctable(codes: NDArray[np.float32], members: int) -> int:
    """Return how many wrong cells leave no doubt which member it is: less than half of what two differ by at least.

    OpenCV says so too, but before version 5 wrongly for AprilTags.
    """
    alike = codes @ codes[:members].T
    np.fill_diagonal(alike, -np.inf)
    differ = int(codes.shape[1] - float(alike.max())) // 2
    return max(0, (differ - 1) // 2)


def _rows(codes: NDArray[np.float32]) -> dict[bytes, int]:
    """Return where each code is; of those that look the same, the first."""
    white = (codes > 0).astype(np.uint8)
    return {white[row].tobytes(): row for row in reversed(range(len(white)))}


def parse_family(text: object) -> str:
    """Read the name of a family; ``36h11`` and ``4x4-50`` are enough where only one family ends so.

    Args:
        text: What was written.

    Returns:
        One of `DICTIONARIES`.

    Raises:
        ValueError: There is no such family; the message offers the likely one.
    """
    if not isinstance(text, str):
        raise ValueError(f"{text!r} is not a family of tags; write it as text, such as 'apriltag-36h11'")
    wanted = text.strip().lower().replace("_", "-")
    for name in (wanted, APRILTAG + wanted, ARUCO + wanted):
        if name in DICTIONARIES:
            return name
    raise ValueError(_no_family(text, wanted))


def _no_family(text: str, wanted: str) -> str:
    short = {name.removeprefix(APRILTAG).removeprefix(ARUCO): name for name in DICTIONARIES}
    close = difflib.get_close_matches(wanted, [*DICTIONARIES, *short], n=1, cutoff=0.6)
    guess = f"; did you mean {short.get(close[0], close[0])!r}?" if close else "."
    return f"there is no family of tags {text!r}{guess} There are: {', '.join(DICTIONARIES)}"


TagFamilyName = Annotated[str, BeforeValidator(parse_family)]
