"""The parts of a picture in which a network looks: all of it, tiles of it, and what is around one thing.

A network sees its input's size of pixels and no more: of a picture of 1280 px in an input of 416 px every third. Boxes
err by a pixel or two of the input, so a person who is 40 px tall is 13 px tall there, and is missed or measured badly.
In a part of the picture that is no larger than the input, every pixel counts.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from stadimeter.core.detection import Flags, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import Region

# Neighbouring tiles share this part of their sides. What is taller than that is found in the whole picture.
SHARED = 0.25

# Pictures of many pixels get larger tiles: a picture of 12 megapixels has 130 of 416 px.
MAX_TILES = 24

# Around a thing, a part of the picture is this many times as large as it: networks want some of what is around.
ROOM = 1.6

# Around a thing of few pixels the part is enlarged by this at most. That adds nothing to be seen, but what is 80 px
# tall is found more surely than what is 40 px tall: by a CenterNet 95 instead of 85 of 100 people.
MIN_ZOOM = 0.5

# A part that shows things larger than the whole picture does by less than this is not worth a look.
WORTHWHILE = 1.3

# A box that comes nearer than this to the border of a part, in pixels of the input, may be cut off by it.
CUT_PX = 3.0


class InputSize(NamedTuple):
    """Width and height of a network's input, in pixels."""

    width: int
    height: int

    def scale_of(self, width_px: int, height_px: int) -> float:
        """Return the pixels of the input that a pixel of a part of the picture becomes."""
        return min(self.width / width_px, self.height / height_px)


def tiles(image: Image, size: InputSize) -> tuple[Region, ...]:
    """Return parts that cover the picture at the resolution of the input; none if the whole shows hardly less."""
    height, width = image.shape[:2]
    zoom = 1.0
    grid: tuple[tuple[float, ...], tuple[float, ...]] = (), ()
    while size.scale_of(width, height) * WORTHWHILE * zoom < 1:
        grid = _starts(width, size.width * zoom), _starts(height, size.height * zoom)
        if len(grid[0]) * len(grid[1]) <= MAX_TILES:
            break
        zoom *= 1.25
    return tuple(_part(image, left, top, size, zoom) for top, left in itertools.product(grid[1], grid[0]))


def part_around(corners: Values, image: Image, size: InputSize) -> Region:
    """Return the part of the picture around a box, enlarged, or as large as the box needs."""
    zoom = max(MIN_ZOOM, ROOM * max((corners[2] - corners[0]) / size.width, (corners[3] - corners[1]) / size.height))
    left, top = (corners[:2] + corners[2:] - np.array(size) * zoom) / 2
    return _part(image, left, top, size, zoom)


def cut_by(part: Region, corners: Values, image: Image, scale: float) -> Flags:
    """Return which boxes, shape ``(n, 4)``, may be cut off by a border of a part that is none of the picture."""
    margin, (height, width) = CUT_PX / scale, image.shape[:2]
    return np.asarray(
        ((part.left > 0) & (corners[:, 0] < part.left + margin))
        | ((part.top > 0) & (corners[:, 1] < part.top + margin))
        | ((part.right < width) & (corners[:, 2] > part.right - margin))
        | ((part.bottom < height) & (corners[:, 3] > part.bottom - margin))
    )


def _starts(length_px: int, tile_px: float) -> tuple[float, ...]:
    count = 1 + max(0, math.ceil((length_px - tile_px) / ((1 - SHARED) * tile_px)))
    return tuple(np.linspace(0, max(0.0, length_px - tile_px), count).tolist())


def _part(image: Image, left: float, top: float, size: InputSize, zoom: float) -> Region:
    """Return a part of that size, moved into the picture."""
    height, width = image.shape[:2]
    across, down = min(width, round(size.width * zoom)), min(height, round(size.height * zoom))
    left_px, top_px = round(min(max(left, 0), width - across)), round(min(max(top, 0), height - down))
    return Region(left=left_px, top=top_px, right=left_px + across, bottom=top_px + down)
