"""A detector that does not look: it asks the simulated world where the ball is."""

from __future__ import annotations

import math
import zlib
from typing import ClassVar

import numpy as np
from pydantic import Field

from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.config.units import Length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import check_image
from stadimeter.errors import ConfigError
from stadimeter.ranging.ball import BallShape
from stadimeter.simulation.camera import Silhouette, Vector, gaussian_pair, hits, lens, silhouette
from stadimeter.simulation.world import shared_world

# A stated diameter may differ from the world's by this share.
DIAMETER_TOLERANCE = 1e-3

_ANGLES = np.arange(16) * (2 * math.pi / 16)
_CIRCLE: Points = np.stack((np.cos(_ANGLES), np.sin(_ANGLES)), axis=1)


class IdealDetectorOptions(DriverOptions):
    """The options of a detector that looks at the simulated world instead of the picture."""

    needs_world: ClassVar = True
    needs_pixels: ClassVar = False

    diameter: Length | None = None
    """The ball's diameter; None takes the world's. Another than the world's is refused."""
    noise_px: float = Field(default=0.3, ge=0)
    """Standard deviation of the apparent diameter, and of each coordinate of the centre."""
    min_diameter_px: float = Field(default=3.0, gt=0)
    """A ball that appears smaller is not found."""

    def build(self, context: DriverContext) -> IdealDetector:
        """Return the detector."""
        return IdealDetector(self, context)


class IdealDetector:
    """Finds the world's ball as exactly as its options say, whatever the picture shows.

    The apparent diameter is that of the silhouette's minor axis, which is ``2 f r / sqrt(z² - r²)`` for a ball of
    radius ``r`` at the depth ``z``; the centre is the silhouette's. The noise follows from the world's seed, the
    target's name and the frame's number alone. Whether the ball is hidden is asked as of now, since a frame does not
    tell; everything else as of the frame's capture time.

    Raises:
        ConfigError: The run has no camera model or no world, or the diameter is not that of the world's ball.
    """

    def __init__(self, options: IdealDetectorOptions, context: DriverContext) -> None:
        self._target = context.name
        self._model = lens(context)
        self._world = shared_world(context)
        self._noise_px = options.noise_px
        self._min_diameter_px = options.min_diameter_px
        self._diameter_m = self._world.ball.diameter_m
        self._keys = (self._world.seed, zlib.crc32(context.name.encode()))
        _check_diameter(options.diameter, self._diameter_m, context.name)

    @property
    def target_shape(self) -> BallShape:
        """The ball's diameter."""
        return BallShape(diameter_m=self._diameter_m)

    def detect(
        self,
        frame: Frame,
        prediction: Prediction | None = None,  # noqa: ARG002 - the whole frame is searched
        *,
        lens: CameraModel | None = None,  # noqa: ARG002 - frames are seen through the lens of the simulated camera
    ) -> Detection:
        """Return where the world's ball is in a frame, of which only number, time and resolution matter.

        Raises:
            CalibrationError: The frame has another aspect than the lens.
            DriverError: The frame is older than the robot remembers its way.
        """
        check_image(frame)
        if self._world.faults.target_hidden:
            return self._not_found("the ball is hidden")
        model = self._model.scaled_to(frame.width_px, frame.height_px)
        ball_m = self._world.target_in_camera(frame.captured_at_s)
        if not _is_in_view(model, ball_m, self._diameter_m / 2):
            return self._not_found("the ball is out of view")
        seen = silhouette(model, ball_m, self._diameter_m / 2)
        border = _border(model, seen) if seen else "whole"
        if seen is None or border:
            return Detection(
                target=self._target,
                status=DetectionStatus.TRUNCATED,
                reason=f"cut off by the {border} border of the picture",
                centre_px=seen.centre_px if seen else (model.cx_px, model.cy_px),
            )
        return self._found(seen, frame.sequence)

    def _found(self, seen: Silhouette, sequence: int) -> Detection:
        grown, _ = gaussian_pair(*self._keys, sequence, 0)
        right, down = gaussian_pair(*self._keys, sequence, 1)
        true_px = 2 * seen.half_across_px[0]
        diameter_px = true_px + self._noise_px * grown
        if diameter_px < self._min_diameter_px:
            return self._not_found(f"a ball of {max(0.0, diameter_px):.1f} px, limit {self._min_diameter_px:.1f} px")
        scale = diameter_px / true_px
        shift = (self._noise_px * right, self._noise_px * down)
        return Detection(
            target=self._target,
            status=DetectionStatus.FOUND,
            outline_px=seen.outline_px(_CIRCLE, scale) + shift,
            centre_px=(seen.centre_px[0] + shift[0], seen.centre_px[1] + shift[1]),
            width_px=diameter_px,
            height_px=2 * seen.half_across_px[1] * scale,
            size_sigma_px=self._noise_px,
            quality=1.0,
        )

    def _not_found(self, reason: str) -> Detection:
        return Detection(target=self._target, status=DetectionStatus.NOT_FOUND, reason=reason)


def _is_in_view(model: CameraModel, ball_m: Vector, radius_m: float) -> bool:
    """Check whether the picture shows any of the ball: whether its ray that comes nearest to the ball hits it."""
    x, y, z = ball_m
    if z <= 0:
        return False
    nearest_px = (
        min(max(model.cx_px + model.fx_px * x / z, -0.5), model.width_px - 0.5),
        min(max(model.cy_px + model.fy_px * y / z, -0.5), model.height_px - 0.5),
    )
    return hits(model.direction(*nearest_px), ball_m, radius_m)


def _border(model: CameraModel, seen: Silhouette) -> str:
    """Return which borders the silhouette reaches, in words; an empty string if none."""
    left, top, right, bottom = seen.extent_px
    reached = {
        "left": left < 0,
        "top": top < 0,
        "right": right > model.width_px - 1,
        "bottom": bottom > model.height_px - 1,
    }
    return " and ".join(name for name, is_reached in reached.items() if is_reached)


def _check_diameter(stated_m: float | None, true_m: float, target: str) -> None:
    if stated_m is not None and abs(stated_m / true_m - 1) > DIAMETER_TOLERANCE:
        raise ConfigError(
            f"target '{target}': diameter is {stated_m:g} m, but the ball in [world] has {true_m:g} m; "
            "leave it out here, or set ball_diameter there"
        )
