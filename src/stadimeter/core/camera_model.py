"""The way a camera turns directions into pixels: its lens, how well that is known, and a flat window before it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, NamedTuple, TypeVar, get_args

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.frame import CHROMA_PITCH_PX, SUBSAMPLINGS, Frame, Optics, Subsampling
from stadimeter.errors import CalibrationError

# The bending of straight lines by a lens, and the way back ------------------------------------------------------------
#
# The model is the one of OpenCV's calibration with five coefficients, in this order: k1, k2, p1, p2, k3. A
# direction (x, y) per unit of depth, with s = x² + y², appears at
#
#     x' = x·R + 2·p1·x·y + p2·(s + 2·x²)
#     y' = y·R + p1·(s + 2·y²) + 2·p2·x·y        with R = 1 + k1·s + k2·s² + k3·s³
#
# (D. C. Brown, Decentering distortion of lenses, Photogrammetric Engineering 32, 1966). The polynomial turns around
# at some angle, where further out would appear further in; beyond this reach it says nothing about the lens. There
# is no formula for the way back; Newton's method finds it, quadratically, since the Jacobian is known and
# symmetric.

Coefficients = tuple[float, ...]
Points = NDArray[np.float64]
Numbers = TypeVar("Numbers", float, Points)

# Newton's method needs three to six steps on real lenses; what needs more does not arrive.
_STEPS = 20

# Coefficients of real lenses stay below a few hundred.
_BEYOND_REASON = 1e6

# Per unit of depth: far below a millionth of a pixel.
_CLOSE_ENOUGH = 1e-11


def check_coefficients(coefficients: Coefficients) -> None:
    """Refuse coefficients that are not those of a lens.

    Args:
        coefficients: None, or k1 k2 p1 p2, or k1 k2 p1 p2 k3.

    Raises:
        CalibrationError: There is another number of them, or one is not finite or beyond reason.
    """
    if len(coefficients) not in {0, 4, 5}:
        raise CalibrationError(
            f"distortion has {len(coefficients)} coefficients; write none, or k1, k2, p1, p2, or k1, k2, p1, p2, k3",
            "distortion",
        )
    if not all(abs(each) < _BEYOND_REASON for each in coefficients):
        raise CalibrationError(f"distortion {list(coefficients)} has a coefficient that no lens has", "distortion")


def distorted(directions: Points, coefficients: Coefficients) -> Points:
    """Return where directions appear.

    Args:
        directions: x to the right and y down per unit of depth, shape (n, 2).
        coefficients: k1, k2, p1, p2 and perhaps k3.

    Returns:
        The bent directions, shape (n, 2); NaN for those that are out of the lens's reach.
    """
    x, y = directions[:, 0], directions[:, 1]
    within = np.where(x * x + y * y < _reach(coefficients), 1.0, np.nan)
    bent_x, bent_y = _bent(x, y, coefficients)
    return np.column_stack((bent_x * within, bent_y * within))


def distorted_direction(x: float, y: float, coefficients: Coefficients) -> tuple[float, float]:
    """Return where one direction appears, without the cost of arrays.

    Args:
        x: To the right, per unit of depth.
        y: Down, per unit of depth.
        coefficients: k1, k2, p1, p2 and perhaps k3.

    Returns:
        The bent direction; NaN where it is out of the lens's reach.
    """
    return _bent(x, y, coefficients) if x * x + y * y < _reach(coefficients) else (math.nan, math.nan)


def undistorted(appearing: Points, coefficients: Coefficients) -> Points:
    """Return which directions appear at some places: the inverse of `distorted`.

    Args:
        appearing: Bent directions, x to the right and y down per unit of depth, shape (n, 2).
        coefficients: k1, k2, p1, p2 and perhaps k3.

    Returns:
        The directions, shape (n, 2); NaN where there is none, since the lens does not reach there.
    """
    appearing_x, appearing_y = appearing[:, 0], appearing[:, 1]
    x, y = appearing_x.copy(), appearing_y.copy()
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            off_x, off_y = _off(x, y, appearing_x, appearing_y, coefficients)
            if np.abs(off_x).max(initial=0.0) < _CLOSE_ENOUGH and np.abs(off_y).max(initial=0.0) < _CLOSE_ENOUGH:
                break
            a, b, d = jacobian(x, y, coefficients)
            determinant = a * d - b * b
            x, y = x + (d * off_x - b * off_y) / determinant, y + (a * off_y - b * off_x) / determinant
        off_x, off_y = _off(x, y, appearing_x, appearing_y, coefficients)
        found = (np.hypot(off_x, off_y) < 10 * _CLOSE_ENOUGH) & (x * x + y * y < _reach(coefficients))
    found_or_nan = np.where(found, 1.0, np.nan)
    return np.column_stack((x * found_or_nan, y * found_or_nan))


def _off(x: Points, y: Points, wanted_x: Points, wanted_y: Points, coefficients: Coefficients) -> tuple[Points, Points]:
    bent_x, bent_y = _bent(x, y, coefficients)
    return wanted_x - bent_x, wanted_y - bent_y


def _bent(x: Numbers, y: Numbers, coefficients: Coefficients) -> tuple[Numbers, Numbers]:
    k1, k2, p1, p2, k3 = all_five(coefficients)
    s = x * x + y * y
    radial = 1 + s * (k1 + s * (k2 + s * k3))
    twice_xy = 2 * x * y
    return (x * radial + p1 * twice_xy + p2 * (s + 2 * x * x), y * radial + p1 * (s + 2 * y * y) + p2 * twice_xy)


def slopes_by_coefficient(x: Points, y: Points) -> Points:
    """Return the change of bent directions with k1, k2, p1, p2 and k3, in which they are linear; shape (n, 2, 5)."""
    s, twice_xy = x * x + y * y, 2 * x * y
    return np.stack(
        (
            np.column_stack((x * s, x * s * s, twice_xy, s + 2 * x * x, x * s**3)),
            np.column_stack((y * s, y * s * s, s + 2 * y * y, twice_xy, y * s**3)),
        ),
        axis=1,
    )


def jacobian(x: Points, y: Points, coefficients: Coefficients) -> tuple[Points, Points, Points]:
    """Return ∂x'/∂x, ∂x'/∂y = ∂y'/∂x and ∂y'/∂y.

    Args:
        x: To the right, per unit of depth, shape (n,).
        y: Down, per unit of depth, shape (n,).
        coefficients: k1, k2, p1, p2 and perhaps k3.
    """
    k1, k2, p1, p2, k3 = all_five(coefficients)
    s = x * x + y * y
    radial = 1 + s * (k1 + s * (k2 + s * k3))
    slope = 2 * (k1 + s * (2 * k2 + s * 3 * k3))
    return (
        radial + x * x * slope + 2 * p1 * y + 6 * p2 * x,
        x * y * slope + 2 * p1 * x + 2 * p2 * y,
        radial + y * y * slope + 6 * p1 * y + 2 * p2 * x,
    )


@lru_cache(maxsize=32)
def _reach(coefficients: Coefficients) -> float:
    """Return the s at which r·R, the bent distance from the axis, first turns around.

    There 1 + 3·k1·s + 5·k2·s² + 7·k3·s³ = 0. Its roots are found as those of 1/s, which is always a cubic.
    """
    k1, k2, _, _, k3 = all_five(coefficients)
    roots = np.roots([1.0, 3 * k1, 5 * k2, 7 * k3])
    turning = [root.real for root in roots if abs(root.imag) <= 1e-9 * abs(root) and root.real > 0]
    return 1 / max(turning) if turning else math.inf


def all_five(coefficients: Coefficients) -> tuple[float, float, float, float, float]:
    """Return k1, k2, p1, p2 and k3; those that are not given are 0."""
    k1, k2, p1, p2, k3 = (*coefficients, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    return k1, k2, p1, p2, k3


# The effect of a camera model's uncertainty on distances and directions, at each place in the picture -----------------
#
# A point at the direction d appears at ``p = F b(d; k) + c``. An error δθ of the parameters moves the direction
# that is read at p by
#
#     e(d) = -J⁻¹ F⁻¹ (∂p/∂θ) δθ        with J = ∂b/∂d
#
# which is an error field over the picture. It turns what is seen there by e, and magnifies it by half its
# divergence: a target that appears larger is measured nearer. On the sphere of directions, where a target's size is
# an angle, this is ``½ div e - 3/2 d·e / (1 + d·d)``, and the relative error of the distance is minus that. Both
# are linear in δθ, so that their covariance follows from that of θ (R. Hartley and A. Zisserman, "Multiple View
# Geometry", section 5.2.1).

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


# The way a camera turns directions into pixels ------------------------------------------------------------------------

# How code values follow from light: as in sRGB, which nearly every camera imitates, or in proportion to it.
ToneCurve = Literal["srgb", "linear"]

TONE_CURVES: tuple[ToneCurve, ...] = get_args(ToneCurve)

# Two resolutions have the same aspect if they differ by no more than this share: rounding to whole pixels, no crop.
ASPECT_TOLERANCE = 0.01

# Standard deviation of the edge bias of a camera of whose tone curve and sharpening nothing is known.
UNKNOWN_EDGE_BIAS_SIGMA_PX = 0.1

# Focal lengths as shares of the picture's long side: at the shortest it spans 175 degrees, at the longest 20 arc
# seconds. The focal length in millimetres, written by mistake, is shorter.
MIN_FOCAL, MAX_FOCAL = 0.02, 1e4

# How far the optical centre may be from the middle, as a share of the picture's width or height: it is in the picture,
# and of lenses that are mounted straight within a tenth.
MAX_OFF_CENTRE, USUAL_OFF_CENTRE = 0.5, 0.1


def is_one_aspect(one_px: tuple[int, int], other_px: tuple[int, int]) -> bool:
    """Check whether two widths and heights are resolutions of one view, so that one lens fits both."""
    scale_x, scale_y = one_px[0] / other_px[0], one_px[1] / other_px[1]
    return abs(scale_x - scale_y) <= ASPECT_TOLERANCE * scale_y


def check_one_aspect(first: tuple[str, int, int], other: tuple[str, int, int]) -> None:
    """Raise a `CalibrationError` that names two pictures, each with its width and height, if no lens fits both."""
    if not is_one_aspect(first[1:], other[1:]):
        raise CalibrationError(
            f"{other[0]} has {other[1]}x{other[2]} px, {first[0]} has {first[1]}x{first[2]} px: another aspect shows "
            "another part of the view, so no camera file fits both; leave out the pictures of one of them"
        )


class Provenance(Struct, frozen=True, kw_only=True):
    """The way a camera model was made.

    Attributes:
        method: Such as ``one picture at a known distance``.
        date: ISO 8601 date.
        notes: The figures that it came from, one a line.
        taken_with: How the lens was set, as the pictures' EXIF data state it: focal length and its 35 mm equivalent in
            millimetres, and the digital zoom, each with its name; empty where they state nothing.
    """

    method: str = ""
    date: str = ""
    notes: tuple[str, ...] = ()
    taken_with: tuple[tuple[str, float | str], ...] = ()


class CameraModel(Struct, frozen=True, kw_only=True):
    """A pinhole camera with a lens that may bend lines.

    Pixel coordinates have (0, 0) at the centre of the top left pixel. Directions are x to the right and y down per unit
    of depth, in the camera frame, with the bending of the lens taken out.

    Attributes:
        width_px: Width of the pictures that it is for.
        height_px: Height of the pictures that it is for.
        cx_px: Where the optical axis meets the picture, horizontally.
        cy_px: Where the optical axis meets the picture, vertically.
        distortion: How the lens bends lines: k1, k2, p1, p2 and perhaps k3 as OpenCV has them, or empty for not at all.
        tone_curve: How code values follow from light.
        edge_bias_px: How far outwards each edge of a target brighter than its surroundings is measured, in pixels, once
            the tone curve is undone: the target appears larger by twice this. A darker target appears smaller by as
            much. It comes from what the tone curve leaves: sharpening, glare, a different curve.
        edge_bias_sigma_px: Standard deviation of the edge bias: 0 for a camera whose tone curve is known,
            `UNKNOWN_EDGE_BIAS_SIGMA_PX` for one of which nothing is. It is the same in every picture, so it never
            averages out.
        focal_relative_sigma: Standard deviation of the focal length, as a share of it.
        subsampling: How coarsely the camera stores colour; None where that is left to the frame.
        optics: How the camera was set when it was calibrated; None where that is not known.
        uncertainty: How well all its parameters are known together; None where only that of the focal length is known.
        pupil_ahead_m: How far in front of where rays seem to come from the lens's entrance pupil is; 0 in air.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()
    tone_curve: ToneCurve = "srgb"
    edge_bias_px: float = 0.0
    edge_bias_sigma_px: float = 0.0
    focal_relative_sigma: float = 0.0
    subsampling: Subsampling | None = None
    optics: Optics | None = None
    uncertainty: LensUncertainty | None = None
    pupil_ahead_m: float = 0.0
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        if self.width_px < 1 or self.height_px < 1:
            raise CalibrationError(f"a camera of {self.width_px}x{self.height_px} px has no pixels", "width_px")
        for name, value in (("fx_px", self.fx_px), ("fy_px", self.fy_px)):
            self._check_focal_length(name, value)
        for name, share in zip(("cx_px", "cy_px"), self.off_centre_shares, strict=True):
            if not share <= MAX_OFF_CENTRE:
                raise CalibrationError(
                    f"optical centre {name} = {getattr(self, name):g} is outside the {self.width_px}x{self.height_px} "
                    "px of the picture; no lens has it there: leave it out for the middle, or calibrate with a board",
                    name,
                )
        self._check_sigma("focal_relative_sigma", self.focal_relative_sigma)
        self._check_sigma("edge_bias_sigma_px", self.edge_bias_sigma_px)
        if self.tone_curve not in TONE_CURVES:
            raise CalibrationError(f"tone_curve = {self.tone_curve!r} is neither 'srgb' nor 'linear'", "tone_curve")
        if self.subsampling is not None and self.subsampling not in SUBSAMPLINGS:
            message = f"subsampling = {self.subsampling!r} is none of {', '.join(SUBSAMPLINGS)}"
            raise CalibrationError(message, "subsampling")
        if not math.isfinite(self.edge_bias_px):
            raise CalibrationError(f"edge_bias_px = {self.edge_bias_px} is not finite", "edge_bias_px")
        check_coefficients(self.distortion)
        self._check_reach()

    @property
    def off_centre_shares(self) -> tuple[float, float]:
        """Distance of the optical axis from the middle of the picture, as shares of its width and its height."""
        across, down = self.cx_px - (self.width_px - 1) / 2, self.cy_px - (self.height_px - 1) / 2
        return abs(across) / self.width_px, abs(down) / self.height_px

    @property
    def off_centre_words(self) -> str:
        """Words on what to look at again where the optical centre is far from the middle; empty where it is near."""
        worst = max(self.off_centre_shares)
        if worst <= USUAL_OFF_CENTRE:
            return ""
        return (
            f"the optical centre, cx_px = {self.cx_px:g} and cy_px = {self.cy_px:g}, is {worst:.0%} of the picture "
            "from its middle: unless the picture was cropped or the lens is shifted, directions and distances are wrong"
        )

    def _check_sigma(self, name: str, value: float) -> None:
        if not (math.isfinite(value) and value >= 0):
            raise CalibrationError(f"{name} = {value} is not zero or more", name)

    def _check_focal_length(self, name: str, value: float) -> None:
        if not (math.isfinite(value) and value > 0):
            raise CalibrationError(f"focal length {name} = {value} is not a positive number", name)
        shortest, longest = (share * max(self.width_px, self.height_px) for share in (MIN_FOCAL, MAX_FOCAL))
        if not shortest <= value <= longest:
            raise CalibrationError(
                f"focal length {name} = {value:g} is not that of a lens: for {self.width_px}x{self.height_px} px it is "
                f"between {shortest:g} and {longest:g} px; check its unit, or the distance and size that it came from",
                name,
            )

    def _check_reach(self) -> None:
        if not self.distortion:
            return
        right, bottom = self.width_px - 1.0, self.height_px - 1.0
        corners = np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]])
        unreached = corners[~np.isfinite(self.directions(corners)).all(axis=1)]
        if len(unreached):
            x_px, y_px = unreached[0]
            raise CalibrationError(
                f"distortion {list(self.distortion)} folds the picture before its corner at {x_px:g}, {y_px:g} px; "
                "no lens does this; calibrate with the board in the corners too",
                "distortion",
            )

    @classmethod
    def with_focal_length(cls, focal_px: float, width_px: int, height_px: int) -> CameraModel:
        """Make a model with square pixels and the optical axis through the middle of the picture.

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
        view was cropped, and how is not known. Distortion belongs to directions and stays. The edge bias is made by the
        optics and by what the camera does to its own pixels, and shrinks with the picture.

        Raises:
            CalibrationError: The aspect differs.
        """
        if (width_px, height_px) == (self.width_px, self.height_px):
            return self
        scale_x, scale_y = width_px / self.width_px, height_px / self.height_px
        if not is_one_aspect((width_px, height_px), (self.width_px, self.height_px)):
            why = "has another aspect, so it shows another part of the view; calibrate at this resolution"
            if is_one_aspect((height_px, width_px), (self.width_px, self.height_px)):
                why = (
                    "was taken with the camera turned by a quarter: hold it as at its calibration, or calibrate it anew"
                )
            own, other = f"{self.width_px}x{self.height_px}", f"{width_px}x{height_px}"
            raise CalibrationError(f"the camera was calibrated at {own}; a picture of {other} {why}")
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * scale_x,
            fy_px=self.fy_px * scale_y,
            cx_px=(self.cx_px + 0.5) * scale_x - 0.5,
            cy_px=(self.cy_px + 0.5) * scale_y - 0.5,
            edge_bias_px=self.edge_bias_px * math.sqrt(scale_x * scale_y),
            edge_bias_sigma_px=self.edge_bias_sigma_px * math.sqrt(scale_x * scale_y),
            uncertainty=self.uncertainty and self.uncertainty.scaled(scale_x, scale_y),
        )

    def for_frame(self, frame: Frame) -> CameraModel:
        """Return the model at a frame's resolution, with the subsampling of its colour.

        Raises:
            CalibrationError: The aspect differs, or the camera was set otherwise when it was calibrated.
        """
        if self.optics and frame.optics and (change := self.optics.change_to(frame.optics)):
            raise CalibrationError(change)
        scaled = self.scaled_to(frame.width_px, frame.height_px)
        return scaled if scaled.subsampling else replace(scaled, subsampling=frame.subsampling)

    @property
    def chroma_pitch_px(self) -> tuple[int, int]:
        """Number of pixels that share one sample of colour, across and down; one each where that is not known."""
        return CHROMA_PITCH_PX[self.subsampling or "4:4:4"]

    def direction(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return where a pixel looks to.

        Returns:
            The direction as x and y per unit of depth, x to the right and y down; NaN as with `directions`.
        """
        if not self.distortion:
            return (x_px - self.cx_px) / self.fx_px, (y_px - self.cy_px) / self.fy_px
        x, y = self.directions(np.array([[x_px, y_px]]))[0]
        return float(x), float(y)

    def directions(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where pixels look to.

        Args:
            points_px: Pixel coordinates x and y, shape (n, 2).

        Returns:
            The directions as x to the right and y down per unit of depth, shape (n, 2). Every place inside the picture
            has one; far outside, where the distortion has no inverse, they are NaN.
        """
        appearing = (np.asarray(points_px, dtype=np.float64) - self._centre()) / self._focal()
        return undistorted(appearing, self.distortion) if self.distortion else appearing

    def project(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return at which pixels directions appear: the inverse of `directions`.

        Args:
            directions: x to the right and y down per unit of depth, shape (n, 2); of a point x/z and y/z.

        Returns:
            Pixel coordinates x and y, shape (n, 2); NaN for directions that the lens does not reach.
        """
        straight = np.asarray(directions, dtype=np.float64)
        appearing = distorted(straight, self.distortion) if self.distortion else straight
        return appearing * self._focal() + self._centre()

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Return at which pixel a direction appears: `project` for one direction, in a tenth of the time.

        Args:
            x: To the right, per unit of depth.
            y: Down, per unit of depth.

        Returns:
            Pixel coordinates x and y; NaN as with `project`.
        """
        if self.distortion:
            x, y = distorted_direction(x, y, self.distortion)
        return x * self.fx_px + self.cx_px, y * self.fy_px + self.cy_px

    def distance_share(self, x_px: float, y_px: float) -> float:
        """Return the standard deviation of a distance because of the lens, as a share, at a place in the picture.

        It is that of the focal length at least; away from the middle, and where no board was seen, it is more.
        """
        if self.uncertainty is None:
            return self.focal_relative_sigma
        return max(self.focal_relative_sigma, _shares_by_place(self, self.uncertainty).at(x_px, y_px))

    def sensitivities(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Find how what is measured at pixels (n, 2) changes with the lens: see `lens_uncertainty.sensitivities`."""
        return sensitivities(self.directions(points_px), (self.fx_px, self.fy_px), self.distortion)

    def matrix(self) -> NDArray[np.float64]:
        """Return the camera matrix as OpenCV has it, shape (3, 3)."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    def _focal(self) -> NDArray[np.float64]:
        return np.array([self.fx_px, self.fy_px])

    def _centre(self) -> NDArray[np.float64]:
        return np.array([self.cx_px, self.cy_px])


@lru_cache(maxsize=8)  # a run has one lens, and one more for each size of picture
def _shares_by_place(model: CameraModel, uncertainty: LensUncertainty) -> SharesByPlace:
    nodes_px = SharesByPlace.nodes_px(model.width_px, model.height_px)
    slopes = model.sensitivities(nodes_px.reshape(-1, 2))[:, 0]
    squares = np.einsum("np,pq,nq->n", slopes, uncertainty.covariance(), slopes).clip(0.0)
    return SharesByPlace(np.sqrt(squares).reshape(nodes_px.shape[:2]), model.width_px, model.height_px)


# A camera behind a flat window under water ----------------------------------------------------------------------------
#
# By Snell's law a ray that meets the window at the angle θa in air goes on at θw in water, sin θa = n sin θw. So a
# target appears n times as large near the middle, and more towards the border: it is a longer lens with a
# pincushion distortion, and is described as one. With r = tan θw,
#
#     tan θa = n r / √(1 - (n² - 1) r²)
#
# Rays in water seem to come from behind the pupil: they meet the window, at the distance d in front of it, at the
# height d tan θa, and the line back crosses the axis at z = d (1 - tan θa / tan θw), near the axis (n - 1) d behind
# the pupil (T. Treibitz et al., "Flat refractive geometry", 2012, section 3).

Medium = Literal["air", "water", "sea water"]


class Refraction(NamedTuple):
    """Refraction of light between a medium and air: the refractive index, and its standard deviation."""

    n: float
    sigma: float


# Of green light between 0 and 30 °C (IAPWS R9-97 for water; X. Quan and E. Fry, 1995, for 35 g of salt in a kilogram);
# the standard deviation is for temperature, salt and colour.
REFRACTIONS: dict[Medium, Refraction] = {"water": Refraction(1.334, 0.002), "sea water": Refraction(1.341, 0.002)}

# The distortion is fitted at so many places from the middle to the corner, and may be off by this share there: beyond
# it, three coefficients are too few for so wide a lens.
FITTED_PLACES = 60
MAX_FIT_ERROR = 0.002


def behind_flat_port(model: CameraModel, medium: Medium, port_m: float) -> CameraModel:
    """Return the camera that sees under water as this one does behind a flat window.

    Args:
        model: The camera as it was calibrated in air.
        port_m: How far the window is in front of the lens's entrance pupil, about its front glass.

    Raises:
        CalibrationError: The lens is too wide to be described so.
    """
    if medium == "air":
        return model
    n, n_sigma = REFRACTIONS[medium]
    right, bottom = model.width_px - 1.0, model.height_px - 1.0
    corners = model.directions(np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]]))
    # The corner furthest from the middle, as r in water: the inverse of the formula above.
    air = float(np.hypot(*corners.T).max())
    r = np.linspace(0.0, air / math.sqrt(n**2 + (n**2 - 1) * air**2), FITTED_PLACES + 1)[1:]
    in_air = n * r / np.sqrt(1 - (n**2 - 1) * r**2)
    k1, k2, p1, p2, k3 = (*model.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    appearing = distorted(np.column_stack((in_air, np.zeros_like(r))), (k1, k2, 0.0, 0.0, k3))[:, 0] / n
    # Brown's radial polynomial of the longer lens: r' = r (1 + k1 r² + k2 r⁴ + k3 r⁶).
    powers = np.column_stack((r**2, r**4, r**6))
    radial = np.linalg.lstsq(powers, appearing / r - 1, rcond=None)[0]
    error = float(np.abs((1 + powers @ radial) * r - appearing).max() / appearing[-1])
    if not error < MAX_FIT_ERROR:
        angle_deg = 2 * math.degrees(math.atan(air))
        raise CalibrationError(
            f"a lens that sees {angle_deg:.0f} degrees from corner to corner cannot be described "
            f"behind a flat port: off by {error:.1%} at the corners; calibrate it under water, without medium",
            "medium",
        )
    return replace(
        model,
        fx_px=model.fx_px * n,
        fy_px=model.fy_px * n,
        # A decentring of the lens grows with the square of what it sees in air, and is now counted per n.
        distortion=(float(radial[0]), float(radial[1]), n * p1, n * p2, float(radial[2])),
        focal_relative_sigma=math.hypot(model.focal_relative_sigma, n_sigma / n),
        uncertainty=None,  # it is of the coefficients in air
        pupil_ahead_m=(n - 1) * port_m,
    )
