"""An alarm with other settings, on recordings: what it would have done, what marks ask for, and the test of that."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from msgspec import Struct

from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.toml_edit import dotted
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.decision import EventKind
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import ConfigError, NotThereError, Problem
from stadimeter.workbench.replay.comparison import ReplayDiff, compare
from stadimeter.workbench.replay.lanes import ReplaySide
from stadimeter.workbench.replay.replay import read_recording
from stadimeter.workbench.replay.what_if import KEPT_CYCLES_MAX, KeptRecording
from stadimeter.workbench.rule_settings import alarm_named, with_settings
from stadimeter.workbench.teaching.marks import Mark, is_met
from stadimeter.workbench.teaching.search import Search, Taught, Values
from stadimeter.workbench.teaching.signal import signal_of


class Answer(Struct, frozen=True, kw_only=True, eq=False):
    """What a rule with other settings would have done on one recording, beside what it does."""

    name: str
    kept: KeptRecording
    after: ReplaySide
    difference: ReplayDiff

    def count(self, rule: str, change: str) -> int:
        """Return how many alarms of a rule were added or lost."""
        return sum(
            each.change == change and each.event.source == rule and each.event.kind is EventKind.RAISED
            for each in self.difference.changes
        )

    def raised(self, rule: str) -> int:
        """Return how often a rule would have been raised."""
        return next(each.new.raised for each in self.difference.rules if each.rule == rule and each.new)


class Proposal(Struct, frozen=True, kw_only=True, eq=False):
    """The smallest change that meets all marks.

    Attributes:
        text: The configuration with it.
        answers: What it would have done on each recording, with marks or without.
    """

    values: Values
    text: str
    answers: Sequence[Answer]


@dataclass(slots=True, kw_only=True)
class Lesson:
    """A configuration, its text, and recordings that are kept between questions.

    Attributes:
        recordings: By their names, the most important first: of them all, `KEPT_CYCLES_MAX` cycles are kept.
    """

    configuration: Configuration
    text: str
    recordings: dict[str, KeptRecording] = field(default_factory=dict)

    def add(self, name: str, path: Path) -> None:
        """Add a recording; `JournalError` if it cannot be read."""
        self.recordings[name] = KeptRecording(recording=read_recording(path), configuration=self.configuration)

    def go_on(self, for_s: float, clock: Callable[[], float] = time.monotonic) -> bool:
        """Read on for this long; return whether all are read, as far as they are kept."""
        until_s = clock() + for_s
        room = KEPT_CYCLES_MAX // max(1, len(self.configuration.plan.targets))
        for each in self.recordings.values():
            each.cycles_max = room
            each.go_on(until_s - clock(), clock)
            room -= len(each.cycles)
        return all(each.is_done for each in self.recordings.values())

    def load(self, rule: str, values: Mapping[str, float | str]) -> Configuration:
        """Return the configuration with other settings of a rule; `ConfigError` if it cannot be used."""
        text = with_settings(self.configuration, self.text, rule, values)
        return load_configuration(self.configuration.path, texts={self.configuration.path: text})

    def answer(self, plan: Plan) -> list[Answer]:
        """Return what another plan would have done on each recording."""
        found = []
        for name, kept in self.recordings.items():
            after = kept.decide_with(plan)
            found.append(Answer(name=name, kept=kept, after=after, difference=compare(kept.side.tally, after.tally)))
        return found

    def propose(self, rule: str, marks: Sequence[Mark]) -> Proposal:
        """Return the smallest change of an alarm that meets all marks.

        Raises:
            ConfigError: There is none, with the marks that contradict each other; or the rule is not on one limit.
            NotThereError: A mark is in a recording that is not there.
        """
        search = self._search(rule, marks)
        for values in search.best():
            new = self.load(rule, values)
            answers = self.answer(new.plan)
            if all(_meets(each, search.rule.name, marks) for each in answers):
                text = with_settings(self.configuration, self.text, rule, values)
                return Proposal(values=values, text=text, answers=answers)
        raise ConfigError([_contradiction(search, str(self.configuration.path))])

    def _search(self, name: str, marks: Sequence[Mark]) -> Search:
        _, alarm = alarm_named(self.configuration, name)
        condition = alarm.condition
        if not isinstance(condition, DistanceCondition | FigureCondition):
            hint = "drag its thresholds instead, or use `stadimeter what-if`"
            message = f"the rule '{name}' is not on one figure alone, so marks do not say which part of it to change"
            raise ConfigError([Problem(message, str(self.configuration.path), hint=hint)])
        if missing := [mark.words for mark in marks if mark.recording not in self.recordings]:
            raise NotThereError(f"there is no such recording here: {', '.join(missing)}")
        taught = [
            Taught(
                signal=signal_of(kept.cycles, alarm, condition),
                marks=[mark for mark in marks if mark.recording == recording],
                before=kept.side.rules[alarm.name].spans,
            )
            for recording, kept in self.recordings.items()
            if any(mark.recording == recording for mark in marks)
        ]
        return Search(rule=alarm, condition=condition, taught=taught)

    def tests(self, rule: str, marks: Sequence[Mark], answers: Sequence[Answer], places: Mapping[str, str]) -> str:
        """Return rule tests that hold the marks, as they are written in a configuration.

        Args:
            places: Where each recording with marks stands, relative to the configuration.
        """
        _, alarm = alarm_named(self.configuration, rule)
        return "".join(
            "\n".join(["", *_test(alarm, each, [mark for mark in marks if mark.recording == each.name], places), ""])
            for each in answers
            if each.name in places
        )


def _meets(answer: Answer, rule: str, marks: Sequence[Mark]) -> bool:
    here = [mark for mark in marks if mark.recording == answer.name]
    return all(is_met(mark, answer.after.rules[rule].spans, here) for mark in here)


def _test(alarm: AlarmRule, answer: Answer, marks: Sequence[Mark], places: Mapping[str, str]) -> Iterator[str]:
    firings = answer.after.rules[alarm.name].spans
    yield "[[tests]]"
    yield f"name = {json.dumps(f'{alarm.name} as taught on {answer.name}', ensure_ascii=False)}"
    yield f"input = {{ journal = {json.dumps(places[answer.name], ensure_ascii=False)} }}"
    yield f"expect.{dotted((alarm.name,))}.raised = {len(firings)}"
    wanted = [firing for mark in marks for firing in firings if mark.wants(firing)]
    active = sorted({f'"{(begin + end) / 2:.2f} s"' for begin, end in wanted})
    if active:
        yield f"expect.{dotted((alarm.name,))}.active_at = [{', '.join(active)}]"
    quiet = [mark for mark in marks if not mark.should_fire and not any(mark.touches(firing) for firing in firings)]
    if quiet:
        spans = (
            f'"{mark.from_s:.2f} s"'
            if mark.is_moment
            else f'{{ from = "{mark.from_s:.2f} s", for = "{mark.to_s - mark.from_s:.2f} s" }}'
            for mark in quiet
        )
        yield f"expect.{dotted((alarm.name,))}.inactive_at = [{', '.join(spans)}]"


def _contradiction(search: Search, file: str) -> Problem:
    marks = search.contradiction()
    if len(marks) == 2:
        first, second = marks
        message = f"{first.words!r} and {second.words!r} contradict each other: no settings that were tried meet both"
    elif marks:
        message = f"no settings that were tried meet {marks[0].words!r}"
    else:
        message = "no settings that were tried meet all marks together, though any two of them"
    why = "; ".join(search.describe(mark) for mark in marks)
    return Problem(message, file, hint=why or "take one back", code="contradiction")
