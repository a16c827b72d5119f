"""What rules cost in a cycle, by how many there are. Run ``python tests/benchmarks/rule_scale.py``.

Decides on observations of one ball, with and without the rules in turn, cycle by cycle; the difference of the lower
quartiles is what the rules cost. "None crosses" means a ball that stands, with its noise, where no limit is within its
standard deviations. The memory is what Python's allocator gave for the state of all rules.
"""

from __future__ import annotations

import argparse
import math
import random
import statistics
import tracemalloc
from collections.abc import Callable, Sequence
from time import perf_counter

from msgspec import Struct
from msgspec.structs import replace
from part import Part, table

from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.discrete import DateSpan, PresenceCondition, RuleCondition, ScheduleCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.sequence import SequenceCondition
from stadimeter.core.conditions.summary import RememberedFigure, Window
from stadimeter.core.decide import State, decide, initial_state
from stadimeter.core.observation import FrameStamp, MonthDay, Observation, WallTime
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule, AnyRule, EscalationStep, RampRule, ReportRule, Send, Template
from support.conditions import closing, direction
from support.observing import measured

FRAME_S = 1 / 30
FRAMES = 900
WARM_UP = 150
NEAREST_M, FARTHEST_M = 0.5, 9.5
BEYOND_M = 12.0
NEAREST = RememberedFigure(name="nearest", target="ball", window=Window(for_s=60.0))
WINTER = DateSpan(MonthDay(11, 1), MonthDay(2, 28))
DAYS = MonthDay(12, 24), MonthDay(12, 25), MonthDay(12, 26)
TOLD = Send(template=Template(text="{nearest:.1f}"), topic="report")
Way = Callable[[int], float]


class Row(Struct, frozen=True, kw_only=True):
    """One line: which rules, on which way, and what they cost."""

    what: str
    rules: int
    cost_us: float
    active: int
    bytes_a_rule: float


def thresholds(count: int) -> tuple[AnyRule, ...]:
    """Return alarms on one distance, near and far in turn, with limits from 0.5 m to 9.5 m."""
    return tuple(_alarm(number, _threshold(number, count)) for number in range(count))


def mixed(count: int) -> tuple[AnyRule, ...]:
    """Return one rule of each kind after the other: every simple condition, compounds, rules on rules, ramps."""
    return tuple(_mixed(number, count) for number in range(count))


def of_every_kind(count: int) -> tuple[AnyRule, ...]:
    """Return the same, three in ten of them on memory, order, quantities, the calendar, with gates, or messages."""
    return tuple(
        _newer(number, count) if number % 10 in {2, 5, 7} else _mixed(number, count) for number in range(count)
    )


def _newer(number: int, count: int) -> AnyRule:
    near, minute, rules = DistanceCondition(below_m=_limit_m(number, count)), Window(for_s=60.0), ("rule-0", "rule-1")
    conditions: Sequence[Condition] = (
        RememberedCondition(rules=rules[:1], unit="times", above=2.0, window=minute),
        RememberedCondition(rules=rules[1:], unit="s", above=10.0 + number, window=minute),
        RememberedCondition(name="nearest", below=_limit_m(number, count), deadband=0.1),
        SequenceCondition(rules=rules, within_s=2.0),
        FigureCondition(quantity="x", above=0.1 + number / 50, target="ball"),
        FigureCondition(quantity="height_above_camera", above=0.1 + number / 50, target="ball"),
        FigureCondition(quantity="speed", above=0.5 + number / 20, target="ball", deadband_sigmas=2.0),
        ScheduleCondition(from_s=0.0, to_s=0.0, from_sun="sunset", to_sun="sunrise", dates=(WINTER,)),
    )
    place = number // 3 % 10
    if place < len(conditions):
        return _alarm(number, conditions[place])
    gate = AlarmRule(name="", target="", condition=near, escalation=(EscalationStep(send=TOLD, when=near),))
    if place == len(conditions):
        return ReportRule(name=f"rule-{number}", target="ball", every_s=1.0, gate=gate)
    return replace(_ramp(number, count), gate=replace(gate, escalation=()))


def _limit_m(number: int, count: int) -> float:
    return NEAREST_M + (FARTHEST_M - NEAREST_M) * (number + 0.5) / count


def _threshold(number: int, count: int) -> DistanceCondition:
    limit_m = _limit_m(number, count)
    return DistanceCondition(below_m=limit_m) if number % 2 else DistanceCondition(above_m=limit_m)


def _alarm(number: int, condition: Condition, suppress_when: Condition | None = None) -> AlarmRule:
    return AlarmRule(
        name=f"rule-{number}",
        target="ball",
        output=f"output-{number % 4}",
        priority=number,
        condition=condition,
        suppress_when=suppress_when,
    )


def _mixed(number: int, count: int) -> AnyRule:
    near, place = DistanceCondition(below_m=_limit_m(number, count)), number % 10
    if place == 9:
        return _ramp(number, count)
    conditions: Sequence[Condition] = (
        near,
        DistanceCondition(above_m=_limit_m(number, count)),
        direction(above=0.1),
        closing(above=0.1 + number / 50),
        TimeToContactCondition(below_s=1 + number / 20),
        PresenceCondition(seen=False, for_s=3),
        AllOf(conditions=(near, direction(above=0.2))),
        AnyOf(conditions=(near, PresenceCondition(seen=False))),
        Not(condition=near),
    )
    return _alarm(number, conditions[place], RuleCondition(rule="rule-0") if place == 8 else None)


def _ramp(number: int, count: int) -> RampRule:
    limit_m = _limit_m(number, count)
    name = f"rule-{number}"
    return RampRule(name=name, target="ball", output="output-0", priority=number, start=limit_m, full=limit_m + 1)


def standing(distance_m: float) -> Way:
    """Return a way on which the ball stands, with a little noise."""
    return lambda frame: distance_m + 0.001 * math.sin(frame * 2.4)


def rolling(frame: int) -> float:
    """Return where a ball is that rolls to and fro between 3 m and 7 m, at up to 0.6 m/s."""
    return 5 + 2 * math.sin(frame / 100)


def calm(frame: int) -> float:
    """Return where a ball is that stands amid the thresholds, measured with noise."""
    return 5 + random.Random(frame).gauss(0.0, 0.005)  # noqa: S311 - the same noise each time


def sweeping(frame: int) -> float:
    """Return where a ball is that goes to and fro between 1 m and 9 m, at up to 4 m/s."""
    return 5 + 4 * math.sin(frame / 30)


def _plan(rules: tuple[AnyRule, ...]) -> Plan:
    outputs = tuple(LevelOutput(name=f"output-{number}") for number in range(4))
    figures = (NEAREST,) if any(isinstance(rule, ReportRule) for rule in rules) else ()
    return Plan(targets=("ball",), rules=rules, outputs=outputs, figures=figures)


def _seen(frame: int, distance_m: float) -> Observation:
    at_s = frame * FRAME_S
    stamp = FrameStamp(sequence=frame, captured_at_s=at_s)
    noon = WallTime(second_of_day=43200 + at_s, weekday=3, dates=DAYS, sunrise_s=30000.0, sunset_s=57000.0)
    seen = (measured("ball", at_s, distance_m, 0.005),)
    return Observation(now_s=at_s + 0.01, frame=stamp, measurements=seen, wall=noon)


def measure(what: str, rules: tuple[AnyRule, ...], way: Way, frames: int = FRAMES) -> Row:
    """Return what rules cost on a way."""
    tracemalloc.start()
    state = initial_state(_plan(rules))
    used_bytes = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    states: dict[str, State] = {"with": state, "without": initial_state(_plan(()))}
    times_s: dict[str, list[float]] = {"with": [], "without": []}
    for frame in range(WARM_UP + frames):
        seen = _seen(frame, way(frame))
        for name, before in tuple(states.items()):
            began_s = perf_counter()
            states[name], _ = decide(before, seen)
            if frame >= WARM_UP:
                times_s[name].append(perf_counter() - began_s)
    cost_s = statistics.quantiles(times_s["with"], n=4)[0] - statistics.quantiles(times_s["without"], n=4)[0]
    return Row(
        what=what,
        rules=len(rules),
        cost_us=cost_s * 1e6,
        active=len(states["with"].rules.quiescence.active),
        bytes_a_rule=used_bytes / max(1, len(rules)),
    )


def measure_all(frames: int = FRAMES) -> list[Row]:
    """Return every row."""
    beyond = standing(BEYOND_M)
    return [
        *(measure("thresholds, none crosses", thresholds(count), beyond, frames) for count in (100, 1000, 10_000)),
        measure("thresholds, amid them", thresholds(100), rolling, frames),
        measure("thresholds, amid them", thresholds(10_000), rolling, frames),
        measure("mixed, none crosses", mixed(100), beyond, frames),
        measure("mixed, amid them", mixed(100), rolling, frames),
        *(measure("mixed, calm amid them", mixed(count), calm, frames) for count in (10, 100, 1000)),
        *(measure("mixed, sweeping over them", mixed(count), sweeping, frames) for count in (10, 100, 1000)),
        measure("of every kind, calm amid them", of_every_kind(100), calm, frames),
        measure("of every kind, sweeping over them", of_every_kind(100), sweeping, frames),
    ]


def part(frames: int = FRAMES) -> Part:
    """Return the part of the report."""
    rows = measure_all(frames)
    costs = {(row.what, row.rules): row.cost_us for row in rows}
    lines = [[r.what, f"{r.rules}", f"{r.cost_us:.1f}", f"{r.active}", f"{r.bytes_a_rule:.0f}"] for r in rows]
    return Part(
        title="Rules by the thousand",
        text=f"{__doc__.partition('. Run')[0]}.\n\n"
        + table(["rules", "how many", "µs a cycle", "judged in the last cycle", "bytes a rule"], lines),
        facts={
            "10,000 thresholds us": costs["thresholds, none crosses", 10_000],
            "100 mixed us": costs["mixed, amid them", 100],
        },
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=FRAMES)
    print(part(parser.parse_args().frames).text)
