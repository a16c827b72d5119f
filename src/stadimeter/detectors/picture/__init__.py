"""The picture detector: a poster, a book cover or a label of known size, from a file that shows what is on it.

It needs no rim, no colour and no code: its key points say where it is, and all of its area then says it to a few
hundredths of a pixel, also where a finger hides a part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from pydantic import Field, model_validator

from stadimeter.config.files import PICTURE_MAX_BYTES, decode_picture, read_untrusted
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import FilePath, Length, Tolerance
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction, RejectedCandidate
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.picture.alignment import MIN_AGREEING, Alignment, PictureFeatures, PictureLight, align
from stadimeter.detectors.protocol import check_image
from stadimeter.detectors.sampling import Light, Region, grey_of, in_light, light_table, touches_border
from stadimeter.detectors.sides import diagonals_meet, side_lengths, width_and_height
from stadimeter.errors import PictureError, UnreadableError
from stadimeter.ranging.flat import PictureShape

# The light of what is seen must follow that of the picture this closely, as a correlation, on this share of its area:
# the rest may be hidden.
MIN_CORRELATION, MIN_AGREEING_SHARE = 0.85, 0.55

# A file is worked with at this length of its longer side at most: it is compared in 112 samples, and described at 320
# pixels.
MAX_FILE_SIDE_PX = 1024

# With fewer key points the file is too plain to be found: each view of it must have some.
MIN_FILE_FEATURES = 60

# Least and greatest ratio of a file's sides to those that are stated.
MAX_ASPECT_OFF = 0.1

# Reach of the search around a prediction, to each side: in longer sides.
REGION_SIDES = 0.8

# Standard deviation of the apparent size at its best.
SIGMA_FLOOR_PX = 0.015


class PictureOptions(DriverOptions):
    """The options that a ``[targets.…]`` table with ``detector = "picture"`` may hold."""

    file: FilePath
    """A picture that shows it from the front, and nothing around it: a scan, or what was printed."""
    width: Length | None = None
    """Its width, such as ``"42 cm"``; the height follows from the file, unless it is given."""
    height: Length | None = None
    """Its height."""
    tolerance: Tolerance | None = None
    """One standard deviation of its sides; None for exactly known ones."""
    min_side_px: Annotated[float, Field(ge=24)] = 32.0
    """Where its shorter side is smaller than this in the frame, it is not accepted."""

    @model_validator(mode="after")
    def _has_a_size(self) -> PictureOptions:
        if self.width is None and self.height is None:
            raise ValueError('give its width or its height, such as width = "42 cm"')
        return self

    def build(self, context: DriverContext) -> PictureDetector:
        """Return the detector.

        Raises:
            PictureError: The file cannot be read, shows too little, or has other proportions than stated.
        """
        return PictureDetector(context.name, self)

    def lacks(self) -> tuple[str, ...]:
        """Return why the file cannot be used."""
        try:
            PictureDetector("picture", self)
        except PictureError as error:
            return (str(error),)
        return ()


class PictureDetector:
    """Finds one picture."""

    def __init__(self, name: str, options: PictureOptions) -> None:
        self._name = name
        self._min_side_px = options.min_side_px
        known = _read(options.file)
        self._size = _shape(options, known)
        grey = grey_of(known)
        self._features = PictureFeatures(grey)
        if self._features.count < MIN_FILE_FEATURES:
            raise PictureError(
                f"the picture {options.file} is too plain to be found: {self._features.count} key points, limit "
                f"{MIN_FILE_FEATURES}; take one with more on it, or the detector sheet"
            )
        self._light = PictureLight(in_light(grey, light_table("srgb")))

    @property
    def target_shape(self) -> PictureShape:
        """The picture's size."""
        return self._size

    def detect(
        self, frame: Frame, prediction: Prediction | None = None, *, lens: CameraModel | None = None
    ) -> Detection:
        """Look for the picture: over its expected corners first, then by its key points in the whole frame."""
        check_image(frame)
        grey = grey_of(frame.image)
        light = in_light(grey, light_table("srgb" if lens is None else lens.tone_curve))
        if prediction is not None and prediction.outline_px is not None and prediction.outline_px.shape == (4, 2):
            followed = self._align_at(light, prediction.outline_px, lens)
            if isinstance(followed, Detection) and followed.status is DetectionStatus.FOUND:
                return followed
        near = Region.expected(prediction, frame.image, sizes=REGION_SIDES, outwards=True)
        if near is not None:
            places = self._features.places_in(near.of(grey))
            found, _ = self._best([corners + near.left_top_px for corners in places], light, lens)
            if found is not None and found.status is DetectionStatus.FOUND:
                return found
        found, rejected = self._best(self._features.places_in(grey), light, lens)
        if found is not None:
            return found
        likeliest = f"the likeliest place is refused: {rejected[0].reason}" if rejected else ""
        reason = likeliest or f"fewer than {MIN_AGREEING} of its key points agree on a place"
        return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason, rejected=tuple(rejected))

    def _best(
        self, places: Sequence[Points], light: Light, lens: CameraModel | None
    ) -> tuple[Detection | None, list[RejectedCandidate]]:
        """Return the picture at the first place where it is, and the places before it with why it is not there."""
        rejected: list[RejectedCandidate] = []
        for corners in places:
            found = self._align_at(light, corners, lens)
            if isinstance(found, Detection):
                return found, rejected
            outline = tuple((float(each[0]), float(each[1])) for each in corners)
            size_px, (x, y) = max(side_lengths(corners)), diagonals_meet(corners)
            rejected.append(RejectedCandidate(centre_px=(x, y), size_px=size_px, reason=found, corners_px=outline))
        return None, rejected

    def _align_at(self, light: Light, corners_px: Points, lens: CameraModel | None) -> Detection | str:
        """Return the picture where it may be, or why it is not there."""
        if not np.isfinite(corners_px).all() or np.abs(corners_px).max() > 10 * max(light.shape):
            return "leads out of the frame"
        found = align(light, self._light, corners_px, lens)
        if found is None:
            return "what is there does not become like the picture"
        if found.correlation < MIN_CORRELATION or found.agreeing < MIN_AGREEING_SHARE:
            like = f"{found.agreeing:.0%} of it is like the picture by {found.correlation:.2f}"
            return f"{like}, limits {MIN_AGREEING_SHARE:.0%} and {MIN_CORRELATION:g}"
        if not min(side_lengths(found.corners_px)) >= self._min_side_px:
            return f"too small: {min(side_lengths(found.corners_px)):.0f} px, limit {self._min_side_px:g} px"
        if touches_border(found.corners_px, light.shape, 0.0):
            reason = "the picture is cut off by the border"
            status = DetectionStatus.TRUNCATED
            return Detection(target=self._name, status=status, reason=reason, outline_px=found.corners_px)
        return self._found(found)

    def _found(self, found: Alignment) -> Detection:
        width_px, height_px = width_and_height(found.corners_px)
        return Detection(
            target=self._name,
            status=DetectionStatus.FOUND,
            outline_px=found.corners_px,
            centre_px=diagonals_meet(found.corners_px),
            width_px=width_px,
            height_px=height_px,
            size_sigma_px=math.hypot(SIGMA_FLOOR_PX, _size_sigma_px(found)),
            quality=float(np.clip(found.correlation, 0, 1)),
        )


def _size_sigma_px(found: Alignment) -> float:
    """Return the standard deviation of the mean of width and height, from the corners' covariance."""
    corners = found.corners_px
    slopes = np.zeros((4, 2))
    for first in range(4):
        second = (first + 1) % 4
        along = (corners[second] - corners[first]) / max(float(np.linalg.norm(corners[second] - corners[first])), 1e-9)
        # Width and height are each the mean of two sides, so each side counts a quarter.
        slopes[first] -= along / 4
        slopes[second] += along / 4
    row = slopes.ravel()
    return math.sqrt(max(float(row @ found.covariance_px2 @ row), 0.0))


def _read(path: Path) -> Image:
    """Return the picture of a file, no larger than is needed."""
    try:
        image = decode_picture(read_untrusted(path, PICTURE_MAX_BYTES))
    except UnreadableError as error:
        raise PictureError(f"the picture {path} cannot be read: {error.reason}") from error
    except PictureError as error:
        raise PictureError(f"the picture {path} {error}") from error
    scale = min(1.0, MAX_FILE_SIDE_PX / max(image.shape[:2]))
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _shape(options: PictureOptions, known: Image) -> PictureShape:
    """Return the picture's size, of which the file says the proportions."""
    height_px, width_px = known.shape[:2]
    width_m = options.width or (options.height or 0.0) * width_px / height_px
    height_m = options.height or width_m * height_px / width_px
    off = width_m / height_m / (width_px / height_px) - 1
    if abs(off) > MAX_ASPECT_OFF:
        raise PictureError(
            f"the picture {options.file} has {width_px}x{height_px} pixels, but {width_m:g} x {height_m:g} m are other "
            "proportions; cut away what is around it, or leave out the height"
        )
    sigma = (options.tolerance or 0.0) / math.sqrt(width_m * height_m)
    return PictureShape(width_m=width_m, height_m=height_m, relative_sigma=sigma)
