"""When rules were active and what outputs did, over a stretch of time: stretches and steps, as a chart draws them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from stadimeter.core.command import LevelCommand
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import Decision, Event
from stadimeter.core.observation import Observation
from stadimeter.core.plan import Plan
from stadimeter.workbench.replay.lanes import Lane, Point, thinned

EVENTS_MAX = 100
"""Nobody reads more beside a chart."""


@dataclass(slots=True)
class Lanes:
    """What became of a plan over observations. Times are in seconds from the first of them.

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
            "samples": {name: list(map(list, thinned(points))) for name, points in self.samples.items()},
            "events": [
                {"at_s": at_s, "kind": event.kind.value, "source": event.source, "reason": event.reason}
                for at_s, event in self.events[:EVENTS_MAX]
            ],
        }


def lanes_of(plan: Plan, observations: Iterable[Observation]) -> Lanes:
    """Return what a plan makes of observations. Nothing is opened, and nothing moves."""
    lanes, state, start_s = Lanes(), initial_state(plan), None
    for observation in observations:
        state, decision = decide(state, observation)
        start_s = observation.now_s if start_s is None else start_s
        lanes.see(observation.now_s - start_s, observation, decision)
    return lanes
