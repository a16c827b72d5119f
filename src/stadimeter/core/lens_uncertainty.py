"""The effect of a camera model's uncertainty on distances and directions, at each place in the picture.

A point at the direction d appears at ``p = F b(d; k) + c``. An error δθ of the parameters moves the direction that is
read at p by

    e(d) = -J⁻¹ F⁻¹ (∂p/∂θ) δθ        with J = ∂b/∂d

which is an error field over the picture. It turns what is seen there by e, and magnifies it by half its divergence: a
target that appears larger is measured nearer. On the sphere of directions, where a target's size is an angle, this is
``½ div e - 3/2 d·e / (1 + d·d)``, and the relative error of the distance is minus that. Both are linear in δθ, so
that their covariance follows from that of θ (R. Hartley and A. Zisserman, "Multiple View Geometry", section 5.2.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.lens_distortion import Coefficients, all_five, jacobian, slopes_by_coefficient
from stadimeter.errors import CalibrationError

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")

_CELLS = (24, 18)
_STEP = 1e-4

# Correlations that are written with few digits may miss being possible by this.
_NEGATIVE_MAX = 1e-4


class LensUncertainty(Struct, frozen=True, kw_only=True):
    """Uncertainty of the parameters of a camera model, in the order of `PARAMETERS`."""

    sigmas: tuple[float, ...]  # standard deviations, those of fx, fy, cx and cy in pixels
    correlations: tuple[float, ...]  # above the diagonal of their matrix, row by row

    def __post_init__(self) -> None:
        count, pairs = len(PARAMETERS), len(PARAMETERS) * (len(PARAMETERS) - 1) // 2
        if len(self.sigmas) != count or not all(math.isfinite(each) and each >= 0 for each in self.sigmas):
            names = ", ".join(PARAMETERS)
            raise CalibrationError(f"lens_sigmas has to hold {count} numbers, zero or more: {names}", "lens_sigmas")
        if len(self.correlations) != pairs or not all(abs(each) <= 1 for each in self.correlations):
            message = f"lens_correlations has to hold {pairs} numbers from -1 to 1"
            raise CalibrationError(message, "lens_correlations")
        if are_contradictory(self.correlations, count):
            raise CalibrationError("lens_correlations contradict each other; calibrate again", "lens_correlations")

    @classmethod
    def of(cls, covariance: NDArray[np.float64]) -> LensUncertainty:
        """Return the uncertainty with a covariance matrix, shape (9, 9)."""
        sigmas, correlations = split_covariance(covariance)
        return cls(
            sigmas=tuple(float(f"{each:.6g}") for each in sigmas),
            correlations=tuple(round(each, 7) for each in correlations),
        )

    def covariance(self) -> NDArray[np.float64]:
        """Return the covariance matrix, shape (9, 9)."""
        return join_covariance(self.sigmas, self.correlations)

    def scaled(self, scale_x: float, scale_y: float) -> LensUncertainty:
        """Return the uncertainty for another resolution of the same picture."""
        fx, fy, cx, cy, *bending = self.sigmas
        return replace(self, sigmas=(fx * scale_x, fy * scale_y, cx * scale_x, cy * scale_y, *bending))


def split_covariance(covariance: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Return standard deviations, and the correlations above the diagonal of their matrix, row by row."""
    sigmas = np.sqrt(np.diag(covariance).clip(0.0))
    scale = np.where(sigmas > 0, sigmas, 1.0)
    correlation = (covariance / np.outer(scale, scale)).clip(-1.0, 1.0)
    return sigmas.tolist(), correlation[np.triu_indices(len(sigmas), 1)].tolist()


def join_covariance(sigmas: Sequence[float], correlations: Sequence[float]) -> NDArray[np.float64]:
    """Return the covariance matrix that `split_covariance` has split."""
    return _correlation(correlations, len(sigmas)) * np.outer(sigmas, sigmas)


def are_contradictory(correlations: Sequence[float], count: int) -> bool:
    """Check whether there are no quantities with these correlations."""
    return bool(np.linalg.eigvalsh(_correlation(correlations, count))[0] < -_NEGATIVE_MAX)


def _correlation(correlations: Sequence[float], count: int) -> NDArray[np.float64]:
    matrix = np.eye(count)
    matrix[np.triu_indices(count, 1)] = correlations
    return matrix + matrix.T - np.eye(count)


def sensitivities(
    directions: NDArray[np.float64], focal_px: tuple[float, float], coefficients: Coefficients
) -> NDArray[np.float64]:
    """Return the sensitivity of what is measured at some places to each parameter of the camera.

    Args:
        directions: Where the places look to, x and y per unit of depth, shape (n, 2).

    Returns:
        Changes of the logarithm of the distance, and of the direction's x and y per unit of depth, for each of
        `PARAMETERS`, shape (n, 3, 9).
    """
    # Here, and a step to each side, all in one go.
    places = directions + _STEP * np.array(((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)))[:, None]
    around = _moves(places.reshape(-1, 2), focal_px, coefficients).reshape(5, len(directions), 2, len(PARAMETERS))
    moves = around[0]
    divergence = ((around[1] - around[2])[:, 0] + (around[3] - around[4])[:, 1]) / (2 * _STEP)
    outwards = np.einsum("ni,nip->np", directions, moves) / (1 + (directions**2).sum(axis=1))[:, None]
    return np.concatenate(((1.5 * outwards - 0.5 * divergence)[:, None], moves), axis=1)


def _moves(
    directions: NDArray[np.float64], focal_px: tuple[float, float], coefficients: Coefficients
) -> NDArray[np.float64]:
    """Return by how much directions change with each parameter, shape (n, 2, 9): e(d) for the unit vectors of δθ."""
    x, y = directions.T
    by_coefficient = slopes_by_coefficient(x, y)
    bent = directions + by_coefficient @ np.array(all_five(coefficients))
    seen = np.zeros((len(directions), 2, len(PARAMETERS)))
    for axis in (0, 1):
        seen[:, axis, axis] = bent[:, axis] / focal_px[axis]
        seen[:, axis, 2 + axis] = 1 / focal_px[axis]
    seen[:, :, 4:] = by_coefficient
    a, b, d = jacobian(x, y, coefficients)
    inverse = np.array([[d, -b], [-b, a]]) / (a * d - b * b)
    return np.asarray(-np.einsum("ijn,njp->nip", inverse, seen))


class SharesByPlace:
    """Uncertainty of a distance due to the lens, as a share, by the place in the picture where the target is seen.

    Args:
        shares: The standard deviations at the nodes of a grid over the picture, from its first to its last pixel, shape
            (rows, columns).
    """

    def __init__(self, shares: NDArray[np.float64], width_px: int, height_px: int) -> None:
        self._shares: list[list[float]] = shares.tolist()
        self._cells = (shares.shape[1] - 1, shares.shape[0] - 1)
        self._per_px = (self._cells[0] / max(width_px - 1.0, 1.0), self._cells[1] / max(height_px - 1.0, 1.0))

    @classmethod
    def nodes_px(cls, width_px: int, height_px: int) -> NDArray[np.float64]:
        """Return where the nodes are in the picture, shape (rows, columns, 2)."""
        columns, rows = _CELLS
        across, down = np.linspace(0.0, width_px - 1.0, columns + 1), np.linspace(0.0, height_px - 1.0, rows + 1)
        return np.stack(np.meshgrid(across, down), axis=-1)

    def at(self, x_px: float, y_px: float) -> float:
        """Return the standard deviation at a place, by linear interpolation; outside, that of the nearest place.

        What is not a number counts as 0: a direction that the lens does not reach has no place.
        """
        x = min(max(0.0, x_px * self._per_px[0]), self._cells[0] - 1e-9)
        y = min(max(0.0, y_px * self._per_px[1]), self._cells[1] - 1e-9)
        column, row = int(x), int(y)
        x, y = x - column, y - row
        upper, lower = self._shares[row], self._shares[row + 1]
        above = upper[column] + x * (upper[column + 1] - upper[column])
        below = lower[column] + x * (lower[column + 1] - lower[column])
        return float(above + y * (below - above))
