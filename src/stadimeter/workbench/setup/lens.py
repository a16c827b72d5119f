"""The lens of the setup: from pictures at known distances, or guessed."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stadimeter.app.detectors import build_detectors
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import parse_length
from stadimeter.core.camera_model import CameraModel, Provenance
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.calibration import DISTANCE_RELATIVE_SIGMA, KnownDistance
from stadimeter.ranging.calibration_check import disagreement
from stadimeter.workbench.calibration.calibrating import check_lens_settings
from stadimeter.workbench.calibration.distance_fit import fit_distances, look_at_distance, remedy_words
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.setup.target import PLUS_OR_MINUS

# Relative standard deviation of a focal length from a guessed width of the view.
GUESS_RELATIVE_SIGMA = 0.1

# Nobody measures from a lens better than this share of a distance; and worse than that says nothing.
BEST_KNOWN, WORST_KNOWN = 0.001, 0.2

# A camera that sees more or less than this is unusual: a size or a distance may be in another unit than was meant.
MIN_VIEW_RAD, MAX_VIEW_RAD = math.radians(20), math.radians(130)


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureAt:
    """A picture in which the target's centre has a known depth."""

    path: Path
    depth_m: float
    relative_sigma: float = DISTANCE_RELATIVE_SIGMA


def parse_distance(text: str) -> tuple[float, float]:
    """Read a distance such as ``1 m``, or ``1 m ± 5 mm``; return it in metres, and how well it is known.

    Returns:
        The distance, and its standard deviation as a share of it: that of a tape, unless it is named.

    Raises:
        ValueError: It is no distance, or is not known better than to half of itself.
    """
    length, is_said, sigma = PLUS_OR_MINUS.sub("±", text).partition("±")
    distance_m = parse_length(length.strip())
    if not is_said:
        return distance_m, DISTANCE_RELATIVE_SIGMA
    share = parse_length(sigma.strip()) / distance_m
    if not 0 < share <= WORST_KNOWN:
        raise ValueError(f"{text!r}: a distance that is known to {share:.0%} of itself calibrates nothing")
    return distance_m, max(share, BEST_KNOWN)


def picture_at(folder: Path, text: str) -> PictureAt:
    """Read ``PICTURE@DISTANCE``; a `ConfigError` if it is none."""
    path, at, length = text.rpartition("@")
    if not (at and path):
        raise ConfigError(f"{text!r} does not say how far away the target is; write it such as 2ft.png@24in")
    try:
        depth_m, relative_sigma = parse_distance(length)
        return PictureAt(path=folder / Path(path).expanduser(), depth_m=depth_m, relative_sigma=relative_sigma)
    except ValueError as error:
        raise ConfigError(f"{text}: {error}") from error


def lens_from(pictures: Sequence[PictureAt], choice: DriverChoice) -> tuple[CameraModel, tuple[str, ...]]:
    """Find out the focal length from pictures, and return what a person should know about them.

    Raises:
        CalibrationError: The target is not found in a picture, or no lens explains what was seen.
        PictureError: A picture cannot be read.
    """
    notes = check_lens_settings([each.path for each in pictures])
    fit = fit_distances(
        _known_distances(pictures, choice),
        _frame_of,
        [choice],
        date=today(),
        distance_relative_sigma=_relative_sigma(pictures),
        tone_curve="srgb",
    )
    _check_found(fit.left_out, choice)
    if fit.calibration is None:
        raise CalibrationError("no picture can be used")
    made = fit.calibration
    reads = [f"{Path(each.picture).name} reads {each.residual_share:+.1%}" for each in made.pictures]
    several = ("With this, " + ", ".join(reads) + ".",) if len(reads) > 1 else ()
    return made.camera_model, (*notes, *several)


def contradiction(pictures: Sequence[PictureAt], choice: DriverChoice) -> str:
    """Return how two of the pictures contradict each other; empty if they agree."""
    found = disagreement(_known_distances(pictures, choice), distance_relative_sigma=_relative_sigma(pictures))
    if found is None:
        return ""
    return (
        f"the two distances contradict each other by {abs(found.share):.1%}, and {found.allowed_share:.1%} is the most "
        "that tape and edges allow: does the focus move, is the size right, were both measured from the lens?"
    )


def _relative_sigma(pictures: Sequence[PictureAt]) -> float:
    """Return how well the distances are known: as well as the worst of them."""
    return max(each.relative_sigma for each in pictures)


def guess_lens(frame: Frame, view_rad: float) -> CameraModel:
    """Return the lens of a camera that sees an angle across its picture; a `ConfigError` if no camera does."""
    if not 0 < view_rad < math.radians(170):
        raise ConfigError(f"no camera sees {math.degrees(view_rad):g}° across; write it such as 60 deg")
    focal_px = frame.width_px / 2 / math.tan(view_rad / 2)
    return replace(
        CameraModel.with_focal_length(focal_px, frame.width_px, frame.height_px),
        focal_relative_sigma=GUESS_RELATIVE_SIGMA,
        provenance=Provenance(method=f"a guess: {math.degrees(view_rad):g} degrees across", date=today()),
    )


def lens_in_words(model: CameraModel) -> str:
    """Say what a lens sees, and whether that is unusual."""
    words = (
        f"Focal length {model.fx_px:.0f} px ± {model.focal_relative_sigma:.1%}: the camera sees "
        f"{math.degrees(_view_rad(model)):.0f}° across."
    )
    return f"{words} That is unusual: check the size and the distance, and their units." if is_unusual(model) else words


def is_unusual(model: CameraModel) -> bool:
    """Return whether hardly any camera has such a lens."""
    return not MIN_VIEW_RAD <= _view_rad(model) <= MAX_VIEW_RAD


def _view_rad(model: CameraModel) -> float:
    return 2 * math.atan(model.width_px / 2 / model.fx_px)


def today() -> str:
    """Return the date of today, as ISO 8601 has it."""
    return dt.datetime.now().astimezone().date().isoformat()


def _known_distances(pictures: Sequence[PictureAt], choice: DriverChoice) -> tuple[KnownDistance, ...]:
    (target,) = build_detectors([choice], None)
    known = tuple(look_at_distance(str(each.path), open_picture(each.path), each.depth_m, target) for each in pictures)
    _check_found(known, choice)
    return known


def _check_found(known: Sequence[KnownDistance], choice: DriverChoice) -> None:
    for each in known:
        if each.detection.status is not DetectionStatus.FOUND:
            remedy = remedy_words(each, _frame_of(each.picture), choice)
            raise CalibrationError(f"{each.picture}: the target is not found whole: {each.detection.reason}{remedy}")


def _frame_of(name: str) -> Frame:
    return open_picture(Path(name))
