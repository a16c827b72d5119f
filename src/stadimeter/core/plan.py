"""What the configuration declares, as the core sees it: in SI units, checked, and fixed for a run."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct, field
from msgspec.structs import force_setattr

from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.discrete import ScheduleCondition
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.summary import RememberedFigure
from stadimeter.core.rule import AlarmRule, AnyRule
from stadimeter.core.sensor_fusion import SensorPair


class LevelOutput(Struct, frozen=True, kw_only=True):
    """An actuator, as the core sees it.

    Attributes:
        safe_level: The level when nothing asks for another, or nothing may.
        rise_per_s: Largest change of the level upwards in a second; infinite for none.
        fall_per_s: Largest change downwards.
        combine: Of several rules that ask for it with one priority, which level counts: the highest or the
            lowest.
    """

    name: str
    safe_level: float = 0.0
    rise_per_s: float = float("inf")
    fall_per_s: float = float("inf")
    combine: Literal["max", "min"] = "max"


class BaseOutput(Struct, frozen=True, kw_only=True):
    """A base, as the core sees it. Its safe value is to stand still.

    Attributes:
        linear_max_mps: Largest speed, either way.
        angular_max_radps: Largest rate of turn, and of tilt.
        linear_accel_mps2: Largest change of speed. Slowing down for safety is not limited.
        angular_accel_radps2: Largest change of the rate of turn, and of tilt where that grows.
        linear_jerk_mps3: Largest change of the change of speed; of the rate of turn it is in proportion.
        track_width_m: Distance between its wheels, for odometry; None where it is not known.
        tilts: Whether its camera tilts.
        combine: Of several rules that ask for it with one priority, the slower of each speed counts.
    """

    name: str
    linear_max_mps: float = 0.5
    angular_max_radps: float = 1.5
    linear_accel_mps2: float = 0.5
    angular_accel_radps2: float = 4.0
    linear_jerk_mps3: float = 5.0
    track_width_m: float | None = None
    tilts: bool = False
    combine: Literal["most_restrictive"] = "most_restrictive"


Output = LevelOutput | BaseOutput


class Tracking(Struct, frozen=True, kw_only=True):
    """How targets are tracked.

    Attributes:
        acceleration_mps2: Standard deviation of the target's acceleration that the filter expects.
        autocorrelation: Autocorrelation of the measurement noise from one frame to the next, 0 to below 1.
        gate_sigmas: A measurement further than this from the prediction is an outlier.
        outliers_max: After this many outliers in a row the target is taken to have jumped, and the track starts anew.
        confirm_frames: How many frames a new target must be measured in before it counts.
        coast_s: For how long a prediction stands in for measurements.
        noise_factor: How many times larger than stated the noise of measurements is, to begin with.
        noise_factor_max: How many times larger than that it may be found to be; 1 for not learning.
    """

    acceleration_mps2: float = 2.0
    autocorrelation: float = 0.6
    gate_sigmas: float = 4.0
    outliers_max: int = 5
    confirm_frames: int = 2
    coast_s: float = 0.3
    noise_factor: float = 1.0
    noise_factor_max: float = 6.0


class Safety(Struct, frozen=True, kw_only=True):
    """When outputs may act.

    Attributes:
        max_frame_age_s: A frame older than this moves nothing.
        good_frames: How many fresh frames in a row are needed at the start, and after frames were stale.
        arm: What lets outputs act at all: the start of the run itself; an operator's command; or a push button, so
            that a person stands beside what will move.
        watchdog_s: How old the data may grow on which an output acts, before the watchdog process ends the program;
            None for a while after the longest lease.
        liveness: Whether the picture must show that the base drives, where the camera can; see `core.liveness`.
    """

    max_frame_age_s: float = 0.2
    good_frames: int = 3
    arm: Literal["at-start", "by-command", "by-button"] = "at-start"
    watchdog_s: float | None = None
    liveness: bool = True


class Plan(Struct, frozen=True, kw_only=True):
    """Everything that is fixed for a run."""

    targets: tuple[str, ...]
    rules: tuple[AnyRule, ...] = ()
    outputs: tuple[Output, ...] = ()
    tracking: Tracking = field(default_factory=Tracking)
    safety: Safety = field(default_factory=Safety)
    sensor_pairs: tuple[SensorPair, ...] = ()
    figures: tuple[RememberedFigure, ...] = ()

    def __post_init__(self) -> None:
        """Let figures hold, behind those with a name, what conditions sum up of other rules."""
        sums = [leaf.remembered for leaf in self._leaves() if isinstance(leaf, RememberedCondition) and leaf.rules]
        force_setattr(self, "figures", tuple(dict.fromkeys([*self.named_figures, *sums])))

    @property
    def named_figures(self) -> tuple[RememberedFigure, ...]:
        """The figures of the configuration, without what conditions sum up of other rules."""
        return tuple(figure for figure in self.figures if not figure.rules)

    @property
    def needs_wall_time(self) -> bool:
        """Whether any rule asks for the time of day, or any figure begins at one."""
        asks = any(isinstance(leaf, ScheduleCondition) for leaf in self._leaves())
        return asks or any(figure.window.from_second is not None for figure in self.figures)

    def _leaves(self) -> list[Leaf]:
        """Return the simple conditions of all alarms."""
        alarms = (rule for rule in self.rules if isinstance(rule, AlarmRule))
        conditions = (condition for rule in alarms for condition in (rule.condition, rule.suppress_when) if condition)
        return [leaf for condition in conditions for leaf in leaves(condition)]
