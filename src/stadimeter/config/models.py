"""The sections of a configuration that belong to no driver. Their defaults are those of `stadimeter.core.plan`."""

import math
from datetime import tzinfo
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator, WithJsonSchema, model_validator

from stadimeter.config import units
from stadimeter.config.addresses import check_page_address
from stadimeter.config.findings import did_you_mean
from stadimeter.core import plan
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import HEIGHT_SIGMA_M, TILT_SIGMA_RAD, Footing, Mount
from stadimeter.core.sensor_fusion import SensorPair
from stadimeter.core.tracking.transverse import Viewpoint
from stadimeter.operator_actions import OperatorAction

# How old the frame behind a command may grow before the output goes to its safe state.
LEASE_S = 0.3

# The longest that a run keeps by itself: some 1 GB at 30 Hz.

# The longest that a long press may have to be: a button that is held for much longer is stuck.
HOLD_MAX_S = 5.0

_LEVEL = plan.LevelOutput(name="")
_BASE = plan.BaseOutput(name="")
_TRACKING = plan.Tracking()
_SAFETY = plan.Safety()

# Every section that a configuration may have.
SECTIONS = (
    "camera", "second_camera", "targets", "actuators", "base", "sensors", "status_led", "buttons", "messenger",
    "notifiers", "world", "tracking", "safety", "mounting", "web", "recording", "timeline", "black_box", "place",
    "landmarks", "figures", "rules", "tests",
)  # fmt: skip


class Section(BaseModel):
    """A table of the configuration. Unknown keys are errors, numbers are finite, and nothing is converted silently."""

    written_elsewhere: ClassVar[dict[str, str]] = {}
    """Keys that people try here, and what to write in their place."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


def _above_zero(text: object) -> float:
    value = units.parse_duration(text)
    if value == 0:
        raise ValueError(f"{text!r} is not a duration above zero")
    return value


DurationAboveZero = Annotated[float, BeforeValidator(_above_zero), units.as_written(units.DURATIONS_S, "250 ms")]
AfterFault = Literal["reopen", "stay_off"]
Share = Annotated[float, Field(ge=0, le=1)]


class MountTable(Section):
    """The place of the camera on the robot: x ahead and y left of its middle. Its height and tilt are in `[camera]`."""

    written_elsewhere: ClassVar[dict[str, str]] = {
        "z": 'height = "30 cm" in [camera]',
        "height": 'height = "30 cm" in [camera]',
        "tilt": 'tilt = "-12 deg" in [camera]',
    }

    x: units.Coordinate = 0.0
    """In metres; how far the lens is ahead of the middle of the robot."""
    y: units.Coordinate = 0.0
    """In metres; how far it is to the left of it."""
    yaw: units.Angle = 0.0
    """In radians; how far it is turned to the left."""


class CameraTable(Section):
    """The keys that every camera has, whatever its driver.

    A stream does not say how old its pictures are: nothing moves on it until its `latency` is stated. Passwords in an
    address belong into the file of `device_file`.
    """

    model: Any = None
    """The camera file, relative to the configuration, or the same keys as a table."""
    height: units.StatedLengthOrZero | None = None
    """In metres; how high it is above the floor, and how well that is known. None if it is not."""
    tilt: units.StatedAngle = units.Stated(0.0)
    """In radians; how far it looks up from level, below zero for down, and how well that is known."""

    mount: MountTable | None = None
    """Where it sits on a robot; None for none."""

    def to_plan(self, lens: CameraModel | None) -> Viewpoint:
        """Return from where the camera looks as the core sees it."""
        height_m = None if self.height is None else self.height.value
        return Viewpoint(height_m=height_m, tilt_rad=self.tilt.value, lens=lens, mount=self.on_robot() or Mount())

    def on_robot(self) -> Mount | None:
        """Return where the camera sits on a robot; None where it sits on none."""
        if self.mount is None:
            return None
        z_m = 0.0 if self.height is None else self.height.value
        at = self.mount
        return Mount(x_m=at.x, y_m=at.y, z_m=z_m, yaw_rad=at.yaw, tilt_rad=self.tilt.value)

    def footing(self, target: "TargetTable") -> Footing | None:
        """Return the camera above the floor and what of a target is on it; None of one that need not be on it."""
        if target.on_floor is False or self.height is None:
            return None
        centre = target.on_floor if isinstance(target.on_floor, units.Stated) else None
        return Footing(
            height_m=self.height.value,
            height_sigma_m=HEIGHT_SIGMA_M if self.height.sigma is None else self.height.sigma,
            tilt_rad=self.tilt.value,
            tilt_sigma_rad=TILT_SIGMA_RAD if self.tilt.sigma is None else self.tilt.sigma,
            centre_m=None if centre is None else centre.value,
            centre_sigma_m=0.0 if centre is None else centre.sigma or 0.0,
        )


class SecondCameraTable(Section):
    """The keys of a second camera, whatever its driver, which looks at the targets from beside the first one."""

    stereo: units.FilePath
    """The stereo file, relative to the configuration: both lenses, and where this camera is."""


def _on_floor(value: object) -> bool | units.Stated:
    """Read whether a target is on the floor, or how high its centre is above it."""
    if isinstance(value, bool):
        return value
    if value == "lying":
        return units.Stated(0.0)
    try:
        return units.parse_known(value, units.parse_length_or_zero, units.parse_length_or_zero)
    except ValueError as error:
        raise ValueError(f"{error}; or write true for what stands on the floor, 'lying' for what lies flat") from error


OnFloorText = Annotated[
    bool | units.Stated,
    PlainValidator(_on_floor),
    WithJsonSchema({"anyOf": [{"type": "boolean"}, {"type": "string"}], "examples": ["lying"]}),
]


class TargetTable(Section):
    """The keys that every target has, whatever its detector.

    Several of one kind have one table: with `count`, or `ids` of tags, `[targets.balls]` means `balls-1`, `balls-2` and
    so on, each a target of its own. `balls-nearest` and `balls-farthest` are targets as well. A rule on `balls` is
    on any of them: the nearest counts.
    """

    on_floor: OnFloorText = False
    """Whether it stands on the floor; `"lying"` for what lies flat on it, or how high its centre is above it."""


class ActuatorTable(Section):
    """The keys that every actuator has, whatever its driver."""

    safe: Share = _LEVEL.safe_level
    """The level when nothing asks for another, or nothing may."""
    lease: DurationAboveZero = LEASE_S
    """For how long a command holds without a newer one; then the output goes to its safe value."""
    rise_per_s: Annotated[float, Field(gt=0)] = _LEVEL.rise_per_s
    """Largest change of the level upwards in a second; no limit where it is left out."""
    fall_per_s: Annotated[float, Field(gt=0)] = _LEVEL.fall_per_s
    """Largest change downwards."""
    combine: Literal["max", "min"] = _LEVEL.combine
    """Of several rules that ask for it with one priority, which level counts."""
    after_fault: AfterFault = "reopen"
    """What becomes of it when its driver failed: opened again, or off for the rest of the run."""

    def to_plan(self, name: str) -> plan.LevelOutput:
        """Return the actuator as the core sees it."""
        values = self.model_dump(exclude={"safe", "lease", "after_fault"})
        return plan.LevelOutput(name=name, safe_level=self.safe, **values)


class BaseTable(Section):
    """The keys that every base has, whatever its driver."""

    linear_max_mps: units.Speed = Field(default=_BASE.linear_max_mps, alias="max_speed")
    """No faster, forwards or backwards."""
    angular_max_radps: units.TurnRate = Field(default=_BASE.angular_max_radps, alias="max_turn_rate")
    """No faster, in either direction."""
    linear_accel_mps2: units.Acceleration = Field(default=_BASE.linear_accel_mps2, alias="acceleration")
    """The largest change of speed in a second."""
    angular_accel_radps2: units.TurnAcceleration = Field(default=_BASE.angular_accel_radps2, alias="turn_acceleration")
    """The largest change of the rate of turn in a second."""
    linear_jerk_mps3: units.Jerk = Field(default=_BASE.linear_jerk_mps3, alias="jerk")
    """In m/s³; 0 for no limit. The rate of turn has as long to reach its acceleration."""
    lease: DurationAboveZero = LEASE_S
    """For how long a command holds without a newer one; then the base stops."""
    after_fault: AfterFault = "reopen"
    """What becomes of it when its driver failed: opened again, or off for the rest of the run."""

    def to_plan(self, name: str) -> plan.BaseOutput:
        """Return the base as the core sees it."""
        return plan.BaseOutput(name=name, **self.model_dump(exclude={"lease", "after_fault"}))


class SensorTable(Section):
    """The keys that every range sensor has, whatever its driver. Rules may name it as a target.

    Ultrasound misses what is soft or slanted, a laser what is black or of glass: a sensor does not replace a bumper.
    """

    bearing: units.Angle = 0.0
    """In radians; where it looks, positive to the right of the camera."""
    ahead: units.Coordinate = 0.0
    """In metres; how far before the camera it sits, along its beam; below zero for behind."""
    stop_below: units.Length | None = None
    """In metres; while something is nearer, and while the sensor is silent, the base stands, whatever rules want. None
    for never."""
    confirms: str = ""
    """The target that it measures too, while that is within `beam`; empty for none."""
    to_centre: units.LengthOrZero = 0.0
    """In metres; from the surface that it sees to the centre of that target: the radius of a ball."""
    beam: units.AngleOrZero = math.radians(15)
    """In radians; the full width of its beam."""

    def to_plan(self, name: str) -> SensorPair:
        """Return the sensor and the target that it confirms as the core sees them."""
        return SensorPair(sensor=name, target=self.confirms, half_beam_rad=self.beam / 2, radius_m=self.to_centre)


if TYPE_CHECKING:
    ButtonAction = str
else:
    ButtonAction = Literal[tuple(action.value for action in OperatorAction if not action.needs_value)]
"""The name of an operator action."""

STOP = OperatorAction.STOP_OUTPUTS.value


class ButtonTable(Section):
    """The keys that every button has, whatever its driver: what it asks of alarms, or of every output.

    A press acts when the button is let go; `stop-outputs` does so as soon as it is down. A button is no emergency stop,
    which cuts the supply.
    """

    press: ButtonAction = "acknowledge"
    """What a short press does, when it is let go; but `stop-outputs` as soon as it is down."""
    hold: ButtonAction | None = None
    """What a long press does; None for the same as a short one."""
    hold_for: Annotated[units.Duration, Field(ge=1.0, le=HOLD_MAX_S)] = 2.0
    """In seconds; how long it must be held down for a long press."""
    shelve_for: DurationAboveZero | None = None
    """In seconds; how long `shelve` lasts. None for as long as each rule allows."""
    rule: str = ""
    """The alarm that it is for; empty for every alarm."""

    @model_validator(mode="after")
    def _means_something(self) -> Self:
        given = self.model_fields_set
        if "hold_for" in given and self.hold is None:
            raise ValueError("hold_for has a meaning only beside hold; leave it out, or say what a long press does")
        if "shelve_for" in given and "shelve" not in {self.press, self.hold}:
            raise ValueError('shelve_for has a meaning only where the button shelves; write hold = "shelve"')
        if self.hold == STOP or (self.press == STOP and self.hold is not None):
            raise ValueError(f'a button stops outputs as soon as it is down: write press = "{STOP}" without hold')
        of_outputs = [action.value for action in OperatorAction if action.is_on_outputs]
        if self.rule and {*of_outputs} & {self.press, self.hold}:
            raise ValueError(f"{', '.join(of_outputs)} concern no rule: leave out rule")
        return self


class WebTable(Section):
    """The page on which a browser sees, sets up and operates the run."""

    written_elsewhere: ClassVar[dict[str, str]] = {
        "password": "`stadimeter web CONFIG --set-password`: the configuration holds no password"
    }

    port: Annotated[int, Field(ge=1, le=65535)] = 8080
    """The port on which it listens."""
    host: Annotated[str, Field(min_length=1)] | None = None
    """The address on which it listens. By default this computer's own, and every address once a password is set."""
    certificate: units.FilePath | None = None
    """The certificate for https, a PEM file; with `key`."""
    key: units.FilePath | None = None
    """The key of the certificate, a PEM file."""
    password_file: units.FilePath | None = None
    """Where the hashes of passwords are. By default beside the configuration, or with the state of the service."""
    allowed_hosts: list[Annotated[str, Field(min_length=1)]] = []
    """Other names under which browsers may find this computer, such as that of a proxy."""
    others: list[Annotated[str, BeforeValidator(check_page_address)]] = []
    """The pages of other cameras, such as ``"http://garage.local:8080"``; their alarms are shown with this one's."""
    others_tokens: units.FilePath | None = None
    """A file with the tokens of those that have passwords: on each line an address and its token."""

    @model_validator(mode="after")
    def _check_certificate(self) -> Self:
        if (self.certificate is None) is not (self.key is None):
            raise ValueError("certificate and key belong together; give both, or none")
        return self


class TrackingTable(Section):
    """The way targets are tracked; see `stadimeter.core.plan.Tracking`."""

    acceleration_mps2: units.Acceleration = Field(default=_TRACKING.acceleration_mps2, alias="acceleration")
    """How abruptly targets change their speed."""
    autocorrelation: Annotated[float, Field(ge=0, lt=1)] = _TRACKING.autocorrelation
    """How much the noise of a frame is like that of the frame before, at most."""
    confirm_frames: Annotated[int, Field(ge=1)] = _TRACKING.confirm_frames
    """How many frames a new target must be measured in."""
    coast_s: units.Duration = Field(default=_TRACKING.coast_s, alias="coast")
    """For how long a prediction stands in for a target that is not seen; then it is lost."""
    noise_factor: Annotated[float, Field(gt=0)] = _TRACKING.noise_factor
    """How many times larger than stated the noise of measurements is."""

    def to_plan(self) -> plan.Tracking:
        """Return the section as the core sees it."""
        return plan.Tracking(**dict(self))


class SafetyTable(Section):
    """The conditions on which outputs may act; see `stadimeter.core.plan.Safety`."""

    max_frame_age: DurationAboveZero = _SAFETY.max_frame_age_s
    """A frame that is older moves nothing."""
    good_frames: Annotated[int, Field(ge=1)] = _SAFETY.good_frames
    """How many fresh frames in a row are needed."""
    arm: Literal["at-start", "by-command", "by-button"] = _SAFETY.arm
    """What lets outputs act at all: the start of the run, an operator's command, or a push button."""
    liveness: bool = _SAFETY.liveness
    """Whether the picture must flow while the base drives. False for a camera that does not ride on the base."""

    watchdog: DurationAboveZero | None = None
    """A program whose outputs act on older data hangs, and is ended; by default 0.7 s beyond the longest lease."""

    def to_plan(self) -> plan.Safety:
        """Return the section as the core sees it."""
        return plan.Safety(
            max_frame_age_s=self.max_frame_age,
            good_frames=self.good_frames,
            arm=self.arm,
            watchdog_s=self.watchdog,
            liveness=self.liveness,
        )


def _time_zone(name: object) -> object:
    import zoneinfo  # noqa: PLC0415 - most configurations name none

    if isinstance(name, str) and name not in (known := zoneinfo.available_timezones()):
        hint = did_you_mean(name, known) or "write it such as 'Europe/Berlin'"
        raise ValueError(f"there is no time zone {name!r}; {hint}")
    return name


class PlaceTable(Section):
    """The place of the computer, for schedules."""

    latitude: Annotated[float, Field(ge=-90, le=90)] | None = None
    """In degrees, north of the equator positive."""
    longitude: Annotated[float, Field(ge=-180, le=180)] | None = None
    """In degrees, east of Greenwich positive."""
    time_zone: Annotated[str, BeforeValidator(_time_zone)] | None = None
    """Its name, such as ``Europe/Berlin``; None for that of the computer."""

    @property
    def zone(self) -> tzinfo | None:
        """The time zone; None for that of the computer."""
        from zoneinfo import ZoneInfo  # noqa: PLC0415 - most configurations name none

        return None if self.time_zone is None else ZoneInfo(self.time_zone)
