"""Running the tests of a configuration: its rules over synthetic or recorded observations. Opens and moves nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stadimeter.config.loader import Configuration
from stadimeter.config.rule_test_tables import InputTable, MotionTable, OperatorTable, PathPoint, RuleTest
from stadimeter.config.rules.figure_tables import DAYS
from stadimeter.core.command import LevelCommand
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision, Event
from stadimeter.core.observation import FrameStamp, Observation, WallTime
from stadimeter.core.operator import OperatorCommand
from stadimeter.core.plan import Plan
from stadimeter.errors import ConfigError, JournalError, Problem, StadimeterError
from stadimeter.workbench.replay.lanes import Lane, Point, thin_points
from stadimeter.workbench.replay.replay import read_recording
from stadimeter.workbench.rule_tests.expecting import watches
from stadimeter.workbench.rule_tests.synthetic_track import Nuisances, SensorModel, SyntheticTrack, sensor_models
from stadimeter.workbench.rule_tests.watching import DecidedCycle, Failure, Watcher

# The frame rate where neither the test nor the camera names one.
RATE_HZ = 30.0

# Without a frame there is a cycle this often, as in a run.
WAIT_S = 0.1
_DAY_S = 86400.0
_ROUNDING_S = 1e-9


def observations(
    given: InputTable, configuration: Configuration, sensors: Mapping[str, SensorModel]
) -> Iterator[Observation]:
    """Yield what the core sees, a cycle at a time. Nothing is opened but a recording.

    Args:
        sensors: How sure each target's distance is expected to be; not needed for a recording.

    Yields:
        The observations. Synthetic ones begin at 0 s.

    Raises:
        JournalError: The recording cannot be read, or holds none of the targets.
    """
    if given.journal is not None:
        yield from _recorded_observations(given.journal, configuration.plan.targets)
        return
    tracks = _tracks(given, configuration, sensors)
    orders = sorted(given.operator, key=lambda order: order.at)
    for number, (at_s, frame) in enumerate(_cycles(given, frame_rate_hz(given, configuration))):
        due = [order for order in orders if order.at <= at_s + _ROUNDING_S]
        orders = orders[len(due) :]
        yield Observation(
            now_s=at_s,
            frame=None if frame is None else FrameStamp(sequence=frame, captured_at_s=at_s),
            measurements=() if frame is None else tuple([track.measure(at_s) for track in tracks]),
            camera_fault="" if frame is not None else "no frame in time",
            wall=_wall(given, at_s),
            operator_commands=tuple([_command(order, f"test-{number}-{index}") for index, order in enumerate(due)]),
        )


def frame_rate_hz(given: InputTable, configuration: Configuration) -> float:
    """Return the frame rate that a test names; else that of the camera; else a usual one."""
    return given.rate or getattr(configuration.camera.options, "rate", None) or RATE_HZ


def _recorded_observations(journal: Path, targets: tuple[str, ...]) -> Iterator[Observation]:
    seen: set[str] = set()
    for cycle in read_recording(journal).cycles():
        observation = cycle.observation()
        seen.update([measured.target for measured in observation.measurements])
        yield observation
    if not seen & set(targets):
        held = f"only {', '.join(sorted(seen))}" if seen else "no measurement at all"
        raise JournalError(f"{journal} holds {held}, and the rules are about {', '.join(targets)}")


def _tracks(
    given: InputTable, configuration: Configuration, sensors: Mapping[str, SensorModel]
) -> tuple[SyntheticTrack, ...]:
    motions = given.motions(configuration.plan.targets)
    nowhere = MotionTable()
    return tuple(
        SyntheticTrack(
            target=target,
            path=motions.get(target, nowhere).path(),
            sensor=sensors[target],
            nuisances=Nuisances(
                noise=given.noise,
                correlation=configuration.plan.tracking.autocorrelation,
                dropouts=given.dropouts,
                outliers=given.outliers,
                lost=motions.get(target, nowhere).lost,
            ),
            seed=given.seed,
        )
        for target in configuration.plan.targets
    )


def _cycles(given: InputTable, rate_hz: float) -> Iterator[tuple[float, int | None]]:
    """Yield the time of each cycle and the number of its frame, or None for a cycle without one."""
    last_s = -WAIT_S
    for frame in range(int(given.moving_s * rate_hz + _ROUNDING_S) + 1):
        at_s = frame / rate_hz
        if any(span.holds(at_s) for span in given.frozen):
            continue
        yield from ((waited_s, None) for waited_s in _waits(last_s, at_s))
        yield at_s, frame
        last_s = at_s
    yield from ((waited_s, None) for waited_s in _waits(last_s, given.moving_s))
    if last_s < given.moving_s - _ROUNDING_S:
        yield given.moving_s, None  # so that the test ends when it says, not at the last frame before


def _waits(last_s: float, next_s: float) -> Iterator[float]:
    for count in range(1, int((next_s - last_s - _ROUNDING_S) / WAIT_S) + 1):
        yield last_s + count * WAIT_S


def _wall(given: InputTable, at_s: float) -> WallTime | None:
    if given.clock is None:
        return None
    days, second_of_day = divmod(given.clock + at_s, _DAY_S)
    return WallTime(second_of_day=second_of_day, weekday=(DAYS.index(given.day) + int(days)) % len(DAYS))


def _command(order: OperatorTable, identity: str) -> OperatorCommand:
    ((action, rule),) = order.orders()
    return OperatorCommand(
        id=identity,
        action=action,
        rule=rule,
        by=order.by,
        why=order.why,
        for_s=order.duration,
        one_shot=order.one_shot,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleTestResult:
    """What came of one test.

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
        """Whether everything was as expected."""
        return not self.failures and not self.trouble


class RuleTests:
    """Runs tests of one configuration."""

    def __init__(self, configuration: Configuration) -> None:
        self._configuration = configuration
        self._sensors: Mapping[str, SensorModel] | None = None

    def run(self, test: RuleTest) -> RuleTestResult:
        """Run one test; a recording that cannot be read, or a target of unknown size, is trouble. Deterministic."""
        try:
            return self._run(test)
        except ConfigError as error:
            return RuleTestResult(test=test, trouble="; ".join(_words(problem) for problem in error.problems))
        except StadimeterError as error:
            return RuleTestResult(test=test, trouble=str(error))

    def _run(self, test: RuleTest) -> RuleTestResult:
        plan, watching = self._configuration.plan, list(_watches(test, self._configuration.plan))
        state, start_s, cycle = initial_state(plan), None, None
        events: list[tuple[float, Event]] = []
        cycles = 0
        for observation in observations(test.input, self._configuration, self._known_sensors(test)):
            state, decision = decide(state, observation)
            start_s = observation.now_s if start_s is None else start_s
            cycle = DecidedCycle(at_s=observation.now_s - start_s, start_s=start_s, decision=decision)
            events += [(event.at_s - start_s, event) for event in decision.events]
            for watch in watching:
                watch.see(cycle)
            cycles += 1
        return RuleTestResult(
            test=test,
            failures=tuple(failure for watch in watching for failure in watch.failures()),
            events=tuple(events),
            took_s=cycle.at_s if cycle else 0.0,
            cycles=cycles,
        )

    def _known_sensors(self, test: RuleTest) -> Mapping[str, SensorModel]:
        """Return the sensor models, which are worked out once, and not for recordings."""
        if test.input.journal is not None:
            return {}
        if self._sensors is None:
            self._sensors = sensor_models(self._configuration)
        return self._sensors


def _watches(test: RuleTest, plan: Plan) -> Sequence[Watcher]:
    paths = _paths(test, plan)
    targets = {rule.name: rule.target for rule in plan.rules}
    return [
        watch
        for name, expected in test.expect.items()
        for watch in watches(name, expected, plan, paths.get(targets.get(name, ""), ()))
    ]


def _paths(test: RuleTest, plan: Plan) -> Mapping[str, tuple[PathPoint, ...]]:
    if test.input.journal is not None:
        return {}
    return {target: motion.path() for target, motion in test.input.motions(plan.targets).items()}


def _words(problem: Problem) -> str:
    return f"{problem.key}: {problem.message}" if problem.key else problem.message


# The number of events that are listed beside a chart.
EVENTS_MAX = 100


@dataclass(slots=True)
class Lanes:
    """What a plan decides over observations. Times are in seconds from the first observation.

    Attributes:
        active: By rule, when it was active.
        steps: By output, from when on it had which level; of a base, the speeds forwards and of turning.
    """

    active: dict[str, Lane] = field(default_factory=dict)
    steps: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)
    events: list[tuple[float, Event]] = field(default_factory=list)
    samples: dict[str, list[Point]] = field(default_factory=dict)
    took_s: float = 0.0

    def see(self, at_s: float, observation: Observation, decision: Decision) -> None:
        """Take in a cycle."""
        for trace in decision.rules:
            self.active.setdefault(trace.rule, Lane()).add(at_s, is_on=trace.active is True)
        for command in decision.commands:
            now = (command.level,) if isinstance(command, LevelCommand) else (command.linear_mps, command.angular_radps)
            steps = self.steps.setdefault(command.output, [])
            if not steps or steps[-1][1:] != now:
                steps.append((at_s, *now))
        for measured in observation.measurements:
            point = (at_s, measured.distance_m, measured.sigma_m or 0.0)
            self.samples.setdefault(measured.target, []).append(point)
        self.events += [(at_s, event) for event in decision.events]
        self.took_s = at_s

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "seconds": self.took_s,
            "rules": [
                {"rule": rule, "active": [{"from_s": start, "to_s": end} for start, end in lane.thinned()]}
                for rule, lane in self.active.items()
            ],
            "outputs": [
                {"output": name, "steps": [list(step) for step in steps]} for name, steps in self.steps.items()
            ],
            "samples": {name: list(map(list, thin_points(points))) for name, points in self.samples.items()},
            "events": [
                {"at_s": at_s, "kind": event.kind.value, "source": event.source, "reason": event.reason}
                for at_s, event in self.events[:EVENTS_MAX]
            ],
        }


def lanes_of(plan: Plan, observations: Iterable[Observation]) -> Lanes:
    """Decide on observations by a plan; opens and moves nothing."""
    lanes, state, start_s = Lanes(), initial_state(plan), None
    for observation in observations:
        state, decision = decide(state, observation)
        start_s = observation.now_s if start_s is None else start_s
        lanes.see(observation.now_s - start_s, observation, decision)
    return lanes
