"""Running the tests of a configuration: a trial of its rules on synthetic or recorded observations, held against them.

What happened is kept where it changed, so a test over an hour of recording needs little memory. Why something was not
met is asked for in a second run, of the test that failed alone: each run of a test is the same.

A synthetic target has normally distributed noise that is correlated from one frame to the next as the tracker expects
it. Directions are exact, since their uncertainty is not known. Everything random follows from a seed, and each frame
takes the same number of random numbers, so that one thing changed changes nothing else.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, time, timedelta
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from statistics import NormalDist
from typing import Any

from msgspec import Struct
from msgspec.structs import asdict, replace

from stadimeter.app.clock import SteppedClock, wall_time
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice, DriverContext, Shared
from stadimeter.config.rule_test_tables import (
    OF_RULES,
    ExpectTable,
    InputTable,
    MotionTable,
    OperatorTable,
    PathPoint,
    RuleTest,
    SpanTable,
)
from stadimeter.config.rules.conditions import DAYS
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.clock import DAY_S
from stadimeter.core.command import Command, LevelCommand
from stadimeter.core.decision import Decision, Event, EventKind
from stadimeter.core.detection import TargetShape
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.observation import FrameStamp, Observation, WallTime
from stadimeter.core.outputs import safe_command
from stadimeter.core.plan import Output
from stadimeter.core.rules.explaining import explain
from stadimeter.core.stereo_rig import StereoRig
from stadimeter.core.words import counted
from stadimeter.errors import ConfigError, JournalError, Problem, StadimeterError
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from stadimeter.ranging.similar_triangles import Expectation, expect
from stadimeter.ranging.stereo import straight_ahead_share
from stadimeter.workbench.replay import read_recording
from stadimeter.workbench.trial import Trial, command_figures, run

# The result: what happened, held against what was expected ----------------------------------------------------------

SHOWN_EVENTS = 5
_ROUNDING_S = 1e-9


class Failure(Struct, frozen=True, kw_only=True):
    """An expectation that was not met.

    Attributes:
        at_s: The moment that `why` is about, in seconds from the start of the test.
        why: What the rule or output was doing at that moment, and its reason.
    """

    subject: str
    key: str
    expected: str
    got: str
    at_s: float
    why: str = ""


class RuleTestResult(Struct, frozen=True, kw_only=True):
    """The result of one test.

    Attributes:
        failures: What was not met; none if it passed.
        events: What happened, with times from the start of the test.
        took_s: How long it was, in seconds of the test.
        trouble: Why it could not be run to its end; empty if it was.
    """

    test: RuleTest
    failures: tuple[Failure, ...] = ()
    events: tuple[tuple[float, Event], ...] = ()
    took_s: float = 0.0
    cycles: int = 0
    trouble: str = ""

    @property
    def passed(self) -> bool:
        """True if everything was as expected."""
        return not self.failures and not self.trouble


def run_rule_test(configuration: Configuration, test: RuleTest) -> RuleTestResult:
    """Run one test; a recording that cannot be read, or a target of unknown size, is trouble. Deterministic."""
    try:
        return _run(configuration, test)
    except ConfigError as error:
        return RuleTestResult(test=test, trouble="; ".join(_words(problem) for problem in error.problems))
    except StadimeterError as error:
        return RuleTestResult(test=test, trouble=str(error))


def _words(problem: Problem) -> str:
    return f"{problem.key}: {problem.message}" if problem.key else problem.message


def _run(configuration: Configuration, test: RuleTest) -> RuleTestResult:
    plan = configuration.plan
    trial = run(plan, observations(test.input, configuration))
    wrong = [failure for name in test.expect for failure in _failures(name, test.expect[name], trial)]
    moments = dict.fromkeys(failure.at_s for failure in wrong if not failure.why)
    decided: dict[float, tuple[float, Decision]] = {}  # in the last cycle that is not after each moment

    def see(at_s: float, decision: Decision) -> None:
        decided.update({each: (at_s, decision) for each in moments if at_s <= each + _ROUNDING_S})

    if moments:
        run(plan, observations(test.input, configuration), see)
    return RuleTestResult(
        test=test,
        failures=tuple(_explained(each, *decided[each.at_s]) if each.at_s in decided else each for each in wrong),
        events=tuple((event.at_s - trial.began_s, event) for event in trial.events),
        took_s=trial.seconds,
        cycles=trial.cycles,
    )


def _explained(failure: Failure, at_s: float, decision: Decision) -> Failure:
    """Add why: the reason of the rule, or what the output did, who commanded it, and why."""
    if failure.why:
        return failure
    if failure.key in OF_RULES:
        return replace(failure, at_s=at_s, why=explain(decision, failure.subject).sentence)
    command = next(each for each in decision.commands if each.output == failure.subject)
    trace = next(each for each in decision.outputs if each.output == failure.subject)
    why = trace.reason or decision.reasons.get(trace.winner, "")
    return replace(failure, at_s=at_s, why=f"{_does(command)}, commanded by {trace.winner}: {why}")


def _failures(name: str, expected: ExpectTable, trial: Trial) -> Iterator[Failure]:
    """Yield what was not met of a rule, of an output, or of both: they may share a name."""
    if any(rule.name == name for rule in trial.plan.rules):
        yield from _RuleOfTrial(name=name, expected=expected, trial=trial).failures()
    for output in trial.plan.outputs:
        if output.name == name:
            yield from _OutputOfTrial(name=name, expected=expected, trial=trial).failures(output)


class _PartOfTrial(Struct, frozen=True, kw_only=True):
    """A rule or an output in a trial, and what is expected of it."""

    name: str
    expected: ExpectTable
    trial: Trial

    def failure(self, key: str, expected: str, got: str, at_s: float, why: str = "") -> Failure:
        """Return a failure; without a reason, that of its moment is added."""
        return Failure(subject=self.name, key=key, expected=expected, got=got, at_s=at_s, why=why)

    def at_moment(
        self, key: str, moment: float | SpanTable, expected: str, changes: Iterable[tuple[float, bool, str]]
    ) -> Iterator[Failure]:
        """Yield when, at a moment or throughout a span, something was first not as expected.

        Args:
            changes: When something changed, whether it is as expected since then, and how it is in words.
        """
        seconds = self.trial.seconds
        if isinstance(moment, SpanTable):
            start_s, end_s = moment.start, moment.end_s
            expected += f" from {start_s:.2f} s to {end_s:.2f} s"
        else:
            start_s = end_s = moment
            expected += f" at {end_s:.2f} s"
        for (at_s, is_met, got), (until_s, *_) in pairwise([*changes, (seconds + 2 * _ROUNDING_S, True, "")]):
            overlaps = until_s > start_s + _ROUNDING_S and at_s <= max(start_s + _ROUNDING_S, end_s - _ROUNDING_S)
            if overlaps and not is_met:
                unmet_s = max(at_s, start_s)
                yield self.failure(key, expected, f"{got} at {unmet_s:.2f} s", unmet_s)
                return
        if seconds + _ROUNDING_S < end_s:
            yield self.failure(key, expected, f"the test was over at {seconds:.2f} s", seconds)


class _RuleOfTrial(_PartOfTrial, frozen=True):
    """A rule, and what is expected of it."""

    def failures(self) -> Iterator[Failure]:
        """Yield what was not met, for each key that is given."""
        expected, trial, traces = self.expected, self.trial, self.trial.traces[self.name]
        yield from self._counts()
        for kind in (EventKind.RAISED, EventKind.CLEARED):
            yield from self._first(kind)
        for key, words, wanted in (("active_at", "active", True), ("inactive_at", "not active", False)):
            for moment in getattr(expected, key) or ():
                changes = ((at_s, (trace.active is True) is wanted, trace.status.value) for at_s, trace in traces)
                yield from self.at_moment(key, moment, words, changes)
        last = traces[-1][1]
        got = f" at {trial.seconds:.2f} s"
        if expected.status not in {None, last.status}:
            yield self.failure("status", f"{expected.status} at the end", f"{last.status}{got}", trial.seconds)
        if expected.acknowledged not in {None, last.acknowledged}:
            words, other = ("", "not ") if expected.acknowledged else ("not ", "")
            hoped = f"{words}acknowledged at the end"
            yield self.failure("acknowledged", hoped, f"{other}acknowledged{got}", trial.seconds)

    def _events(self, *kinds: EventKind) -> list[Event]:
        return [event for event in self.trial.events if event.source == self.name and event.kind in kinds]

    def _counts(self) -> Iterator[Failure]:
        events_of = (
            ("raised", self._events(EventKind.RAISED), "raise"),
            ("cleared", self._events(EventKind.CLEARED), "clearing"),
            ("sent", [each for each in self.trial.sent if each.source == self.name], "message"),
            ("transitions_max", self._events(EventKind.RAISED, EventKind.CLEARED), "transition"),
        )
        for key, events, noun in events_of:
            most: int | None = getattr(self.expected, key)
            is_limit = key == "transitions_max"
            if most is None or len(events) == most or (is_limit and len(events) <= most):
                continue
            times_s = [event.at_s - self.trial.began_s for event in events]
            shown = ", ".join(f"{at_s:.2f} s" for at_s in times_s[:SHOWN_EVENTS])
            more = ", …" if len(events) > SHOWN_EVENTS else ""
            hoped = counted(most, noun) + (" at most" if is_limit else "")
            got = counted(len(events), noun) + (f" (at {shown}{more})" if events else "")
            if len(events) > most:
                first = events[most]
                yield self.failure(key, hoped, got, times_s[most], f"{first.kind.value}: {first.reason}")
            else:
                yield self.failure(key, hoped, got, self.trial.seconds)

    def _first(self, kind: EventKind) -> Iterator[Failure]:
        """Yield when the first event of a kind came too late or too early; why is said of the limit."""
        verb, events, end_s = kind.value, self._events(kind), self.trial.seconds
        by_s, after_s = (getattr(self.expected, f"{verb}_{key}") for key in ("by", "after"))
        at_s = events[0].at_s - self.trial.began_s if events else math.inf
        got = f"{verb} at {at_s:.2f} s" if events else f"never {verb}"
        if by_s is not None and at_s > by_s + _ROUNDING_S:
            late = f", {at_s - by_s:.2f} s late" if events else ""
            yield self.failure(f"{verb}_by", f"{verb} by {by_s:.2f} s", got + late, min(by_s, end_s))
        if after_s is not None and (not events or at_s < after_s - _ROUNDING_S):
            yield self.failure(f"{verb}_after", f"{verb} not before {after_s:.2f} s", got, min(at_s, end_s))


class _OutputOfTrial(_PartOfTrial, frozen=True):
    """An output, and what is expected of it."""

    def failures(self, output: Output) -> Iterator[Failure]:
        """Yield what was not met, for each key that is given."""
        expected, commands = self.expected, self.trial.commands[self.name]
        for table in expected.level_at or ():
            low, high = table.limits
            words = f"level from {max(0.0, low):.2f} to {min(1.0, high):.2f}"
            changes = ((at_s, low <= _level(each) <= high, _does(each)) for at_s, each in commands)
            yield from self.at_moment("level_at", table.at, words, changes)
        if expected.speed_max is not None:
            above = next(((at_s, each) for at_s, each in commands if _speed_mps(each) > expected.speed_max), None)
            if above is not None:
                got = f"{_does(above[1])} at {above[0]:.2f} s"
                yield self.failure("speed_max", f"never faster than {expected.speed_max:.2f} m/s", got, above[0])
        safe = command_figures(safe_command(output))
        for key, words, wanted in (
            ("stopped_at", "at its safe value", True),
            ("acts_at", "not at its safe value", False),
        ):
            for moment in getattr(expected, key) or ():
                changes = ((at_s, (command_figures(each) == safe) is wanted, _does(each)) for at_s, each in commands)
                yield from self.at_moment(key, moment, words, changes)


def _level(command: Command) -> float:
    return command.level if isinstance(command, LevelCommand) else 0.0


def _speed_mps(command: Command) -> float:
    return 0.0 if isinstance(command, LevelCommand) else abs(command.linear_mps)


def _does(command: Command) -> str:
    if isinstance(command, LevelCommand):
        return f"level {command.level:.2f}"
    return f"{command.linear_mps:.2f} m/s, {math.degrees(command.angular_radps):.0f} deg/s"


# What the core sees in a test: recorded observations, or synthetic ones ----------------------------------------------

# The frame rate where neither the test nor the camera names one.
RATE_HZ = 30.0

# Without a frame there is a cycle this often, as in a run.
WAIT_S = 0.1


def observations(given: InputTable, configuration: Configuration) -> Iterator[Observation]:
    """Yield what the core sees, a cycle at a time. Nothing is opened but a recording. Synthetic ones begin at 0 s.

    Raises:
        JournalError: The recording cannot be read, or holds none of the targets.
        ConfigError: There is no camera model, or a detector cannot be built.
    """
    if given.journal is not None:
        yield from _recorded_observations(given.journal, configuration.plan.targets)
        return
    tracks = _tracks(given, configuration)
    rate_hz = given.rate or getattr(configuration.camera.options, "rate", None) or RATE_HZ
    orders = sorted(given.operator, key=lambda order: order.at)
    for number, (at_s, frame) in enumerate(_cycles(given, rate_hz)):
        due = [order for order in orders if order.at <= at_s + _ROUNDING_S]
        orders = orders[len(due) :]
        yield Observation(
            now_s=at_s,
            frame=None if frame is None else FrameStamp(sequence=frame, captured_at_s=at_s),
            measurements=() if frame is None else tuple([track.measure(at_s) for track in tracks]),
            camera_fault="" if frame is not None else "no frame in time",
            wall=_wall(given, at_s, configuration),
            operator_commands=tuple([_command(order, f"test-{number}-{index}") for index, order in enumerate(due)]),
        )


def _recorded_observations(journal: Path, targets: tuple[str, ...]) -> Iterator[Observation]:
    seen: set[str] = set()
    for cycle in read_recording(journal).cycles():
        observation = cycle.observation()
        seen.update([measured.target for measured in observation.measurements])
        yield observation
    if not seen & set(targets):
        held = f"only {', '.join(sorted(seen))}" if seen else "no measurement at all"
        raise JournalError(f"{journal} holds {held}, and the rules are about {', '.join(targets)}")


def _tracks(given: InputTable, configuration: Configuration) -> tuple[SyntheticTrack, ...]:
    sensors, motions = sensor_models(configuration), given.motions(configuration.plan.targets)
    nowhere = MotionTable()
    return tuple(
        SyntheticTrack(
            target=target,
            path=motions.get(target, nowhere).path(),
            sensor=sensors[target],
            seed=given.seed,
            noise=given.noise,
            correlation=configuration.plan.tracking.autocorrelation,
            dropouts=given.dropouts,
            outliers=given.outliers,
            lost=motions.get(target, nowhere).lost,
        )
        for target in configuration.plan.measured_targets
    )


def _cycles(given: InputTable, rate_hz: float) -> Iterator[tuple[float, int | None]]:
    """Yield the time of each cycle and the number of its frame, or None for a cycle without one."""
    last_s = -WAIT_S
    for frame in range(int(given.moving_s * rate_hz + _ROUNDING_S) + 1):
        at_s = frame / rate_hz
        if any(span.holds(at_s) for span in given.frozen):
            continue
        yield from ((waited_s, None) for waited_s in wait_times(last_s, at_s))
        yield at_s, frame
        last_s = at_s
    yield from ((waited_s, None) for waited_s in wait_times(last_s, given.moving_s))
    if last_s < given.moving_s - _ROUNDING_S:
        yield given.moving_s, None  # so that the test ends when it says, not at the last frame before


def wait_times(last_s: float, next_s: float) -> Iterator[float]:
    """Yield the times of the cycles between two frames that are without one."""
    for count in range(1, int((next_s - last_s - _ROUNDING_S) / WAIT_S) + 1):
        yield last_s + count * WAIT_S


def _wall(given: InputTable, at_s: float, configuration: Configuration) -> WallTime | None:
    if given.clock is None:
        return None
    days, second_of_day = divmod(given.clock + at_s, DAY_S)
    if given.date is not None:
        midnight = datetime.combine(given.date, time())
        return wall_time(midnight + timedelta(seconds=given.clock + at_s), configuration)
    return WallTime(second_of_day=second_of_day, weekday=(DAYS.index(given.day) + int(days)) % len(DAYS))


def _command(order: OperatorTable, identity: str) -> OperatorCommand:
    action = OperatorAction(order.do)
    return OperatorCommand(
        id=identity, action=action, rule=order.rule, by="test", for_s=order.duration, is_from_button=True
    )


# Nothing smaller is found, however good the picture.
MIN_SIZE_PX = 3.0

# A range sensor is as sure as those that there are, in the middle of their range, and no further.
RANGE_SENSOR_SIGMA_M, RANGE_SENSOR_MAX_M = 0.02, 4.0


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """A camera, or two, that look at a target of known size; or a range sensor.

    Attributes:
        size: Of the target; None for a range sensor, which needs neither it nor a lens.
        rig: The two cameras, where the size is only a guess.
    """

    size: TargetShape | None
    camera: CameraModel
    rig: StereoRig | None = None

    def sigmas_m(self, distance_m: float) -> tuple[float, float]:
        """Return the uncertainty of a distance, as `stadimeter.ranging.similar_triangles` expects it.

        Two cameras triangulate straight ahead: noise moves the middle of an outline by half of what it adds to its
        size, in each of two pictures; and an error of the disparity counts as one of the size does, by the baseline in
        place of the size.

        Returns:
            The whole standard deviation in metres, and the part of it that differs from frame to frame.
        """
        if self.size is None:
            return RANGE_SENSOR_SIGMA_M, RANGE_SENSOR_SIGMA_M
        if self.rig is None:
            noise_m = self._expect(self.size, distance_m).sigma_m
            stays = math.hypot(self.camera.focal_relative_sigma, self.size.relative_sigma)
        else:
            of_size_m = self._expect(self.size, distance_m).noise_m
            noise_m = of_size_m * self.size.shortest_m / self.rig.baseline_m / math.sqrt(2)
            stays = straight_ahead_share(self.rig, distance_m)
        return math.hypot(noise_m, stays * distance_m), noise_m

    def size_share(self, distance_m: float) -> float | None:
        """Return its larger extent in the picture at a distance, as a share of the picture's width; None without."""
        if self.size is None:
            return None
        size_px = self._expect(self.size, distance_m).size_px
        return size_px * self.size.longest_m / self.size.shortest_m / self.camera.width_px

    def is_found(self, distance_m: float) -> bool:
        """Check whether the target appears large enough for any detector to find it, or is within a sensor's range."""
        if self.size is None:
            return distance_m <= RANGE_SENSOR_MAX_M
        return self._expect(self.size, distance_m).size_px >= MIN_SIZE_PX

    def _expect(self, size: TargetShape, distance_m: float) -> Expectation:
        return expect(size, self._exact, distance_m)

    @cached_property
    def _exact(self) -> CameraModel:
        return replace(self.camera, focal_relative_sigma=0.0, uncertainty=None)


def sensor_models(configuration: Configuration) -> Mapping[str, SensorModel]:
    """Return the sensor model of each target, and of each range sensor. Nothing is opened.

    Raises:
        ConfigError: There is no camera model, or a detector cannot be built.
    """
    camera = configuration.camera_model
    if camera is None:
        message = "there is no camera model, so nothing has a noise"
        raise ConfigError([Problem(message, str(configuration.path), key="camera.model")])
    models = {each.name: SensorModel(size=None, camera=camera) for each in configuration.sensors}
    shared = Shared()
    try:
        if configuration.world is not None:
            _build(configuration.world, camera, shared)
        for choice in configuration.targets:
            try:
                shape = _build(choice, camera, shared).target_shape
                rig = configuration.rig if math.isinf(shape.relative_sigma) else None
                model = SensorModel(size=shape, camera=camera if rig is None else rig.left, rig=rig)
                models |= dict.fromkeys(choice.members, model)
            except StadimeterError as error:
                message = f"how large the target is cannot be known: {error}"
                raise ConfigError([Problem(message, str(configuration.path), key=f"targets.{choice.name}")]) from error
        return models
    finally:
        for close in reversed(shared.closers):
            close()


def _build(choice: DriverChoice, camera: CameraModel, shared: Shared) -> Any:
    context = DriverContext(name=choice.name, clock=SteppedClock(), camera_model=camera, shared=shared)
    return choice.options.build(context)


# A gross error makes a distance up to this many times as large, or as small.
OUTLIER_FACTOR = 3.0

# A noisy distance below this share of the true one counts as missed: its small stated sigma would mislead.
DROWNED_SHARE = 0.2

_NORMAL = NormalDist()


def position_at(path: Sequence[PathPoint], at_s: float) -> PathPoint:
    """Return the true position of a target.

    Args:
        path: Where it is at certain times, in order; it stays at the last point.
        at_s: Seconds from the start of the test.
    """
    index = bisect_right(path, at_s, key=lambda point: point.at_s)
    if index == len(path):
        return path[-1]
    before, after = path[max(0, index - 1)], path[index]
    span_s = after.at_s - before.at_s
    share = (at_s - before.at_s) / span_s if span_s > 0 else 0.0
    start, end = asdict(before), asdict(after)
    return PathPoint(**{key: start[key] + (end[key] - start[key]) * share for key in start})


@dataclass(kw_only=True)
class SyntheticTrack:
    """Measures one target that is not there, a frame at a time.

    Attributes:
        path: Where it truly is when; empty for a target that is never in sight.
        seed: Everything random follows from it and the target's name.
        noise: How large the noise is, as a factor of what is expected.
        correlation: Of the noise, from one frame to the next.
        dropouts: The share of frames in which the target is not found.
        outliers: The share of frames in which the distance is grossly wrong.
        lost: When it is out of sight.
    """

    target: str
    path: Sequence[PathPoint]
    sensor: SensorModel
    seed: int
    noise: float = 1.0
    correlation: float = 0.0
    dropouts: float = 0.0
    outliers: float = 0.0
    lost: Sequence[SpanTable] = ()

    def __post_init__(self) -> None:
        self._random = random.Random(f"{self.seed}:{self.target}")  # noqa: S311 - noise, not a secret
        self._deviation = self._normal()

    def measure(self, at_s: float) -> Measurement:
        """Measure it in the next frame.

        Args:
            at_s: When the frame was taken, in seconds from the start of the test; later than the frame before.
        """
        deviation = self._next_deviation()
        is_dropped = self._random.random() < self.dropouts
        is_outlier = self._random.random() < self.outliers
        error = self._random.random()
        if not self.path or any(span.holds(at_s) for span in self.lost):
            return self._missed(at_s, "out of sight")
        if is_dropped:
            return self._missed(at_s, "not found in this frame")
        true = position_at(self.path, at_s)
        if not self.sensor.is_found(true.distance_m):
            return self._missed(at_s, "too small in the picture")
        _, noise_m = self.sensor.sigmas_m(true.distance_m)
        distance_m = true.distance_m + self.noise * noise_m * deviation
        if is_outlier:
            distance_m = true.distance_m * OUTLIER_FACTOR ** (2 * error - 1)
        elif distance_m < true.distance_m * DROWNED_SHARE:
            return self._missed(at_s, "lost in the noise")
        return self._measured(at_s, distance_m, true)

    def _next_deviation(self) -> float:
        """Return the noise of this frame in standard deviations: what is left of the last one's, and news."""
        kept = self.correlation
        self._deviation = kept * self._deviation + math.sqrt(1 - kept * kept) * self._normal()
        return self._deviation

    def _normal(self) -> float:
        # The open interval: neither of its ends is a probability that has a number of standard deviations.
        return _NORMAL.inv_cdf((self._random.getrandbits(52) + 0.5) / 2**52)

    def _missed(self, at_s: float, reason: str) -> Measurement:
        return Measurement(target=self.target, status=MeasurementStatus.NOT_FOUND, captured_at_s=at_s, reason=reason)

    def _measured(self, at_s: float, distance_m: float, true: PathPoint) -> Measurement:
        sigma_m, noise_m = self.sensor.sigmas_m(distance_m)
        return Measurement(
            target=self.target,
            status=MeasurementStatus.MEASURED,
            captured_at_s=at_s,
            distance_m=distance_m,
            depth_m=distance_m * math.cos(true.bearing_rad) * math.cos(true.elevation_rad),
            sigma_m=sigma_m,
            noise_m=noise_m,
            bearing_rad=true.bearing_rad,
            elevation_rad=true.elevation_rad,
            size_share=self.sensor.size_share(distance_m),
        )
