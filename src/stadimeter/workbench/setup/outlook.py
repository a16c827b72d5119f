"""What the camera will be able to tell: the standard deviation of the distance, near and far, for this target."""

from __future__ import annotations

import math
from typing import Any

from stadimeter.app.detectors import build_detectors
from stadimeter.errors import ConfigError
from stadimeter.ranging.feasibility import expect, farthest_m
from stadimeter.workbench.setup.known import Known
from stadimeter.workbench.setup.target import chosen_target

WHOLE_SHARE = 0.9
"""Nearer than where a target fills this share of the picture's shorter side, it is cut off sooner or later."""

STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)
"""Distances that people think in, for each power of ten."""

ROWS_MAX = 9


def outlook(known: Known) -> dict[str, Any]:
    """Return a table of distances with what to expect there, as JSON has it.

    Raises:
        ConfigError: The camera is not calibrated yet.
    """
    if known.camera_model is None:
        raise ConfigError("the camera is not calibrated yet")
    (named,) = build_detectors([chosen_target(known)], None)
    shape, lens = named.detector.target_shape, known.camera_model.for_frame(known.frame)
    nearest_m = farthest_m(shape, lens, WHOLE_SHARE * min(lens.width_px, lens.height_px))
    reaches_m = farthest_m(shape, lens)
    rows = [expect(shape, lens, each) for each in (nearest_m, *_between(nearest_m, reaches_m), reaches_m)]
    return {
        "nearest_m": nearest_m,
        "farthest_m": reaches_m,
        "focal_sigma_share": lens.focal_relative_sigma,
        "rows": [
            {
                "distance_m": each.distance_m,
                "sigma_m": each.sigma_m,
                "noise_m": each.noise_m,
                "width_px": each.size_px,
            }
            for each in rows
        ],
    }


def _between(low_m: float, high_m: float) -> list[float]:
    """Return distances that people think in between two, not too many."""
    first, last = math.floor(math.log10(low_m)), math.ceil(math.log10(high_m))
    every = sorted({step * 10.0**power for power in range(first, last + 1) for step in STEPS})
    within = [each for each in every if 1.1 * low_m < each < high_m / 1.1]
    return within[:: 1 + len(within) // ROWS_MAX]
