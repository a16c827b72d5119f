"""Rules that drive one output: who wins, and who never does."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from stadimeter.config.analysis import ASSUMED_RATE_HZ, Subject, delay_s
from stadimeter.config.analysis.overlap import is_always_open, range_of
from stadimeter.config.draft import BASE_NAME
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import CompiledRule
from stadimeter.core.decision import Severity
from stadimeter.core.rule import AlarmRule, AnyRule, LostPolicy

# A rule that wins an output for no longer than this, because the winner waits longer, has hardly any effect.
MOMENT_S = 1.0

# Outputs that more rules drive are not looked at: every rule is held against every other one.
MAX_RIVALS = 200


def priority_warnings(subject: Subject) -> Iterator[Finding]:
    """Find alarms that drive one actuator with one priority, and are hardly meant to be combined."""
    for rivals in _rivals(subject):
        alarms = [each for each in rivals if isinstance(each.rule, AlarmRule)]
        for position, later in enumerate(alarms):
            for earlier in alarms[:position]:
                if earlier.rule.priority == later.rule.priority and earlier.section != later.section:
                    yield from _badly_combined(subject, earlier, later)


def _badly_combined(subject: Subject, earlier: CompiledRule, later: CompiledRule) -> Iterator[Finding]:
    output, priority = later.rule.output or "", later.rule.priority
    table = subject.draft.output_tables.get(output)
    if output == BASE_NAME or (table and "combine" in table.model_fields_set):
        return
    levels = [getattr(each.rule, "level", 1.0) for each in (earlier, later)]
    patterns = [getattr(each.rule, "pattern", None) for each in (earlier, later)]
    both = f"'{earlier.section}' and '{later.section}' drive '{output}' with priority {priority}"
    if 0.0 in levels and any(levels):
        silent = (earlier, later)[levels.index(0.0)]
        message = f"{both}, and the highest level counts: level 0 of '{silent.section}' never does"
    elif all(patterns) and _may_meet(earlier.rule, later.rule):
        silent, message = later, f"{both}, and may act at once: their patterns mix"
    else:
        return
    hint = f"give the one that shall win a higher priority, such as priority = {priority + 100}"
    yield Finding(silent.at("priority"), message, hint, "equal-priority")


def shadow_errors(subject: Subject) -> Iterator[Finding]:
    """Find safety rules that never win their output."""
    return (finding for loser, finding in _shadowed(subject) if loser.rule.severity is Severity.SAFETY)


def shadow_warnings(subject: Subject) -> Iterator[Finding]:
    """Find other rules that never win their output."""
    return (finding for loser, finding in _shadowed(subject) if loser.rule.severity is not Severity.SAFETY)


def _rivals(subject: Subject) -> Iterator[list[CompiledRule]]:
    """Yield the rules that drive each output, except for outputs with more than `MAX_RIVALS`."""
    by_output: dict[str, list[CompiledRule]] = defaultdict(list)
    for declared in subject.every_rule:
        if declared.rule.output is not None and not declared.rule.observe:
            by_output[declared.rule.output].append(declared)
    return (rivals for rivals in by_output.values() if len(rivals) <= MAX_RIVALS)


def _may_meet(first: AnyRule, second: AnyRule) -> bool:
    one, other = range_of(first), range_of(second)
    return one is None or other is None or one.meets(other)


def _shadowed(subject: Subject) -> Iterator[tuple[CompiledRule, Finding]]:
    reported: set[str] = set()
    for rivals in _rivals(subject):
        for loser in rivals:
            winner = next((each for each in rivals if _goes_before(each.rule, loser.rule)), None)
            if winner is not None and loser.section not in reported:
                reported.add(loser.section)
                yield loser, _loses(loser, winner)


def _goes_before(winner: AnyRule, loser: AnyRule) -> bool:
    """Check whether a rule surely drives the output in place of another one, wherever that one holds."""
    if winner.priority <= loser.priority or not is_always_open(winner):
        return False
    if isinstance(loser, AlarmRule) and (loser.latch or loser.lost.policy is LostPolicy.ASSERT):
        return False  # it can be active where its condition does not hold
    wide, narrow = range_of(winner), range_of(loser)
    if wide is None or narrow is None or narrow.is_empty or not wide.covers(narrow):
        return False
    if not isinstance(winner, AlarmRule):
        return True
    if winner.at_start == "announce":
        return False
    waits_s = delay_s(loser, ASSUMED_RATE_HZ) if isinstance(loser, AlarmRule) else 0.0
    stays_s = loser.off_delay_s if isinstance(loser, AlarmRule) else 0.0
    return delay_s(winner, ASSUMED_RATE_HZ) <= waits_s + MOMENT_S and stays_s <= winner.off_delay_s + MOMENT_S


def _loses(loser: CompiledRule, winner: CompiledRule) -> Finding:
    output, name = loser.rule.output, winner.rule.name
    message = (
        f"wherever '{loser.section}' holds, '{name}' holds too and wins '{output}': '{loser.section}' never drives it, "
        "or for a moment only"
    )
    hint = f"give '{loser.section}' the higher priority, or make '{name}' hold in fewer situations"
    return Finding(loser.path, message, hint, "shadowed")
