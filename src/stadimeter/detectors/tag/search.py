"""Search for tags in a picture, each look harder than the last.

A reduced picture first, larger ones only if the tag is not there. Around a prediction only a part of the picture is
looked at, reduced until the tag is about `TRACKED_PX` long, so that the cost depends neither on the picture's size nor
on the tag's. Outlines of four corners are found by `cv2.aruco`, and small tags by the AprilTag library.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points, Prediction, RejectedCandidate
from stadimeter.core.frame import Image
from stadimeter.detectors.region import Region
from stadimeter.detectors.sampling import Light, grey_of
from stadimeter.detectors.sides import side_lengths
from stadimeter.detectors.tag.codes import SMALL_TAG_FAMILIES, SeenTag, TagFamily, Unread, read_tag
from stadimeter.detectors.tag.outlines import MIN_PICTURE_PX, TagOutlines, find_outlines
from stadimeter.detectors.tag.sides import measure_sides

Plane = NDArray[np.uint8]

# Least difference of the cells from the threshold between black and white, in levels: noise reaches about 10.
MIN_MARGIN = 20.0

# The first look is at the picture halved until its long side is no longer than this.
FIRST_LONG_SIDE_PX = 480

# A picture is never reduced less than what makes the smallest wanted tag this long.
MIN_FOUND_PX = 16.0

# Larger pictures are never searched in full: at half the size 50 megapixels are 12, as many as a still picture of a
# Pi's camera has. Tags that are found are measured in full all the same.
MAX_SEARCHED_PIXELS = 16_000_000

# Tags with a shorter side are not looked for in a reduced picture: their cells run into each other.
MIN_READ_PX = 10.0

# Share of its perimeter that a tag keeps when it is turned by 70 degrees; turned further it cannot be read.
TURNED_SHARE = 0.65

# Length of a tag's side in the reduced picture that is searched around a prediction.
TRACKED_PX = 40.0

# Around a prediction the picture is cut out so that a tag standing on its corner fits in, with some of its paper.
HALF_DIAGONAL, MARGIN_PX = math.sqrt(0.5), 8

# Greatest error of a prediction, in its standard deviations.
SIGMAS = 3.0

# Corners of an outline are good to a pixel or two. Where cells are smaller than this, the sides are measured before the
# code is given up.
SMALL_CELL_PX = 5.0


class ApriltagFinder:
    """Finds small AprilTags, of 16 to 24 pixels, with their authors' own library.

    It takes several times as long as `find_outlines`, and raises an `ImportError` without the extra ``tags``.
    """

    def __init__(self, family: str) -> None:
        import pyapriltags  # noqa: PLC0415 - an optional library

        self._detector = pyapriltags.Detector(families=SMALL_TAG_FAMILIES[family], nthreads=1, quad_decimate=1.0)

    def find(self, grey: Plane) -> list[SeenTag]:
        """Return the tags of the family in a picture."""
        if min(grey.shape) < MIN_PICTURE_PX:
            return []
        return [
            SeenTag(number=int(tag.tag_id), errors=int(tag.hamming), corners_px=_clockwise(tag.corners))
            for tag in self._detector.detect(grey)
            if tag.decision_margin >= MIN_MARGIN
        ]


def _clockwise(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return corners that come anticlockwise from the bottom left clockwise from the top left.

    The library has (0, 0) at the corner of the first pixel instead of at its centre.
    """
    return np.asarray(corners[::-1] - 0.5, np.float64)


def candidate(corners_px: Points, reason: str) -> RejectedCandidate:
    """Return an outline of four corners, shape ``(4, 2)``, as a candidate that was rejected."""
    x, y = corners_px.mean(axis=0).tolist()
    corners = tuple((float(x_px), float(y_px)) for x_px, y_px in corners_px)
    size_px = max(side_lengths(corners_px))
    return RejectedCandidate(centre_px=(x, y), size_px=size_px, reason=reason, corners_px=corners)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LookResult:
    """Tags and outlines seen in one look at a picture or a part of it."""

    grey: Plane  # what was looked at, shape ``(height, width)``
    left_top_px: Points  # where its first pixel is in the picture
    tags: tuple[SeenTag, ...]  # the tags of the family, the largest first, with their corners in `grey`
    outlines: int  # how many outlines of four corners there were
    left_out_px: float = 0.0  # tags with a shorter side were left out
    is_crowded: bool = False  # whether they were since there are too many outlines
    # Outlines that show no tag of the family, shape ``(4, 2)`` in `grey` each, and why.
    unread: Sequence[tuple[Points, Unread]] = ()

    def rejected(self, most: int) -> list[RejectedCandidate]:
        """Return outlines that show no tag, the most like one first, the larger first where they are alike."""
        likely = sorted(self.unread, key=lambda found: found[1].white_border)[:most]
        return [candidate(corners + self.left_top_px, unread.reason) for corners, unread in likely]


@dataclass(frozen=True, slots=True, kw_only=True)
class TagSearch:
    """Looks for the tags of a family."""

    family: TagFamily
    light: Light
    min_side_px: float  # tags whose longest side is smaller than this are not looked for
    inverted: bool = False
    small_tags: ApriltagFinder | None = None  # finds what is too small for the rest; None to do without

    def around(self, image: Image, prediction: Prediction) -> LookResult | None:
        """Look where a tag is expected, for whole ones only; None if the place is not in the picture."""
        # All lengths are in pixels of the full picture, and taken at their worst within SIGMAS standard deviations.
        longest_px = prediction.size_px + SIGMAS * prediction.sigma_px
        min_px = max((prediction.size_px - SIGMAS * prediction.sigma_px) / 2, self.min_side_px)
        half_px = HALF_DIAGONAL * prediction.size_px + SIGMAS * prediction.sigma_px + MARGIN_PX
        region = Region.around(prediction.centre_px, half_px, image, outwards=True)
        if region is None:
            return None
        left_top, grey = region.left_top_px, grey_of(region.of(image))
        reduced_px = max(1, round(max(grey.shape) * min(1.0, TRACKED_PX / longest_px)))
        seen = self._whole(grey, left_top, min_px, reduced_px)
        # A tag that is turned far is much narrower than it is long.
        return seen if seen.tags else self._whole(grey, left_top, min_px, max(grey.shape))

    def _whole(self, grey: Plane, left_top: Points, min_px: float, long_side_px: int) -> LookResult:
        outlines = find_outlines(grey, 4 * TURNED_SHARE * min_px, long_side_px, thorough=False)
        # An outline that reaches the edge of the part may go on beyond it.
        height, width = grey.shape
        last = (width - 1 - MARGIN_PX / 2, height - 1 - MARGIN_PX / 2)
        corners = outlines.corners_px
        whole = corners[((corners > MARGIN_PX / 2) & (corners < last)).reshape(-1, 8).all(axis=1)]
        return self._read_all(grey, left_top, outlines._replace(corners_px=whole), len(corners))

    def everywhere(self, image: Image) -> Iterator[LookResult]:
        """Yield what the whole picture shows, each time looking harder and longer: the caller may stop early."""
        grey = grey_of(image)
        yield from self.quickly(grey)
        yield self._look(grey, self._long_sides(grey)[-1], thorough=True)
        if self.small_tags is not None:
            tags = sorted(self.small_tags.find(grey), key=lambda tag: tag.side_px, reverse=True)
            yield LookResult(grey=grey, left_top_px=np.zeros(2), tags=tuple(tags), outlines=len(tags))

    def quickly(self, grey: Plane) -> Iterator[LookResult]:
        """Yield what the whole picture shows at each scale, the smallest first; enough for tags that are well seen."""
        for long_side_px in self._long_sides(grey):
            yield self._look(grey, long_side_px, thorough=False)

    def _long_sides(self, grey: Plane) -> list[int]:
        """Return the long sides, in pixels, at which the picture is searched: each time twice as large."""
        # How many times the picture is halved for the first look, and for the last one.
        full_px = max(grey.shape)
        coarsest = max(0, math.ceil(math.log2(full_px / FIRST_LONG_SIDE_PX)))
        by_tag = math.floor(math.log2(self.min_side_px / MIN_FOUND_PX))
        by_memory = math.ceil(math.log2(grey.size / MAX_SEARCHED_PIXELS) / 2)
        finest = max(0, by_tag, by_memory)
        return [max(1, full_px >> halvings) for halvings in range(max(coarsest, finest), finest - 1, -1)]

    def _look(self, grey: Plane, long_side_px: int, *, thorough: bool) -> LookResult:
        scale = long_side_px / max(grey.shape)
        min_px = max(self.min_side_px, MIN_READ_PX / scale)
        outlines = find_outlines(grey, 4 * TURNED_SHARE * min_px, long_side_px, thorough=thorough)
        seen = self._read_all(grey, np.zeros(2), outlines, len(outlines.corners_px))
        crowded_px = outlines.left_out_px / 4
        return replace(seen, left_out_px=max(min_px, crowded_px), is_crowded=crowded_px > min_px)

    def _read_all(self, grey: Plane, left_top: Points, outlines: TagOutlines, count: int) -> LookResult:
        """Read the code in outlines; each tag of the picture counts once."""
        tags: list[SeenTag] = []
        unread: list[tuple[Points, Unread]] = []
        for corners in outlines.corners_px:
            tag = self._read(grey, corners)
            if isinstance(tag, Unread):
                unread.append((corners, tag))
            elif not any(_same(tag, other) for other in tags):
                tags.append(tag)
        return LookResult(
            grey=grey,
            left_top_px=left_top,
            tags=tuple(tags),
            outlines=count,
            unread=unread,
        )

    def _read(self, grey: Plane, corners: Points) -> SeenTag | Unread:
        """Read a code, and once more between measured sides where a cell is hardly larger than an outline's error."""
        tag = read_tag(grey, corners, self.family, inverted=self.inverted)
        if not isinstance(tag, Unread) or not tag.may_be_tag:
            return tag
        if not np.abs(corners[[1, 2, 3, 0]] - corners).max() < SMALL_CELL_PX * self.family.cells:
            return tag
        sides = measure_sides(grey, corners, self.family.cells, self.light)
        return tag if sides is None else read_tag(grey, sides.corners_px, self.family, inverted=self.inverted)


def _same(tag: SeenTag, other: SeenTag) -> bool:
    apart = np.abs(tag.corners_px.mean(axis=0) - other.corners_px.mean(axis=0)).max()
    return tag.number == other.number and bool(apart < other.side_px / 2)
