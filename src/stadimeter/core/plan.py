"""The declarations of the configuration, as the core sees them: in SI units, checked, and fixed for a run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from msgspec import Struct, field
from msgspec.structs import force_setattr

from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.remembered import RememberedCondition, RememberedFigure
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.rule import AnyRule, ReportRule, conditions_of
from stadimeter.core.sensor_fusion import SensorPair
from stadimeter.core.tracking.life_cycle import NearestOf
from stadimeter.core.tracking.motion import Tracking
from stadimeter.core.tracking.transverse import Viewpoint

__all__ = ["BaseOutput", "LevelOutput", "Output", "Plan", "Safety", "Tracking"]


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


class Safety(Struct, frozen=True, kw_only=True):
    """The conditions on which outputs may act.

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
    """Everything that is fixed for a run.

    Attributes:
        targets: What rules may watch: what is measured, and behind it those of `nearest`.
        nearest: The targets that are the nearest or the farthest of several.
    """

    targets: tuple[str, ...]
    rules: tuple[AnyRule, ...] = ()
    outputs: tuple[Output, ...] = ()
    tracking: Tracking = field(default_factory=Tracking)
    safety: Safety = field(default_factory=Safety)
    sensor_pairs: tuple[SensorPair, ...] = ()
    viewpoint: Viewpoint = Viewpoint()
    figures: tuple[RememberedFigure, ...] = ()
    nearest: tuple[NearestOf, ...] = ()

    def __post_init__(self) -> None:
        """Let figures hold, behind those with a name, what conditions sum up of other rules."""
        sums = [leaf.remembered for leaf in self._leaves() if isinstance(leaf, RememberedCondition) and leaf.rules]
        force_setattr(self, "figures", tuple(dict.fromkeys([*self.named_figures, *sums])))

    @property
    def measured_targets(self) -> tuple[str, ...]:
        """The targets that are measured, without those that are the nearest or the farthest of several."""
        return self.targets[: len(self.targets) - len(self.nearest)]

    @property
    def named_figures(self) -> tuple[RememberedFigure, ...]:
        """The figures of the configuration, without what conditions sum up of other rules."""
        return tuple(figure for figure in self.figures if not figure.rules)

    @property
    def needs_wall_time(self) -> bool:
        """True if any rule asks for the time of day, or any figure begins at one."""
        asks = next(self._schedules(), None) is not None
        asks = asks or any(isinstance(rule, ReportRule) and rule.at_seconds for rule in self.rules)
        return asks or any(figure.window.from_second is not None for figure in self.figures)

    @property
    def needs_sun(self) -> bool:
        """True if any rule asks when the sun rises or sets."""
        return any(schedule.is_by_sun for schedule in self._schedules())

    def _schedules(self) -> Iterator[ScheduleCondition]:
        return (leaf for leaf in self._leaves() if isinstance(leaf, ScheduleCondition))

    def _leaves(self) -> Iterator[Leaf]:
        """Go through the simple conditions of all rules."""
        return (leaf for rule in self.rules for condition in conditions_of(rule) for leaf in leaves(condition))
