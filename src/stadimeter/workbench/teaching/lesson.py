"""An alarm with other settings, on recordings: what it would have done, what marks ask for, and the test of that."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.recordings.journal import JournalWriter
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.toml_lines import dotted
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.decision import EventKind
from stadimeter.core.plan import Plan
from stadimeter.errors import ConfigError, NotThereError, Problem
from stadimeter.workbench.replay.comparison import EventChange, ReplayDiff, ReplaySide, compare
from stadimeter.workbench.replay.replay import read_recording
from stadimeter.workbench.replay.what_if import KEPT_CYCLES_MAX, KeptRecording
from stadimeter.workbench.rule_settings import alarm_named, with_settings
from stadimeter.workbench.rule_tests.running import run_rule_test
from stadimeter.workbench.teaching.search import (
    MOMENT_S,
    Firing,
    FiringMark,
    SettingSearch,
    Taught,
    Values,
    is_met,
    signal_of,
)

# A test begins this long before its first mark, or before the alarm that stood then, and ends this long after the last.
BEFORE_S, AFTER_S = 20.0, 5.0


class Answer(Struct, frozen=True, kw_only=True, eq=False):
    """The effect that a rule with other settings would have had on one recording, beside what it does."""

    name: str
    kept: KeptRecording
    after: ReplaySide
    difference: ReplayDiff

    def counts(self, rule: str) -> tuple[int, int]:
        """Count the alarms of a rule that are added, and those that are lost."""
        found = [each.change for each in self.difference.changes if is_alarm_of(rule, each)]
        return found.count("added"), found.count("lost")

    def raised(self, rule: str) -> int:
        """Count how often a rule would have been raised."""
        return next(each.new.raised for each in self.difference.rules if each.rule == rule and each.new)


class TaughtSettings(Struct, frozen=True, kw_only=True, eq=False):
    """The smallest change that meets all marks.

    Attributes:
        values: The settings that change, by name, in the SI unit.
        marks: A moment at which an alarm should not have stood as all of that alarm.
        answers: What it would have done on each recording, with marks or without.
    """

    values: Values
    marks: Sequence[FiringMark]
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

    def add(self, name: str, path: Path, from_s: float = 0.0) -> None:
        """Add a recording, or what follows a time in it; `JournalError` if it cannot be read."""
        self.recordings[name] = KeptRecording(
            recording=read_recording(path), configuration=self.configuration, from_s=from_s
        )

    def go_on(self, for_s: float) -> bool:
        """Read on for this long; return whether all are read, as far as they are kept."""
        until_s = time.monotonic() + for_s
        room = KEPT_CYCLES_MAX // max(1, len(self.configuration.plan.targets))
        for each in self.recordings.values():
            each.cycles_max = room
            each.go_on(until_s - time.monotonic())
            room -= len(each.cycles)
        return all(each.is_done for each in self.recordings.values())

    def load(self, rule: str, values: Mapping[str, float | str]) -> Configuration:
        """Return the configuration with other settings of a rule; `ConfigError` if it cannot be used."""
        text = with_settings(self.configuration, self.text, rule, values)
        return load_configuration(self.configuration.path, texts={self.configuration.path: text})

    def answer(self, plan: Plan) -> list[Answer]:
        """List what another plan would have done on each recording."""
        found = []
        for name, kept in self.recordings.items():
            after = kept.decide_with(plan)
            found.append(Answer(name=name, kept=kept, after=after, difference=compare(kept.side.tally, after.tally)))
        return found

    def propose(self, rule: str, marks: Sequence[FiringMark]) -> TaughtSettings:
        """Return the smallest change of an alarm that meets all marks.

        Raises:
            ConfigError: There is none, with the marks that contradict each other; or the rule is not on one limit.
            NotThereError: A mark is in a recording that is not there.
        """
        search = self._search(rule, marks)
        marks = [mark for each in search.taught for mark in each.marks]
        for values in search.best():
            new = self.load(rule, values)
            answers = self.answer(new.plan)
            firings = {each.name: each.after.rules[search.rule.name].spans for each in answers}
            if all(is_met(mark, firings[mark.recording], marks) for mark in marks):
                return TaughtSettings(values=values, marks=marks, answers=answers)
        raise ConfigError([_contradiction(search, str(self.configuration.path))])

    def _search(self, name: str, marks: Sequence[FiringMark]) -> SettingSearch:
        _, alarm = alarm_named(self.configuration, name)
        condition = alarm.condition
        if not isinstance(condition, DistanceCondition | FigureCondition):
            hint = "drag its thresholds instead, or use `stadimeter what-if`"
            message = f"the rule '{name}' is not on one figure alone, so marks do not say which part of it to change"
            raise ConfigError([Problem(message, str(self.configuration.path), hint=hint)])
        if missing := [mark.words for mark in marks if mark.recording not in self.recordings]:
            raise NotThereError(f"there is no such recording here: {', '.join(missing)}")
        for mark in marks:
            if mark.from_s > (end_s := self.recordings[mark.recording].seconds) + MOMENT_S:
                raise NotThereError(f"{mark.words!r} is after the end of what was read of it, {end_s:.1f} s")
        taught = [
            Taught(
                signal=signal_of(kept.cycles, alarm, condition),
                marks=self.whole(alarm.name, [mark for mark in marks if mark.recording == recording]),
                before=kept.side.rules[alarm.name].spans,
            )
            for recording, kept in self.recordings.items()
            if any(mark.recording == recording for mark in marks)
        ]
        return SettingSearch(rule=alarm, condition=condition, taught=taught)

    def write(self, rule: str, values: Mapping[str, float | str], marks: Sequence[FiringMark]) -> tuple[str, list[str]]:
        """Return the text with other settings of a rule and tests that hold marks, and the names of these.

        What the tests need is cut out of the recordings. Without marks they hold what the change adds and takes away;
        such a test that fails, since what it was cut out of is missing, is left out.

        Raises:
            ConfigError: The text cannot be used, marks are not met, or a test that passes would fail. Nothing is left.
        """
        name = alarm_named(self.configuration, rule)[1].name
        folder = self.configuration.path.parent
        text = with_settings(self.configuration, self.text, rule, values).rstrip("\n") + "\n"
        written: dict[str, str] = {}
        wrong = list[str]()
        try:
            for each in self.answer(self.load(rule, values).plan):
                mine = [mark for mark in marks if mark.recording == each.name]
                here = self.whole(name, mine) or ([] if marks else list(changes_as_marks(name, each)))
                firings = each.after.rules[name].spans
                wrong += [f"{each.name}@{mark.from_s:g}s" for mark in mine if not is_met(mark, firings, marks)]
                if here:
                    added, test = write_test(name, each, here, folder)
                    written[test] = added
            failing = self._failing(text + "".join(written.values()))
        except BaseException:
            _delete_journals(name, written, folder)
            raise
        if wrong := [*wrong, *(test for test in failing if marks or test not in written)]:
            _delete_journals(name, written, folder)
            words = f"nothing was saved, for with these settings this would fail: {', '.join(wrong)}"
            raise ConfigError([Problem(words, str(self.configuration.path), key="tests")])
        _delete_journals(name, failing, folder)
        passing = {test: added for test, added in written.items() if test not in failing}
        return text + "".join(passing.values()), list(passing)

    def _failing(self, text: str) -> list[str]:
        """Return which tests of a text fail that do not fail already; what cannot be used is an error."""
        path = self.configuration.path
        found = load_configuration(path, texts={path: text})
        failing = [each.name for each in found.tests if not run_rule_test(found, each).passed]
        before = (each for each in self.configuration.tests if each.name in failing)
        failed = {each.name for each in before if not run_rule_test(self.configuration, each).passed}
        return [name for name in failing if name not in failed]

    def whole(self, rule: str, marks: Sequence[FiringMark]) -> list[FiringMark]:
        """Return marks, those on a moment that should not have fired as one on all of the alarm that stood there."""
        found = []
        for mark in marks:
            firings = self.recordings[mark.recording].side.rules[rule].spans
            stood = (firing for firing in firings if mark.is_moment and not mark.should_fire and mark.touches(firing))
            from_s, to_s = next(stood, (mark.from_s, mark.to_s))
            found.append(replace(mark, from_s=from_s, to_s=to_s))
        return found


def in_words(rule: str, answers: Sequence[Answer]) -> str:
    """Say how often a rule would have fired, how many of that are new, and how many of its alarms are missed."""
    raised = sum(each.raised(rule) for each in answers)
    new, missed = (sum(each.counts(rule)[place] for each in answers) for place in (0, 1))
    minutes = round(sum(each.difference.minutes for each in answers))
    times, ends, recordings = ("" if count == 1 else "s" for count in (raised, minutes, len(answers)))
    return (
        f"{rule} would have fired {raised} time{times} in {minutes} minute{ends} of {len(answers)} "
        f"recording{recordings}: {new} of them new, {missed} of yours missed."
    )


def is_alarm_of(rule: str, change: EventChange) -> bool:
    """Check whether what changed is that a rule was raised."""
    return change.event.source == rule and change.event.kind is EventKind.RAISED


def changes_as_marks(rule: str, answer: Answer) -> Iterator[FiringMark]:
    """Yield marks that say that what a change adds and takes away is right: for a threshold that was dragged."""
    for change in answer.difference.changes:
        if is_alarm_of(rule, change) and change.change != "moved":
            at_s = change.event.at_s - answer.kept.began_s
            yield FiringMark(recording=answer.name, from_s=at_s, to_s=at_s, should_fire=change.change == "added")


def write_test(rule: str, answer: Answer, marks: Sequence[FiringMark], folder: Path) -> tuple[str, str]:
    """Cut what a test needs out of a recording, without pictures; return the test as TOML, and its name.

    Args:
        marks: Those in this recording, at least one.
        folder: That of the configuration.
    """
    firings = answer.after.rules[rule].spans
    begin_s = min(mark.from_s for mark in marks) - BEFORE_S
    begin_s = min([begin_s, *(first - BEFORE_S for first, last in firings if first < begin_s <= last)])
    end_s = max(mark.to_s for mark in marks) + AFTER_S
    recording = answer.kept.recording
    begins = f"{rule.replace(':', '-')}-{Path(answer.name).stem}-{max(0.0, begin_s):.0f}s"
    # What was taught before keeps its test, and the journal of that.
    names = (begins, *(f"{begins}-{number}" for number in range(2, 1000)))
    (folder / "tests").mkdir(exist_ok=True)
    stem = next(each for each in names if _is_created(folder / f"tests/{each}.jsonl"))
    name = f"tests/{stem}.jsonl"
    writer = JournalWriter(folder / name, recording.header.recorded_configuration, recording.header.began_at)
    first_s = math.nan
    for cycle in recording.cycles():
        at_s = cycle.now_s() - answer.kept.began_s
        if begin_s <= at_s <= end_s:
            first_s = at_s if math.isnan(first_s) else first_s
            writer.write(cycle.record())
    writer.close()
    inside = [(begin - first_s, end - first_s) for begin, end in firings if first_s <= begin <= end_s]
    moved = [replace(mark, from_s=mark.from_s - first_s, to_s=mark.to_s - first_s) for mark in marks]
    test = _test_name(rule, stem)
    heading = f"\n[[tests]]\nname = {json.dumps(test)}\ninput = {{ journal = {json.dumps(name)} }}\n"
    return heading + "\n".join([*_expected(rule, inside, moved), ""]), test


def _delete_journals(rule: str, tests: Iterable[str], folder: Path) -> None:
    for each in tests:
        (folder / f"tests/{each.removeprefix(_test_name(rule, ''))}.jsonl").unlink(missing_ok=True)


def _test_name(rule: str, stem: str) -> str:
    return f"{rule} as taught: {stem}"


def _is_created(path: Path) -> bool:
    """Create a file, unless there is one already."""
    try:
        path.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def _expected(rule: str, firings: Sequence[Firing], marks: Sequence[FiringMark]) -> Iterator[str]:
    yield f"expect.{dotted((rule,))}.raised = {len(firings)}"
    wanted = [firing for mark in marks for firing in firings if mark.wants(firing)]
    if active := sorted({f'"{(begin + end) / 2:.2f} s"' for begin, end in wanted}):
        yield f"expect.{dotted((rule,))}.active_at = [{', '.join(active)}]"
    spans = [
        f'"{mark.from_s:.2f} s"'
        if mark.is_moment
        else f'{{ from = "{mark.from_s:.2f} s", for = "{mark.to_s - mark.from_s:.2f} s" }}'
        for mark in marks
        if not mark.should_fire and not any(mark.touches(firing) for firing in firings)
    ]
    if spans:
        yield f"expect.{dotted((rule,))}.inactive_at = [{', '.join(spans)}]"


def _contradiction(search: SettingSearch, file: str) -> Problem:
    marks = search.contradiction()
    if len(marks) == 2:
        first, second = marks
        message = f"{first.words!r} and {second.words!r} contradict each other: no settings that were tried meet both"
    elif marks:
        message = f"no settings that were tried meet {marks[0].words!r}"
    else:
        message = "no settings that were tried meet all marks together, though any two of them"
    why = "; ".join(search.describe(mark) for mark in marks)
    return Problem(message, file, hint=why or "take one back")
