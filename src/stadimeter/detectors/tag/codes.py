"""Families of tags, and reading the code of a tag from its four corners.

OpenCV finds outlines fast but compares each with every member of a family, in version 5 a millisecond for each
outline. Here the code is read at full resolution, however much the picture was reduced for the search, and looked up
among all members in all four directions; only if it is none of them, it is compared with all by a product of matrices.
"""

from __future__ import annotations

import difflib
from functools import cache
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from msgspec import Struct
from pydantic import BeforeValidator

from stadimeter.core.detection import Flags, Plane, Points, Profiles

# Samples along a cell; the outermost are left out, since neighbouring cells blur into them.
SAMPLES = 4

# The order of the corners from each of them on.
FROM = np.array([[(first + i) % 4 for i in range(4)] for first in range(4)])

# Least difference between white and black cells, in levels of 8 bits.
MIN_CONTRAST = 12.0

# The share of the border's cells that may look white: three of 28.
MAX_BORDER_ERRORS = 0.12

# Share of white in the border above which better corners would not help.
MAX_BORDER_DOUBTS = 0.4


class SeenTag(Struct, frozen=True, kw_only=True, eq=False):
    """A tag whose code was read."""

    number: int  # which member of the family it is
    errors: int  # how many of its cells are wrong
    corners_px: Points  # its corners clockwise on the screen, starting with its own top left one, shape ``(4, 2)``

    @property
    def side_px(self) -> float:
        """Its longest side."""
        return float(np.linalg.norm(self.corners_px[[1, 2, 3, 0]] - self.corners_px, axis=1).max())


class Unread(NamedTuple):
    """The reason the content of an outline is no tag of the family."""

    reason: str  # the test that it failed, with the figure and the limit
    white_border: float  # the share of the border's cells that look white; 1 where there is no contrast

    @property
    def may_be_tag(self) -> bool:
        """True if it may still be a tag, if its corners were known better: most of the border is black."""
        return self.white_border < MAX_BORDER_DOUBTS


def read_tag(grey: Plane, corners_px: Points, family: TagFamily, *, inverted: bool = False) -> SeenTag | Unread:
    """Read the code inside an outline, or why it is no tag of the family; `inverted` accepts white on black too.

    What parts black from white is found by Otsu's criterion: the variance between the two classes is the largest (N.
    Otsu, A threshold selection method from gray-level histograms, IEEE Transactions on Systems, Man, and Cybernetics 9,
    1979).
    """
    # Levels of 8 bits, one a cell; a threshold of its own for each outline, as light differs across a picture.
    cells = _cells(grey, corners_px, family.cells)
    white = np.asarray(cv2.threshold(cells, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[1], np.uint8)
    has_both = 0 < cv2.countNonZero(white) < white.size
    contrast = cv2.mean(cells, white)[0] - cv2.mean(cells, 1 - white)[0] if has_both else 0.0
    if contrast < MIN_CONTRAST:
        return Unread(f"white cells are brighter by {contrast:.0f} levels, limit {MIN_CONTRAST:.0f}", 1.0)
    # The outermost ring of cells is the tag's border.
    border = _white_border(white)
    if inverted and border > 0.5:
        white, border = 1 - white, 1 - border
    if border > MAX_BORDER_ERRORS:
        return Unread(f"{border:.0%} of the border is not black, limit {MAX_BORDER_ERRORS:.0%}", border)
    return _closest(white[1:-1, 1:-1], corners_px, family, border)


def _cells(grey: Plane, corners: Points, count: int) -> Plane:
    """Return the brightness of each cell, shape ``(count, count)``."""
    # The map leads from a square of `side` pixels to the picture, as WARP_INVERSE_MAP takes it: each sample of the
    # square is read where it comes from.
    side = count * SAMPLES
    turned = cv2.getPerspectiveTransform(_square(side), corners.astype(np.float32))
    flat = cv2.warpPerspective(
        grey, turned, (side, side), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )
    mean = _inner_means(count)
    return np.asarray(np.rint(mean @ np.asarray(flat, np.float32) @ mean.T), np.uint8)


@cache
def _square(side: int) -> Profiles:
    """Return the corners of a square picture, from the outer edge of its first pixel on."""
    return np.array(((0, 0), (side, 0), (side, side), (0, side)), np.float32) - np.float32(0.5)


@cache
def _inner_means(count: int) -> Profiles:
    """Return the matrix that takes the mean of the inner samples of each cell, shape ``(count, count * SAMPLES)``."""
    inner = np.zeros(SAMPLES, np.float32)
    inner[1:-1] = 1 / (SAMPLES - 2)
    return np.kron(np.eye(count, dtype=np.float32), inner)


def _white_border(white: Plane) -> float:
    """Return the share of the border's cells that are white."""
    cells = len(white)
    inner = white[1:-1, 1:-1]
    return (cv2.countNonZero(white) - cv2.countNonZero(inner)) / (cells * cells - inner.size)


def _closest(inner: Plane, corners: Points, family: TagFamily, border: float) -> SeenTag | Unread:
    """Return the member with the fewest wrong cells, whichever way it is turned."""
    # Mostly no cell is wrong, and the code is a key. Otherwise +1 and -1 make the product of two codes the number of
    # cells that agree less those that differ; so (cells - product) / 2 differ.
    row, errors = family.rows.get(inner.tobytes()), 0
    if row is None:
        agreement = family.codes @ (inner.reshape(-1).astype(np.float32) * 2 - 1)
        row = int(np.argmax(agreement))
        errors = round((inner.size - float(agreement[row])) / 2)
    if errors > family.max_errors:
        return Unread(f"its code differs from every tag in {errors} cells or more, limit {family.max_errors}", border)
    quarter, number = divmod(row, family.members)
    # Turned clockwise by n quarters, its own top left corner is n corners further on.
    return SeenTag(number=number, errors=errors, corners_px=corners[FROM[quarter]])


APRILTAG, ARUCO = "apriltag-", "aruco-"

# The families by the name that people write, each with OpenCV's name for it.
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

# The share of the errors that a family could correct which is accepted, as `cv2.aruco` does: correcting all of them
# takes clutter for a tag.
CORRECTED_SHARE = 0.6


class TagFamily(Struct, frozen=True, kw_only=True, eq=False):
    """A set of square tags that differ in their code."""

    name: str  # such as ``apriltag-36h11``
    cells: int  # how many cells a side of the black square is long, its border of one cell included
    members: int  # how many tags there are; they are numbered from 0
    # The cells inside the border, row by row, of each member: 1 for white, -1 for black. First all members upright,
    # then all turned clockwise by one, two and three quarters, shape ``(4 * members, (cells - 2)²)``.
    codes: Profiles
    rows: dict[bytes, int]  # where in `codes` a code is, by its cells as bytes, 1 for white and 0 for black
    max_errors: int  # how many wrong cells are accepted

    def cells_of(self, number: int) -> Flags:
        """Return which cells inside the border of a member are black, upright, shape ``(cells - 2, cells - 2)``."""
        return np.asarray(self.codes[number] < 0).reshape(self.cells - 2, self.cells - 2)


@cache
def tag_family(name: str) -> TagFamily:
    """Return one of the families in `DICTIONARIES`.

    OpenCV holds the AprilTag families turned by half a turn against the pictures that their authors publish; here they
    are turned back.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[name]))
    size = int(dictionary.markerSize)
    rows = np.asarray(dictionary.bytesList)
    bits = [cv2.aruco.Dictionary.getBitsFromByteList(rows[i : i + 1], size) for i in range(len(rows))]
    upright = np.stack(bits).astype(np.float32) * 2 - 1
    if name.startswith(APRILTAG):
        upright = np.rot90(upright, 2, axes=(1, 2))
    # All four directions of all members: rows count first the members, then the quarters by which they are turned.
    turned = [np.rot90(upright, -quarters, axes=(1, 2)) for quarters in range(4)]
    codes = np.stack(turned).reshape(-1, size * size)
    codes.setflags(write=False)
    return TagFamily(
        name=name,
        cells=size + 2,
        members=len(rows),
        codes=codes,
        rows=_rows(codes),
        max_errors=int(_correctable(codes, len(rows)) * CORRECTED_SHARE),
    )


def _correctable(codes: Profiles, members: int) -> int:
    """Return the most wrong cells that leave no doubt which member it is: less than half of the least two differ by.

    OpenCV says so too, but before version 5 wrongly for AprilTags.
    """
    # The product of two codes of n cells that differ in d is n - 2 d; the largest is that of the two most alike.
    alike = codes @ codes[:members].T
    np.fill_diagonal(alike, -np.inf)
    differ = int(codes.shape[1] - float(alike.max())) // 2
    return max(0, (differ - 1) // 2)


def _rows(codes: Profiles) -> dict[bytes, int]:
    """Return where each code is; of those that look the same, the first."""
    white = (codes > 0).astype(np.uint8)
    return {white[row].tobytes(): row for row in reversed(range(len(white)))}


def parse_family(text: object) -> str:
    """Read one of `DICTIONARIES`; ``36h11`` and ``4x4-50`` are enough where only one family ends so.

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
