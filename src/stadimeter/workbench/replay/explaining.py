"""Explains what a rule did at a moment of a recording: decides again up to there, and asks."""

from __future__ import annotations

from datetime import date, datetime, time, timedelta

from stadimeter.config.units import parse_duration
from stadimeter.core.decision import Decision
from stadimeter.core.rules.explaining import Explanation, explain
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.replay.replay_run import ReplayRun

ROUNDING_S = 1e-6


def explain_recording(run: ReplayRun, rule: str, at: str | None) -> tuple[Explanation, float]:
    """Explain a rule at a moment of a recording.

    Args:
        run: The recording, and the configuration to decide by.
        at: The moment: a time since the beginning such as ``12.5 s``, or a time of day such as ``14:03:20``, local,
            with or without its date. None for the end.

    Returns:
        The explanation of the last cycle that is not after that moment, and its time since the beginning in seconds.

    Raises:
        ConfigError: There is no such rule, no such moment, or the text is no moment.
        JournalError: The recording is damaged.
    """
    until_s = None if at is None else seconds_since_the_beginning(at, run.recording.header.began_at)
    began_s, last_s, decision = None, 0.0, None
    for _, observation, decided in run:
        began_s = observation.now_s if began_s is None else began_s
        if until_s is not None and observation.now_s - began_s > until_s + ROUNDING_S:
            return _explained(decision or decided, rule), last_s
        decision, last_s = decided, observation.now_s - began_s
    if decision is None:
        raise ConfigError([Problem(f"{run.recording.path} holds no cycle, so there is nothing to explain")])
    if until_s is not None and until_s > last_s + 1.0:
        message = f"'{at}' is {until_s:.1f} s after the beginning, and the recording ends after {last_s:.1f} s"
        raise ConfigError([Problem(message, key="--at")])
    return _explained(decision, rule), last_s


def _explained(decision: Decision, name: str) -> Explanation:
    """Explain a rule that there was at that moment: a configuration may have been taken over before, or after."""
    names = [trace.rule for trace in decision.rules]
    if name not in names:
        from stadimeter.config.findings import did_you_mean_or_list  # noqa: PLC0415 - needed in this case only

        raise ConfigError([Problem(f"there is no rule '{name}'", hint=did_you_mean_or_list(name, names))])
    return explain(decision, name)


def seconds_since_the_beginning(at: str, began_at: str) -> float:
    """Read a moment.

    Args:
        at: What somebody wrote: ``12.5``, ``12.5 s``, ``14:03``, ``14:03:20.5`` or ``2026-06-01 14:03:20``.
        began_at: When the recording began, ISO 8601.

    Returns:
        The moment, in seconds since the beginning; below zero if it was before.

    Raises:
        ConfigError: It is none of these.
    """
    if _is_duration(at):
        return parse_duration(f"{at} s" if _is_number(at) else at)
    began = datetime.fromisoformat(began_at).astimezone()
    try:
        return (_time_of_day(at, began) - began).total_seconds()
    except ValueError as error:
        hint = 'write a time since the beginning, such as "12.5 s", or a time of day, such as "14:03:20"'
        raise ConfigError([Problem(f"'{at}' is no moment", key="--at", hint=hint)]) from error


def seconds_ago(at: str, now: datetime) -> float:
    """Read a moment that is over.

    Args:
        at: What somebody wrote: ``12.5 s`` for so long ago, or a time of day.

    Returns:
        How long ago that was, in seconds.

    Raises:
        ConfigError: It is no moment.
    """
    since_s = seconds_since_the_beginning(at, (now - timedelta(hours=12)).isoformat())
    return since_s if _is_duration(at) else 12 * 3600.0 - since_s


def _is_duration(text: str) -> bool:
    try:
        parse_duration(f"{text} s" if _is_number(text) else text)
    except ValueError:
        return False
    return True


def _time_of_day(at: str, began: datetime) -> datetime:
    """Return the first such time of day that is not before the recording began."""
    if any(mark in at for mark in "-T "):
        found = datetime.fromisoformat(at)
        return found if found.tzinfo else found.replace(tzinfo=began.tzinfo)
    day: date = began.date()
    found = datetime.combine(day, time.fromisoformat(at), began.tzinfo)
    # The label of the beginning is rounded, so a moment just before it is meant to be it.
    return found if found >= began - timedelta(seconds=1) else found + timedelta(days=1)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
