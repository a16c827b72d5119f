"""The scenes' camera under water, behind a flat window: rays are turned one by one, by Snell's law."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from stadimeter.core.camera_model import REFRACTIONS, CameraModel
from stadimeter.core.detection import Points
from support.scenes import draw

INDEX = REFRACTIONS["water"].n


class WaterCamera(CameraModel, frozen=True):
    """A camera in air whose rays are turned at a thin window by Snell's law, ray by ray."""

    def directions(self, points_px: Points) -> Points:
        """Return where pixels look to in water."""
        air = CameraModel.directions(self, points_px)
        sine = air / np.sqrt(1 + (air**2).sum(axis=1, keepdims=True)) / INDEX
        return sine / np.sqrt(1 - (sine**2).sum(axis=1, keepdims=True))

    def direction(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return where one pixel looks to in water."""
        x, y = self.directions(np.array([[x_px, y_px]]))[0]
        return float(x), float(y)

    def project(self, directions: Points) -> Points:
        """Return at which pixels directions in water appear."""
        sine = directions / np.sqrt(1 + (directions**2).sum(axis=1, keepdims=True)) * INDEX
        air = sine / np.sqrt(1 - (sine**2).sum(axis=1, keepdims=True))
        return CameraModel.project(self, air)


# A distortion of zeros, so that the scenes' lens asks for directions.
CAMERA = replace(
    WaterCamera.with_focal_length(draw.CAMERA.fx_px, draw.CAMERA.width_px, draw.CAMERA.height_px), distortion=(0.0,) * 4
)
