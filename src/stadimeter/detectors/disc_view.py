"""Where in a picture a disc is looked for, and how what is found there leads back to the whole picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.ellipse_profiles import Bend
from stadimeter.detectors.ellipse_search import Plane
from stadimeter.detectors.ellipse_shape import Ellipse, ellipse_through
from stadimeter.detectors.region import Region
from stadimeter.detectors.sampling import reduced, to_full_scale

SEARCH_LONG_SIDE_PX = 800
"""Outlines are looked for in a picture of this size, and measured in the full one."""

RIM_POINTS = 32


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Lens:
    """Leads between places in a picture and where they would be without distortion.

    Attributes:
        camera: The camera at the picture's resolution; None if it is not known, and then nothing is bent.
    """

    camera: CameraModel | None

    @property
    def bend(self) -> Bend | None:
        """How outlines are bent; None if they are not."""
        return self.bent if self.camera is not None and self.camera.distortion else None

    def bent(self, points_px: Points) -> Points:
        """Return where points appear, any shape that ends with x and y."""
        if self.camera is None or not self.camera.distortion:
            return points_px
        straight = (points_px.reshape(-1, 2) - self._centre()) / self._focal()
        return self.camera.project(straight).reshape(points_px.shape)

    def straightened(self, ellipse: Ellipse) -> Ellipse | None:
        """Return the ellipse that appears as one; None for one that none appears as."""
        if self.camera is None or not self.camera.distortion:
            return ellipse
        straight = self.camera.directions(ellipse.rim(RIM_POINTS).points_px) * self._focal() + self._centre()
        return ellipse_through(straight)

    def _focal(self) -> Points:
        return np.array([self.camera.fx_px, self.camera.fy_px]) if self.camera else np.ones(2)

    def _centre(self) -> Points:
        return np.array([self.camera.cx_px, self.camera.cy_px]) if self.camera else np.zeros(2)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class View:
    """A part of a picture, reduced if it is large.

    Attributes:
        left_top_px: Its first pixel in the whole picture, x and y.
        grey: It in code values, reduced.
        scale: By how much: 0.5 for half the size.
    """

    left_top_px: Points
    grey: Plane
    scale: float

    @classmethod
    def of(cls, image: Image, region: Region) -> View:
        """Return a view of a part of a picture."""
        small, scale = reduced(region.of(image), SEARCH_LONG_SIDE_PX)
        return cls(left_top_px=region.left_top_px, grey=_grey(small), scale=scale)

    def in_full(self, ellipse: Ellipse) -> Ellipse:
        """Return where an ellipse of the reduced part is in the whole picture."""
        return Ellipse(
            centre_px=to_full_scale(ellipse.centre_px, self.scale) + self.left_top_px,
            half_axes_px=ellipse.half_axes_px / self.scale,
        )


def _grey(image: Image) -> Plane:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
