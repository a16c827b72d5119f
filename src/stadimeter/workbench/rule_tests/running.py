"""Running the tests of a configuration: its rules over made-up or recorded observations. Nothing is opened or moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stadimeter.config.loader import Configuration
from stadimeter.config.rule_tests.motions import PathPoint
from stadimeter.config.rule_tests.tables import RuleTest
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Event
from stadimeter.core.plan import Plan
from stadimeter.errors import ConfigError, Problem, StadimeterError
from stadimeter.workbench.rule_tests.expecting import watches
from stadimeter.workbench.rule_tests.input import observations
from stadimeter.workbench.rule_tests.sensor_model import SensorModel, sensor_models
from stadimeter.workbench.rule_tests.watching import Failure, Turn, Watch


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
        """Run one test. The same test gives the same result.

        Args:
            test: The test, one of the configuration's.

        Returns:
            What came of it. A recording that cannot be read, or a target whose size cannot be known, is trouble.
        """
        try:
            return self._run(test)
        except ConfigError as error:
            return RuleTestResult(test=test, trouble="; ".join(_words(problem) for problem in error.problems))
        except StadimeterError as error:
            return RuleTestResult(test=test, trouble=str(error))

    def _run(self, test: RuleTest) -> RuleTestResult:
        plan, watching = self._configuration.plan, list(_watches(test, self._configuration.plan))
        state, start_s, turn = initial_state(plan), None, None
        events: list[tuple[float, Event]] = []
        cycles = 0
        for observation in observations(test.input, self._configuration, self._known_sensors(test)):
            state, decision = decide(state, observation)
            start_s = observation.now_s if start_s is None else start_s
            turn = Turn(at_s=observation.now_s - start_s, start_s=start_s, decision=decision)
            events += [(event.at_s - start_s, event) for event in decision.events]
            for watch in watching:
                watch.see(turn)
            cycles += 1
        return RuleTestResult(
            test=test,
            failures=tuple(failure for watch in watching for failure in watch.failures()),
            events=tuple(events),
            took_s=turn.at_s if turn else 0.0,
            cycles=cycles,
        )

    def _known_sensors(self, test: RuleTest) -> Mapping[str, SensorModel]:
        """Return the sensor models, which are worked out once, and not for recordings."""
        if test.input.journal is not None:
            return {}
        if self._sensors is None:
            self._sensors = sensor_models(self._configuration)
        return self._sensors


def _watches(test: RuleTest, plan: Plan) -> Sequence[Watch]:
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
