"""The JPEGs of a stream: decoded, if all of each is there.

Decoders fill in what is missing: with grey, with the last block, or with what was in their buffer, and libjpeg then
only warns. Looking for the end marker is not enough, since a relay that was interrupted may put one at the end of half
a picture. So every warning of libjpeg is an error here. Of pictures that were cut anywhere, with or without an end
marker, all are refused; of those that lack up to 1.5 kB somewhere inside, 97 %.

One byte that is missing inside is another case: the Huffman code soon finds its way again, and in seven of ten pictures
it gives as many blocks as are needed. What stays wrong is the brightness or colour from there to the end, since each
block is coded by its difference from the one before. That is an edge along blocks, as wide as the picture: to the right
of the byte's place above its row of blocks, to the left of it below. An edge that was not there before is damage.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.config.untrusted_file import JPEG_FILLED, PICTURE_MAX_PIXELS
from stadimeter.core.frame import Image
from stadimeter.errors import PictureError

# A picture with filling is believed where this share of the stream has it, as a running mean of about 20 pictures: a
# missing byte may leave as much behind.
_FILLED_SHARE = 0.2
_WEIGHT_OF_NEW = 0.05

# Height and width of the blocks that are coded together, by how coarsely colour is stored.
_BLOCK_PX = {"420": (16, 16), "422": (8, 16), "440": (16, 8), "411": (8, 32)}
_SMALL_BLOCK_PX = (8, 8)

# Damage: along one way through the picture from side to side, the mean step is larger than this, in grey levels, and
# than this part of its standard deviation. All of 25 pictures that were measured wrong, and 1 of 600 that a
# camera saw which turned.
_MIN_STEP = 20.0
_MIN_STEP_SIGMAS = 0.8


class JpegStream:
    """Decodes the pictures of one stream, in their order."""

    def __init__(self) -> None:
        self._filled_share = 0.0
        self._steps = np.zeros((0, 3))

    def decode(self, data: bytes) -> Image:
        """Decode a picture, blue first, shape ``(height, width, 3)``, if all of it is there.

        Raises:
            PictureError: It is damaged, or not a JPEG.
        """
        import simplejpeg  # noqa: PLC0415 - only streams need it

        is_filled = False
        try:
            height_px, width_px, _, subsampling = simplejpeg.decode_jpeg_header(data)
            if height_px * width_px > PICTURE_MAX_PIXELS:
                raise PictureError(f"a picture of {width_px} × {height_px} pixels is too large")
            image = np.empty((height_px, width_px, 3), np.uint8)
            simplejpeg.decode_jpeg(data, "BGR", buffer=image)
        except ValueError as error:
            is_filled = bool(JPEG_FILLED.search(str(error)))
            if not is_filled:
                raise PictureError(f"the picture is damaged: {error}") from error
        self._filled_share += _WEIGHT_OF_NEW * (is_filled - self._filled_share)
        if is_filled and self._filled_share < _FILLED_SHARE:
            raise PictureError("the picture is damaged: bytes are left over at its end")
        if self._has_new_edge(image, *_BLOCK_PX.get(subsampling, _SMALL_BLOCK_PX)):
            raise PictureError("the picture is damaged: its brightness or colour changes from one block to the next")
        return image

    def _has_new_edge(self, image: Image, height_px: int, width_px: int) -> bool:
        before, self._steps = self._steps, _steps(image, height_px, width_px)
        across = image.shape[1] // width_px
        if len(self._steps) < across:
            return False
        if len(before) != len(self._steps):
            before = np.zeros_like(self._steps)
        edges = _are_edges(self._steps, across)
        return bool(edges.any() and (edges & _are_edges(self._steps - before, across)).any())


def _steps(image: Image, height_px: int, width_px: int) -> NDArray[np.float64]:
    """Return the steps by which the upper side of each block is brighter than the lower side of the block above it.

    One row for each block, in the order of their coding, by colour. A slope that goes on is no step.
    """
    blocks = image.shape[1] // width_px
    rows = (image.shape[0] - 2) // height_px
    if not blocks or not rows:
        return np.zeros((0, 3))
    used = image[:, : blocks * width_px]
    # cv2 in place of numpy: a third of the time.
    two_above, above, below, two_below = (used[height_px + offset :: height_px][:rows] for offset in (-2, -1, 0, 1))
    near = cv2.subtract(below, above, dtype=cv2.CV_16S)
    far = cv2.subtract(two_below, two_above, dtype=cv2.CV_16S)
    steps = cv2.addWeighted(near, 1.5, far, -0.5, 0.0, dtype=cv2.CV_32F)
    means = cv2.resize(steps, (blocks, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(means, np.float64).reshape(-1, 3)


def _are_edges(steps: NDArray[np.float64], across: int) -> NDArray[np.bool_]:
    """Return by the first block, and by colour, whether the steps of as many blocks as lie side by side are an edge."""
    sums = np.zeros((len(steps) + 1, 6))
    np.cumsum(np.hstack((steps, steps * steps)), axis=0, out=sums[1:])
    means = (sums[across:] - sums[:-across]) / across
    mean, variance = means[:, :3], means[:, 3:] - means[:, :3] ** 2
    return (np.abs(mean) > _MIN_STEP) & (mean * mean > _MIN_STEP_SIGMAS**2 * variance)
