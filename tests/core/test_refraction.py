"""A camera under water, against rays that are traced by Snell's law."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.config.camera_file import camera_model_from_table
from stadimeter.core.camera_model import REFRACTIONS, CameraModel, behind_flat_port
from stadimeter.errors import CalibrationError, ConfigError

AIR = CameraModel.with_focal_length(600.0, 640, 480)
PIXELS = np.array([[x, y] for x in (0.0, 100.0, 319.5, 500.0, 639.0) for y in (0.0, 239.5, 479.0)])


def traced(model, pixels, index):
    """Return where pixels look to in water: each ray turned at the window, so that sines are as the index."""
    air = model.directions(pixels)
    sine_water = np.sin(np.arctan(np.hypot(*air.T))) / index
    tangent = sine_water / np.sqrt(1 - sine_water**2)
    return air / np.maximum(np.hypot(*air.T), 1e-12)[:, None] * tangent[:, None]


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, -0.0005, 0.0)])
@pytest.mark.parametrize("medium", ["water", "sea water"])
def test_pixels_look_where_snell_s_law_sends_them(distortion, medium):
    model = replace(AIR, distortion=distortion)
    wet = behind_flat_port(model, medium, 0.0)
    off_px = (wet.directions(PIXELS) - traced(model, PIXELS, REFRACTIONS[medium].n)) * wet.fx_px
    assert np.abs(off_px).max() < 0.3
    assert np.abs(off_px[np.hypot(*(PIXELS - 300).T) < 150]).max(initial=0) < 0.1


def test_air_changes_nothing():
    assert behind_flat_port(AIR, "air", 0.1) is AIR


def test_a_window_ahead_of_the_lens_moves_the_point_that_rays_come_from():
    index = REFRACTIONS["water"].n
    port_m, angle = 0.02, 1e-4
    # A ray near the axis, from the pupil to the window and on into the water, at a target 1 m from the pupil.
    at_window_m = port_m * math.tan(angle)
    beyond = math.tan(math.asin(math.sin(angle) / index))
    height_m = at_window_m + (1 - port_m) * beyond
    from_where_it_seems_to_come_m = height_m / beyond
    wet = behind_flat_port(AIR, "water", port_m)
    assert from_where_it_seems_to_come_m - wet.pupil_ahead_m == pytest.approx(1.0, abs=1e-6)


def test_the_index_is_in_the_standard_deviation():
    assert behind_flat_port(AIR, "water", 0.0).focal_relative_sigma == pytest.approx(0.002 / 1.334, rel=0.01)


def test_a_lens_that_is_too_wide_is_refused():
    wide = CameraModel.with_focal_length(180.0, 640, 480)
    with pytest.raises(CalibrationError, match="cannot be described behind a flat port"):
        behind_flat_port(wide, "water", 0.0)


def test_a_camera_file_names_the_medium():
    table = {"width_px": 640, "height_px": 480, "fx_px": 600.0, "medium": "water", "port_m": 0.01}
    model = camera_model_from_table(table)
    assert model.fx_px == pytest.approx(600 * 1.334)
    with pytest.raises(ConfigError, match="medium"):
        camera_model_from_table(table | {"medium": "oil"})
