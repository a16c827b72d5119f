"""What a lens sees across: a guess from that, and words about a lens that was calibrated."""

from __future__ import annotations

import math

from msgspec.structs import replace

from stadimeter.config.units import parse_angle
from stadimeter.core.camera_model import CameraModel, Provenance
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError
from stadimeter.workbench.calibration.board_session import today

# Relative standard deviation of a focal length from a guessed width of the view.
GUESS_RELATIVE_SIGMA = 0.1

# A camera that sees more or less than this is unusual: a size or a distance may be in another unit than was meant.
MIN_VIEW_RAD, MAX_VIEW_RAD = math.radians(20), math.radians(130)


def guess_lens(frame: Frame, width: str) -> CameraModel:
    """Return the lens of a camera that sees an angle across its picture; a `ConfigError` if no camera does."""
    try:
        view_rad = parse_angle(width)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if not 0 < view_rad < math.radians(170):
        raise ConfigError(f"no camera sees {math.degrees(view_rad):g}° across; write it such as 60 deg")
    focal_px = frame.width_px / 2 / math.tan(view_rad / 2)
    return replace(
        CameraModel.with_focal_length(focal_px, frame.width_px, frame.height_px),
        focal_relative_sigma=GUESS_RELATIVE_SIGMA,
        provenance=Provenance(method=f"a guess: {math.degrees(view_rad):g} degrees across", date=today()),
    )


def describe_lens(model: CameraModel) -> str:
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
