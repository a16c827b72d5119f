"""How a camera turns directions into pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from stadimeter.errors import CalibrationError

ASPECT_TOLERANCE = 0.01
"""Two resolutions have the same aspect if they differ by no more than this share: rounding to whole pixels, no crop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """How a camera model was made.

    Attributes:
        method: Such as ``one picture at a known distance``.
        date: ISO 8601 date.
        notes: The figures that it came from, one a line.
    """

    method: str = ""
    date: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """A pinhole camera. Pixel coordinates have (0, 0) at the centre of the top left pixel.

    Attributes:
        width_px: Width of the pictures that it is for.
        height_px: Height of the pictures that it is for.
        fx_px: Focal length in pixels, horizontally.
        fy_px: Focal length in pixels, vertically.
        cx_px: Where the optical axis meets the picture, horizontally.
        cy_px: Where the optical axis meets the picture, vertically.
        focal_relative_sigma: Standard deviation of the focal length, as a share of it.
        provenance: How it was made.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    focal_relative_sigma: float = 0.0
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        if self.width_px < 1 or self.height_px < 1:
            raise CalibrationError(f"a camera of {self.width_px}x{self.height_px} px has no pixels")
        for name, value in (("fx_px", self.fx_px), ("fy_px", self.fy_px)):
            if not (math.isfinite(value) and value > 0):
                raise CalibrationError(f"focal length {name} = {value} is not a positive number")
        if not (math.isfinite(self.cx_px) and math.isfinite(self.cy_px)):
            raise CalibrationError(f"optical centre {self.cx_px}, {self.cy_px} is not finite")
        if not (math.isfinite(self.focal_relative_sigma) and self.focal_relative_sigma >= 0):
            raise CalibrationError(f"focal_relative_sigma = {self.focal_relative_sigma} is not zero or more")

    @classmethod
    def with_focal_length(cls, focal_px: float, width_px: int, height_px: int) -> CameraModel:
        """Make a model with square pixels and the optical axis through the middle of the picture.

        Args:
            focal_px: Focal length in pixels.
            width_px: Width of the pictures.
            height_px: Height of the pictures.

        Returns:
            The model.

        Raises:
            CalibrationError: A value is not a positive number.
        """
        centre_x, centre_y = (width_px - 1) / 2, (height_px - 1) / 2
        return cls(
            width_px=width_px, height_px=height_px, fx_px=focal_px, fy_px=focal_px, cx_px=centre_x, cy_px=centre_y
        )

    def scaled_to(self, width_px: int, height_px: int) -> CameraModel:
        """Return the model for another resolution of the same picture.

        A focal length in pixels grows with the number of pixels across the same view. Another aspect means that the
        view was cropped, and how is not known.

        Args:
            width_px: Width of the other pictures.
            height_px: Height of the other pictures.

        Returns:
            The model for that resolution.

        Raises:
            CalibrationError: The aspect differs.
        """
        if (width_px, height_px) == (self.width_px, self.height_px):
            return self
        scale_x, scale_y = width_px / self.width_px, height_px / self.height_px
        if abs(scale_x / scale_y - 1) > ASPECT_TOLERANCE:
            raise CalibrationError(
                f"the camera was calibrated at {self.width_px}x{self.height_px}; a picture of {width_px}x{height_px} "
                "has another aspect, so it shows another part of the view; calibrate at this resolution"
            )
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * scale_x,
            fy_px=self.fy_px * scale_y,
            cx_px=(self.cx_px + 0.5) * scale_x - 0.5,
            cy_px=(self.cy_px + 0.5) * scale_y - 0.5,
        )

    def direction(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return where a pixel looks to.

        Args:
            x_px: Horizontal pixel coordinate.
            y_px: Vertical pixel coordinate.

        Returns:
            The direction as x and y per unit of depth, x to the right and y down.
        """
        return (x_px - self.cx_px) / self.fx_px, (y_px - self.cy_px) / self.fy_px
