"""Turn and zoom of a camera between two views of things that stand still.

A camera that turns about its lens moves each direction d = (x, y) to the projection of R (x, y, 1), whatever the
distance of what is seen there; one whose focal length grows by a factor multiplies directions by it. The three angles
and the logarithm of the factor are fitted by Gauss and Newton's method with Tukey's weights (P. Huber and E.
Ronchetti, "Robust Statistics", 2009), from a start that RANSAC finds.

A shift of the principal point looks like a turn of the camera to within the second order of the angle, so the two are
not distinguished: either makes bearings wrong by as much. A camera that was moved sideways shifts near things further
than far ones: no turn explains that, and fewer features agree.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.words import about

Directions = NDArray[np.float64]

ROUNDS = 12

# Tukey's constant in standard deviations: 95 % of the efficiency of least squares where errors are normal.
TUKEY = 4.685

# RANSAC takes a match as right within this many pixels. A turn of the camera bends the picture by less over a view.
RANSAC_PX = 4.0

# Features are found at whole pixels, so their places are no better than this, though all may agree.
ROUNDED_PX = 0.3

# Errors of neighbouring features are alike, such as those from a shadow. On rendered days without any movement the
# scatter of the result is this many times what independent errors would give.
CORRELATION_FACTOR = 2.0


class ViewMotion(Struct, frozen=True, kw_only=True):
    """The motion of the camera between two views.

    Attributes:
        pan_rad: How far it turned to the right, or its principal point moved to the left.
        tilt_rad: How far it turned up.
        roll_rad: How far its right side went down.
        zoom: By which share its focal length grew; 0.01 makes everything appear 1 % larger.
        sigmas: The standard deviations of these four.
        inliers: How many features agree.
    """

    pan_rad: float
    tilt_rad: float
    roll_rad: float
    zoom: float
    sigmas: tuple[float, float, float, float]
    inliers: int

    def undo(self, directions: Directions) -> Directions:
        """Return where directions of now were in the earlier view."""
        back = _rotation_matrix(self.tilt_rad, self.pan_rad, self.roll_rad)
        return _moved(directions / (1 + self.zoom), back)

    def in_words(self) -> str:
        """Describe what moved by how much, with standard deviations."""
        angles = zip(("pan", "tilt", "roll"), (self.pan_rad, self.tilt_rad, self.roll_rad), self.sigmas, strict=False)
        turned = (f"{name} {math.degrees(by):+.2f}° ± {about(math.degrees(sigma))}°" for name, by, sigma in angles)
        zoom = f"zoom {self.zoom:+.2%} ± {about(100 * self.sigmas[3])}%"
        return f"{', '.join(turned)}, {zoom} ({self.inliers} features agree)"

    @property
    def rotation_rad(self) -> float:
        """The angle of the whole turn."""
        return math.hypot(self.pan_rad, self.tilt_rad, self.roll_rad)

    @property
    def rotation_sigma_rad(self) -> float:
        """Its standard deviation; that of the roll is some three times the others."""
        turns = (self.pan_rad, self.tilt_rad, self.roll_rad)
        return math.hypot(*(by * sigma for by, sigma in zip(turns, self.sigmas, strict=False))) / max(
            self.rotation_rad, 1e-9
        )


def fit_view_motion(
    before: Directions, now: Directions, focal_px: float, min_inliers: int
) -> tuple[ViewMotion, NDArray[np.bool_]] | None:
    """Find how the camera moved and which matches agree; None if fewer than `min_inliers` do.

    Args:
        before: Directions of matched features in the earlier view, shape (n, 2).
        now: Those of the same features now.
    """
    if len(before) < min_inliers:
        return None
    start, chosen = cv2.estimateAffinePartial2D(before * focal_px, now * focal_px, ransacReprojThreshold=RANSAC_PX)
    if start is None or int(chosen.sum()) < min_inliers:
        return None
    # The start: a similarity is a roll, a zoom, and a shift by the pan and the tilt.
    zoom = math.log(math.hypot(start[0, 0], start[1, 0]))
    roll = math.atan2(start[1, 0], start[0, 0])
    rotation = _rotation_matrix(-start[1, 2] / focal_px, start[0, 2] / focal_px, roll)
    weights = np.asarray(chosen, np.float64).ravel()
    scale = RANSAC_PX / focal_px / 2
    for _ in range(ROUNDS):
        predicted = _moved(before, np.diag((math.exp(zoom), math.exp(zoom), 1.0)) @ rotation)
        slopes, residuals = _slopes(predicted), now - predicted
        scale = max(1.4826 * float(np.median(np.abs(residuals[weights > 0]))), ROUNDED_PX / focal_px)
        off = np.hypot(*residuals.T) / (TUKEY * scale)
        weights = np.where(off < 1, (1 - off**2) ** 2, 0.0)
        inliers = int((weights > 0).sum())
        if inliers < min_inliers:
            return None
        normal = np.einsum("nak,nal,n->kl", slopes, slopes, weights)
        step = np.linalg.solve(normal, np.einsum("nak,na,n->k", slopes, residuals, weights))
        rotation, zoom = _rotation_matrix(*step[:3]) @ rotation, zoom + step[3]
    of_tilt, of_pan, of_roll, of_zoom = (CORRELATION_FACTOR * scale * np.sqrt(np.diag(np.linalg.inv(normal)))).tolist()
    # Things move against the camera.
    tilt, pan, roll = (-float(each) for each in cv2.Rodrigues(rotation)[0].ravel())
    sigmas, zoom = (of_pan, of_tilt, of_roll, of_zoom), math.expm1(zoom)
    motion = ViewMotion(pan_rad=pan, tilt_rad=tilt, roll_rad=roll, zoom=zoom, sigmas=sigmas, inliers=inliers)
    return motion, weights > 0


def _rotation_matrix(x_rad: float, y_rad: float, z_rad: float) -> NDArray[np.float64]:
    return np.asarray(cv2.Rodrigues(np.array([x_rad, y_rad, z_rad]))[0], np.float64)


def _moved(directions: Directions, by: NDArray[np.float64]) -> Directions:
    return np.asarray(cv2.perspectiveTransform(directions[None], by)[0], np.float64)


def _slopes(at: Directions) -> NDArray[np.float64]:
    """Return the change of directions with three angles and the logarithm of the zoom, shape (n, 2, 4)."""
    x, y = at.T
    along = (-x * y, 1 + x**2, -y, x), (-(1 + y**2), x * y, x, y)
    return np.stack([np.stack(each, axis=-1) for each in along], axis=1)
