"""The sections of a configuration that belong to no driver. Their defaults are those of `stadimeter.core.plan`."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from stadimeter.config.units import (
    DURATIONS_S,
    Acceleration,
    Duration,
    Speed,
    TurnAcceleration,
    TurnRate,
    as_written,
    parse_duration,
)
from stadimeter.core import plan

LEASE_S = 0.3
"""How old the frame behind a command may grow before the output goes to its safe state."""

_LEVEL = plan.LevelOutput(name="")
_BASE = plan.BaseOutput(name="")
_TRACKING = plan.Tracking()
_SAFETY = plan.Safety()

SECTIONS = (
    "camera", "targets", "actuators", "base", "messenger", "notifiers", "world", "tracking", "safety", "rules", "tests",
)  # fmt: skip
"""Every section that a configuration may have."""


class Section(BaseModel):
    """A table of the configuration. Unknown keys are errors, numbers are finite, and nothing is converted silently."""

    written_elsewhere: ClassVar[dict[str, str]] = {}
    """Keys that people try here, and what to write in their place."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


def _above_zero(text: object) -> float:
    value = parse_duration(text)
    if value == 0:
        raise ValueError(f"{text!r} is not a duration above zero")
    return value


DurationAboveZero = Annotated[float, BeforeValidator(_above_zero), as_written(DURATIONS_S, "250 ms")]
AfterFault = Literal["reopen", "stay_off"]
Share = Annotated[float, Field(ge=0, le=1)]


class CameraTable(Section):
    """The keys that every camera has, whatever its driver."""

    model: Any = None
    """The camera file, relative to the configuration, or the same keys as a table."""


class TargetTable(Section):
    """The keys that every target has, whatever its detector."""

    max_closing_speed: Speed | None = None
    """In m/s; how fast it comes at most. `check` says which rules would be too late for that. None if it is not
    known."""


class ActuatorTable(Section):
    """The keys that every actuator has, whatever its driver."""

    safe: Share = _LEVEL.safe_level
    """The level when nothing asks for another, or nothing may."""
    lease: DurationAboveZero = LEASE_S
    """In seconds."""
    rise_per_s: Annotated[float, Field(gt=0)] | None = None
    """Largest change of the level upwards in a second; None for no limit."""
    fall_per_s: Annotated[float, Field(gt=0)] | None = None
    """Largest change downwards."""
    combine: Literal["max", "min"] = _LEVEL.combine
    """Of several rules that ask for it with one priority, which level counts."""
    after_fault: AfterFault = "reopen"
    """What becomes of it when its driver failed: opened again, or off for the rest of the run."""

    def to_plan(self, name: str) -> plan.LevelOutput:
        """Return the actuator as the core sees it."""
        return plan.LevelOutput(
            name=name,
            safe_level=self.safe,
            rise_per_s=_LEVEL.rise_per_s if self.rise_per_s is None else self.rise_per_s,
            fall_per_s=_LEVEL.fall_per_s if self.fall_per_s is None else self.fall_per_s,
            combine=self.combine,
        )


class BaseTable(Section):
    """The keys that every base has, whatever its driver."""

    max_speed: Speed = _BASE.linear_max_mps
    """In m/s, either way."""
    max_turn_rate: TurnRate = _BASE.angular_max_radps
    """In rad/s."""
    acceleration: Acceleration = _BASE.linear_accel_mps2
    """In m/s²."""
    turn_acceleration: TurnAcceleration = _BASE.angular_accel_radps2
    """In rad/s²."""
    lease: DurationAboveZero = LEASE_S
    """In seconds."""
    combine: Literal["most_restrictive"] = _BASE.combine
    """What counts of several rules that ask for it with one priority: the slower of each speed."""
    after_fault: AfterFault = "reopen"
    """What becomes of it when its driver failed: opened again, or off for the rest of the run."""

    def to_plan(self, name: str) -> plan.BaseOutput:
        """Return the base as the core sees it."""
        return plan.BaseOutput(
            name=name,
            linear_max_mps=self.max_speed,
            angular_max_radps=self.max_turn_rate,
            linear_accel_mps2=self.acceleration,
            angular_accel_radps2=self.turn_acceleration,
            combine=self.combine,
        )


class MessengerTable(Section):
    """The keys that every messenger has, whatever its driver: none."""


class NotifierTable(Section):
    """The keys that every notifier has, whatever its driver: none."""


class WorldTable(Section):
    """The keys that every simulated world has: none."""


class TrackingTable(Section):
    """How targets are tracked; see `stadimeter.core.plan.Tracking`."""

    acceleration: Acceleration = _TRACKING.acceleration_mps2
    """In m/s²."""
    autocorrelation: Annotated[float, Field(ge=0, lt=1)] = _TRACKING.correlation
    """Of the measurement noise from one frame to the next."""
    gate_sigmas: Annotated[float, Field(gt=0)] = _TRACKING.gate_sigmas
    """A measurement further than this from the prediction is an outlier."""
    outliers_max: Annotated[int, Field(ge=1)] = _TRACKING.outliers_max
    """After this many in a row the track starts anew."""
    confirm_frames: Annotated[int, Field(ge=1)] = _TRACKING.confirm_frames
    """How many frames a new target must be measured in."""
    coast: Duration = _TRACKING.coast_s
    """In seconds."""
    noise_factor: Annotated[float, Field(gt=0)] = _TRACKING.noise_factor
    """How many times larger than stated the noise of measurements is."""
    noise_factor_max: Annotated[float, Field(ge=1)] = _TRACKING.noise_factor_max
    """How many times larger than that a target's noise may be found to be."""

    def to_plan(self) -> plan.Tracking:
        """Return the section as the core sees it."""
        return plan.Tracking(
            acceleration_mps2=self.acceleration,
            correlation=self.autocorrelation,
            gate_sigmas=self.gate_sigmas,
            outliers_max=self.outliers_max,
            confirm_frames=self.confirm_frames,
            coast_s=self.coast,
            noise_factor=self.noise_factor,
            noise_factor_max=self.noise_factor_max,
        )


class SafetyTable(Section):
    """When outputs may act; see `stadimeter.core.plan.Safety`."""

    max_frame_age: DurationAboveZero = _SAFETY.max_frame_age_s
    """In seconds."""
    good_frames: Annotated[int, Field(ge=1)] = _SAFETY.good_frames
    """How many fresh frames in a row are needed."""

    def to_plan(self) -> plan.Safety:
        """Return the section as the core sees it."""
        return plan.Safety(max_frame_age_s=self.max_frame_age, good_frames=self.good_frames)
