"""A camera on the simulated robot."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from stadimeter.config.plugins import DriverContext, Options, Plugin
from stadimeter.config.units import Frequency
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.errors import CaptureTimeoutError, ConfigError, DeviceClosedError
from stadimeter.simulation.renderer import Renderer
from stadimeter.simulation.world import World, shared_world

TIMEOUT_S = 0.1
"""The time that a reader of a blocked camera waits."""


def _check_rate(rate_hz: float) -> float:
    if rate_hz == 0:
        raise ValueError("a rate of 0 Hz gives no frames; write one such as '30 Hz'")
    return rate_hz


class SimulatedCameraOptions(Options):
    """The table of a simulated camera in the configuration."""

    rate: Annotated[Frequency, AfterValidator(_check_rate)] = 30.0
    """Frames in a second."""
    render: bool = True
    """Whether to draw pictures. Without, every frame is black and costs nothing: for the detector ``ideal``."""
    noise: float = Field(default=2.0, ge=0, le=64)
    """Standard deviation of the sensor's noise in grey levels of 255."""


class SimulatedCamera:
    """A camera on the simulated robot, level and looking straight ahead.

    Its frames are at whole multiples of the frame time from when it was first opened; those that were not read in time
    are passed over. It honours the knobs ``camera_frozen`` and ``camera_blocked``. Frozen, it delivers the same old
    frame again and again, with its old number and time, as a stuck driver does.

    Raises:
        ConfigError: The run has no camera model or no world.
    """

    def __init__(self, options: SimulatedCameraOptions, context: DriverContext) -> None:
        self._name = context.name
        self._model = lens(context)
        self._world: World = shared_world(context)
        self._clock = context.clock
        self._rate_hz = options.rate
        self._blank = np.zeros((self._model.height_px, self._model.width_px, 3), np.uint8)
        self._blank.flags.writeable = False
        self._noise = options.noise if options.render else None
        self._renderer: Renderer | None = None
        self._is_open = False
        self._start_s: float | None = None
        self._sequence = -1
        self._newest: Frame | None = None

    @property
    def is_live(self) -> bool:
        """False: time passes as frames are read."""
        return False

    @property
    def remarks(self) -> tuple[str, ...]:
        """Nothing: there is no device that could refuse a setting."""
        return ()

    @property
    def not_for_motion(self) -> str:
        """An empty string: the capture times are exact."""
        return ""

    def open(self) -> None:
        """Make ready to read. Frames are numbered on if the camera was open before."""
        if self._noise is not None and self._renderer is None:
            self._renderer = Renderer(
                self._model, camera_height_m=self._world.camera_height_m, seed=self._world.seed, noise=self._noise
            )
        if self._start_s is None:
            self._start_s = self._clock.now_s()
        self._is_open = True

    def read(self) -> Frame:
        """Move the clock to the next frame's time and return that frame, or the previous one while it is frozen.

        Raises:
            CaptureTimeoutError: The camera is blocked; `TIMEOUT_S` have passed.
        """
        if not self._is_open or self._start_s is None:
            raise DeviceClosedError(f"the simulated camera '{self._name}' is not open")
        if self._world.faults.camera_blocked:
            self._clock.sleep_until_s(self._clock.now_s() + TIMEOUT_S)
            raise CaptureTimeoutError(f"the simulated camera is blocked: no frame for {TIMEOUT_S * 1e3:.0f} ms")
        self._sequence = self._next_sequence(self._start_s)
        captured_at_s = self._start_s + (self._sequence + 1) / self._rate_hz
        self._clock.sleep_until_s(captured_at_s)
        if self._newest is None or not self._world.faults.camera_frozen:
            self._newest = Frame(self._picture(captured_at_s), captured_at_s, self._sequence)
        return self._newest

    def close(self) -> None:
        """Be closed. May be called any number of times."""
        self._is_open = False

    def _next_sequence(self, start_s: float) -> int:
        """Return the number of the first frame that is not in the past and was not read yet."""
        gone = math.ceil((self._clock.now_s() - start_s) * self._rate_hz - 1e-6) - 1
        return max(self._sequence + 1, gone)

    def _picture(self, time_s: float) -> Image:
        if self._renderer is None:
            return self._blank
        ball_m = None if self._world.faults.target_hidden else self._world.target_in_camera(time_s)
        heading_rad = self._world.robot.pose_at(time_s).heading_rad
        return self._renderer.render(ball_m, self._world.ball.diameter_m / 2, heading_rad, self._sequence)


def lens(context: DriverContext) -> CameraModel:
    """Return the camera model of a run, or raise a `ConfigError` if it has none."""
    if context.camera_model is None:
        raise ConfigError(f"'{context.name}' is simulated and needs a lens to look through; set model in [camera]")
    return context.camera_model


PLUGIN = Plugin(SimulatedCameraOptions, SimulatedCamera, needs_world=True)
