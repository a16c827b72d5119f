"""The decisions that changed rules would have made on a recording, beside the rules of a configuration, at once.

What rules are judged by in a cycle (tracks, the frame, the time of day, commands of operators) does not depend on what
they decide, unless a base is driven. So a recording is decided on once, what its rules were judged by is kept, and of a
changed configuration only those rules are judged again that changed, that ask for one that did, or belong to a group
with one; and those that these ask for. `judged_apart` says which, and where that is not certain to be the same, it
says so: then everything is decided again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from msgspec.structs import replace

from stadimeter.config.loader import Configuration
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.sight import CountCondition
from stadimeter.core.decide import JudgedBy, State, decide, initial_state, judged_by
from stadimeter.core.plan import BaseOutput, Plan
from stadimeter.core.rule import AlarmRule, FollowRule, conditions_of
from stadimeter.core.rules.explaining import Reasons
from stadimeter.core.rules.scheduler import asks_for, judge, with_steps
from stadimeter.errors import JournalError
from stadimeter.workbench.replay.comparison import Lane, ReplaySide
from stadimeter.workbench.replay.replay import AnyRecording, decisions, first_state
from stadimeter.workbench.replay.replay_figures import Tally

# The cycles that are kept of all recordings together, times the targets: 20 minutes of one target at 30 a second. One
# takes 2.5 kB, as was measured once, so all take 90 MB; a Pi Zero 2 W has 512 MB.
KEPT_CYCLES_MAX = 36_000


class KeptCycle(NamedTuple):
    """A cycle that rules can be judged in again."""

    at_s: float
    """Since the beginning of the recording."""
    by: JudgedBy
    has_frame: bool


@dataclass(slots=True, kw_only=True)
class KeptRecording:
    """A recording that is decided on by a configuration, a part at a time, with what its rules were judged by.

    Attributes:
        from_s: Cycles before this are passed over, and it begins with nothing known.
        cycles_max: No more cycles than this are taken.
        began_s: The time of the first cycle, on the run's clock.
        is_done: Whether it is decided on to its end, or as far as `cycles_max` allows.
        damage: Why it cannot be read to its end; empty if it can.
        side: What was decided.
    """

    recording: AnyRecording
    configuration: Configuration
    from_s: float = 0.0
    cycles_max: int = KEPT_CYCLES_MAX
    began_s: float = math.nan
    is_done: bool = False
    damage: str = ""
    cycles: list[KeptCycle] = field(default_factory=list)
    side: ReplaySide = field(init=False)
    _steps: Iterator[None] = field(init=False)

    def __post_init__(self) -> None:
        self.side = _new_side(self.configuration.plan)
        self._steps = self._through()

    @property
    def seconds(self) -> float:
        """Up to where it is decided on."""
        return self.cycles[-1].at_s if self.cycles else 0.0

    def go_on(self, for_s: float) -> None:
        """Go on for this long, or to the end; damage ends it as well."""
        until_s = time.monotonic() + for_s
        while not self.is_done and time.monotonic() < until_s:
            try:
                self.is_done = next(self._steps, self) is self
            except JournalError as error:
                self.damage, self.is_done = str(error), True

    def _through(self) -> Iterator[None]:
        state = self._first_state(self.configuration.plan)
        for cycle in self.recording.cycles():
            if len(self.cycles) >= self.cycles_max:
                return
            self.began_s = cycle.now_s() if math.isnan(self.began_s) else self.began_s
            if cycle.now_s() < self.began_s + self.from_s:
                continue
            observation = cycle.observation()
            after, decision = decide(state, observation)
            at_s = observation.now_s - self.began_s
            if not isinstance(decision.reasons, Reasons):
                raise TypeError("a decision without its reasons")
            by = judged_by(state, observation, decision.reasons.inputs, after.safety)
            self.cycles.append(KeptCycle(at_s, by, observation.frame is not None))
            self.side.add(at_s, observation, decision)
            state = after
            yield

    def _first_state(self, plan: Plan) -> State:
        return initial_state(plan) if self.from_s else first_state(self.recording, plan)

    def decide_with(self, plan: Plan) -> ReplaySide:
        """Find what another plan would have decided on the cycles that are kept."""
        rules = judged_apart(self.configuration.plan, plan)
        if rules is not None:
            return self.judge_apart(plan, rules)
        side = _new_side(plan)
        again = decisions(self.recording, plan, from_s=self.began_s + self.from_s if self.from_s else None)
        for cycle, (_, observation, decision) in zip(self.cycles, again, strict=False):
            side.add(cycle.at_s, observation, decision)
        return side

    def judge_apart(self, plan: Plan, rules: tuple[int, ...]) -> ReplaySide:
        """Find what a plan would have decided, of which these rules alone are judged again; see `judged_apart`."""
        some = replace(plan, rules=tuple(plan.rules[index] for index in rules))
        names = frozenset(rule.name for rule in some.rules)
        side = ReplaySide(Tally(some), {name: lane for name, lane in self.side.rules.items() if name not in names})
        first = self._first_state(plan).rules
        before = with_steps(some, tuple(first.steps[index] for index in rules), first.first_out, first.raised_at_s)
        active: tuple[bool | None, ...] = ()
        for at_s, by, has_frame in self.cycles:
            commands = tuple([each for each in by.commands if each.rule in names or not each.rule])
            before, outcome = judge(before, by.inputs, by.sample, by.cycle, commands)
            side.tally.events += outcome.events
            if has_frame:
                side.tally.add_silence(by.inputs.tracks, before.traces)
            if active != (active := tuple([trace.active for trace in before.traces])):
                side.add_lanes(at_s, before.traces)
        side.add_lanes(self.seconds, before.traces)
        side.tally = self.side.tally.with_rules(plan, side.tally)
        return side


def _new_side(plan: Plan) -> ReplaySide:
    return ReplaySide(Tally(plan), {rule.name: Lane() for rule in plan.rules})


def judged_apart(old: Plan, new: Plan) -> tuple[int, ...] | None:
    """Return the positions of the rules that must be judged again, in the order of the plan; None for everything.

    The others surely do what they did. That is not certain if anything but rules changed; if a remembered figure sums
    up what such a rule does; or if one drives a base, or counts targets, which stops while the picture does not show
    that a base moves.
    """
    same_names = [rule.name for rule in old.rules] == [rule.name for rule in new.rules]
    if not same_names or replace(old, rules=()) != replace(new, rules=()):
        return None
    asked = {rule.name: asks_for(rule) for rule in new.rules}
    groups = {rule.name: rule.group for rule in new.rules if isinstance(rule, AlarmRule) and rule.group}
    names = {now.name for was, now in zip(old.rules, new.rules, strict=True) if was != now}
    while more := {
        name
        for name in asked
        if name not in names
        and (
            asked[name] & names
            or any(name in asked[each] for each in names)
            or groups.get(name, "") in {groups[each] for each in names & groups.keys()}
        )
    }:
        names |= more
    if any(names.intersection(figure.rules) for figure in new.figures):
        return None
    has_base = any(isinstance(output, BaseOutput) for output in new.outputs)
    found = tuple(index for index, rule in enumerate(new.rules) if rule.name in names)
    for rule in (new.rules[index] for index in found):
        parts = (leaf for condition in conditions_of(rule) for leaf in leaves(condition))
        if isinstance(rule, FollowRule) or (has_base and any(isinstance(leaf, CountCondition) for leaf in parts)):
            return None
    return found
