"""Replays in words: events, and what other rules change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from stadimeter.core.decision import Event
from stadimeter.workbench.replay.measured_again import MeasuredAgain
from stadimeter.workbench.replay.replay import ReplayResult
from stadimeter.workbench.replay.replay_diff import EventChange, ReplayDiff, RuleChange
from stadimeter.workbench.replay.replay_figures import RuleFigures

SHOWN_CHANGES = 40
"""So many events that changed are listed; ``--json`` has all of them."""

_FIGURES: tuple[tuple[str, Callable[[RuleFigures], str]], ...] = (
    ("raised", lambda rule: str(rule.raised)),
    ("raised or cleared, a minute", lambda rule: f"{rule.transitions_per_minute:.2f}"),
    ("late, in the middle", lambda rule: _seconds(rule.late_median_s)),
    ("late, at worst", lambda rule: _seconds(rule.late_worst_s)),
    ("crossings missed", lambda rule: _count(rule.missed)),
    ("raised without a crossing", lambda rule: _count(rule.unfounded)),
    ("nearest while silent", lambda rule: _metres(rule.least_distance_m)),
)


def event_line(event: Event) -> str:
    """Return an event in a line.

    Args:
        event: The event.

    Returns:
        The line.
    """
    return f"{event.at_s:9.3f} s  {event.kind.value:<16} {event.source:<16} {event.reason}"


def comparison_lines(result: ReplayResult, *, same_rules: bool) -> Iterator[str]:
    """Return in lines how decisions compare with the recorded ones.

    Args:
        result: What came of the replay.
        same_rules: Whether the rules were those of the recording.

    Yields:
        The lines.
    """
    rules = "the configuration of the recording" if same_rules else "another configuration than the recording's"
    yield f"{result.cycles} cycles, {result.identical} decisions identical, with {rules}."
    for difference in result.differences:
        yield f"differs at {difference.now_s:.3f} s (cycle {difference.cycle}): {', '.join(difference.what)}"


def again_lines(targets: Iterable[MeasuredAgain]) -> Iterator[str]:
    """Return in lines how what was measured again compares with what was recorded.

    Args:
        targets: One for each target.

    Yields:
        The lines.
    """
    for target in targets:
        found = f"found in {target.found_again} of {target.frames} pictures, {target.found_before} when recorded"
        if target.differs_median_m is None or target.differs_most_m is None:
            yield f"{target.target}: {found}."
            continue
        apart = f"{target.differs_median_m * 1000:.1f} mm in the middle, {target.differs_most_m * 1000:.1f} mm at most"
        yield f"{target.target}: {found}; the distances differ by {apart}."


def diff_lines(diff: ReplayDiff) -> Iterator[str]:
    """Return what other rules change, in lines.

    Args:
        diff: What they change.

    Yields:
        The lines.
    """
    for change in diff.changes[:SHOWN_CHANGES]:
        yield _change_line(change)
    if len(diff.changes) > SHOWN_CHANGES:
        yield f"… and {len(diff.changes) - SHOWN_CHANGES} more; --json has all of them"
    counts = {kind: sum(change.change == kind for change in diff.changes) for kind in ("added", "lost", "moved")}
    counted = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    yield f"{diff.same} events are the same, {counted}, in {diff.minutes:.1f} minutes."
    for rule in diff.rules:
        yield from _rule_lines(rule)


def _change_line(change: EventChange) -> str:
    by = f"by {change.by_s:+.3f} s" if change.change == "moved" else ""
    return f"{change.change:<5} {by:<14} {event_line(change.event)}"


def _rule_lines(change: RuleChange) -> Iterator[str]:
    yield ""
    yield f"{change.rule:<28} {'old':>10} {'new':>10}"
    for name, shown in _FIGURES:
        old, new = (_shown(shown, figures) for figures in (change.old, change.new))
        if {old, new} != {"-"}:
            yield f"  {name:<26} {old:>10} {new:>10}"


def _shown(shown: Callable[[RuleFigures], str], figures: RuleFigures | None) -> str:
    return "-" if figures is None else shown(figures)


def _seconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds:.2f} s"


def _metres(metres: float | None) -> str:
    return "-" if metres is None else f"{metres:.2f} m"


def _count(count: int | None) -> str:
    return "-" if count is None else str(count)
