"""From pixels to rays and back: the camera model, and a rolling shutter on top.

A ray is written as x and y per unit of depth. A rolling shutter reads one row after the other while the picture moves
on: row v shows the picture shifted by ``skew · (v - reference) / height``.
"""

from __future__ import annotations

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from support.scenes.patch import Patch

Floats = NDArray[np.float64]
Rays = tuple[Floats, Floats]


class Lens(Struct, frozen=True, kw_only=True):
    """How directions become pixels.

    Attributes:
        camera: Focal lengths, centre, distortion and resolution.
        skew_px: By how much the picture moves, right and down, while all its rows are read.
        reference_row_px: The row that shows things where they truly are; the target's own.
    """

    camera: CameraModel
    skew_px: tuple[float, float] = (0.0, 0.0)
    reference_row_px: float = 0.0

    def rays(self, patch: Patch) -> Rays:
        """Return the ray of each sample of a patch: x and y per unit of depth, each of the samples' shape.

        Distortion is undone once a pixel and interpolated between: it is smooth, and that errs by less than 0.001 px.
        """
        if not (self.camera.distortion or any(self.skew_px)):
            columns, rows = _places(patch.left, patch.right, patch.finer), _places(patch.top, patch.bottom, patch.finer)
            x, y = (columns - self.camera.cx_px) / self.camera.fx_px, (rows - self.camera.cy_px) / self.camera.fy_px
            across, down = np.broadcast_arrays(x[None, :], y[:, None])
            return np.asarray(across), np.asarray(down)
        columns, rows = _places(patch.left - 1, patch.right + 1, 1), _places(patch.top - 1, patch.bottom + 1, 1)
        u, v = (grid.astype(np.float64) for grid in np.meshgrid(columns, rows))
        late = (v - self.reference_row_px) / self.camera.height_px
        still = np.column_stack(((u - self.skew_px[0] * late).ravel(), (v - self.skew_px[1] * late).ravel()))
        x, y = self.camera.directions(still).T.reshape(2, *u.shape)
        return _refined(x, patch.finer), _refined(y, patch.finer)

    def project(self, points_m: Points) -> Points:
        """Return where points appear.

        Args:
            points_m: Shape ``(n, 3)`` in the camera frame, in front of the camera.

        Returns:
            Shape ``(n, 2)`` in pixels.
        """
        u, v = self.camera.project(points_m[:, :2] / points_m[:, 2:]).T
        right, down = (skew / self.camera.height_px for skew in self.skew_px)
        row = (v - down * self.reference_row_px) / (1 - down)
        return np.column_stack((u + right * (row - self.reference_row_px), row))


def _places(first: int, end: int, finer: int) -> Floats:
    return first + (np.arange((end - first) * finer) + 0.5) / finer - 0.5


def _refined(grid: Floats, finer: int) -> Floats:
    height, width = grid.shape
    fine = cv2.resize(grid, (width * finer, height * finer), interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine, np.float64)[finer:-finer, finer:-finer]
