"""The way a camera turns directions into pixels."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.frame import CHROMA_PITCH_PX, SUBSAMPLINGS, Frame, Optics, Subsampling
from stadimeter.core.lens_distortion import check_coefficients, distorted, distorted_direction, undistorted
from stadimeter.core.lens_uncertainty import LensUncertainty, SharesByPlace, sensitivities
from stadimeter.errors import CalibrationError

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
    """

    method: str = ""
    date: str = ""
    notes: tuple[str, ...] = ()


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
