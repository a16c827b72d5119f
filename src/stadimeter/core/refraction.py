"""A camera behind a flat window under water.

By Snell's law a ray that meets the window at the angle θa in air goes on at θw in water, sin θa = n sin θw. So a target
appears n times as large near the middle, and more towards the border: it is a longer lens with a pincushion distortion,
and is described as one. With r = tan θw,

    tan θa = n r / √(1 - (n² - 1) r²)

Rays in water seem to come from behind the pupil: they meet the window, at the distance d in front of it, at the height
d tan θa, and the line back crosses the axis at z = d (1 - tan θa / tan θw), near the axis (n - 1) d behind the pupil
(T. Treibitz et al., "Flat refractive geometry", 2012, section 3).
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.lens_distortion import distorted
from stadimeter.errors import CalibrationError

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
