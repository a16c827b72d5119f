"""The command ``explain``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Annotated, Any

import typer

from stadimeter.app.control.messages import as_data
from stadimeter.cli.completion import complete_rule
from stadimeter.cli.exits import plain_errors
from stadimeter.cli.operate import JsonOption, SocketOption, ask_and_introduce, print_answer
from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.config.units import parse_duration
from stadimeter.core.decision import Decision
from stadimeter.core.rules.explaining import Explanation, explain
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.replay import ReplayRun, read_recording, replay_run

_MARKS = {True: "yes    ", False: "no     ", None: "unknown"}
ROUNDING_S = 1e-6


def explain_command(
    rule: Annotated[str, typer.Argument(metavar="RULE", help="The rule.", autocompletion=complete_rule)],
    at: Annotated[
        str | None,
        typer.Option(
            "--at",
            metavar="TIME",
            help='When: a time of day, "14:03:20"; or "12.5 s": after the beginning of the recording, or ago.',
        ),
    ] = None,
    journal: Annotated[
        Path | None,
        typer.Option("--journal", metavar="FILE", help="A journal or recording; without it, the running instance."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", metavar="CONFIG", help="With --journal: other rules than the recording's; else: which instance."
        ),
    ] = None,
    socket: SocketOption = None,
    as_json: JsonOption = False,
) -> None:
    """Explain why a rule acts, or why it does not.

    Asks the running instance about this moment, or about one of the last minute. With --journal, asks a recording
    about any moment of it: everything up to there is decided again, and nothing is opened or moved.

    **Examples**

    - `stadimeter explain near`

    - `stadimeter explain near --journal run.jsonl --at "14.2 s"`

    **Exit code**: 0 done; 2 there is no such rule, recording, moment or running instance.
    """
    with plain_errors():
        if journal is None:
            answer, who_answers = ask_and_introduce("explain", {"rule": rule, **_moment(at)}, config, socket)
            lines = (who_answers, *(_in_words(each) for each in answer["rules"]))
            print_answer(answer, "\n".join(lines), as_json=as_json)
            return
        run = replay_run(read_recording(journal), config)
        explanation, since_s = explain_recording(run, rule, at)
    if as_json:
        typer.echo(json.dumps({**as_data(explanation), "since_beginning_s": round(since_s, 6)}, ensure_ascii=False))
    else:
        typer.echo(f"At {since_s:.2f} s: {_in_words(as_data(explanation))}")


def _moment(at: str | None) -> dict[str, float]:
    """Return the moment that the running instance is asked about, on the wall clock."""
    if at is None:
        return {}
    now = datetime.now().astimezone()
    return {"at_unix_s": now.timestamp() - seconds_ago(at, now)}


def _in_words(explanation: Mapping[str, Any]) -> str:
    lines = [f"{explanation['rule']}: {explanation['sentence']}"]
    if len(explanation["evidence"]) > 1:
        lines += [f"  {_MARKS[each['holds']]} {each['words']}" for each in explanation["evidence"]]
    return "\n".join(lines)


def explain_recording(run: ReplayRun, rule: str, at: str | None) -> tuple[Explanation, float]:
    """Explain a rule at a moment of a recording.

    Args:
        run: The recording, and the configuration to decide by.
        at: The moment: a time since the beginning such as ``12.5 s``, or a time of day such as ``14:03:20``, local,
            with or without its date. None for the end.

    Returns:
        The explanation of the last cycle that is not after that moment, and its time since the beginning in seconds.

    """
    until_s = None if at is None else seconds_since_the_beginning(at, run.recording.header.began_at)
    began_s, last_s, decision = None, 0.0, None
    for _, observation, decided in run:
        began_s = observation.now_s if began_s is None else began_s
        if until_s is not None and observation.now_s - began_s > until_s + ROUNDING_S:
            return _explain_decision(decision or decided, rule), last_s
        decision, last_s = decided, observation.now_s - began_s
    if decision is None:
        raise ConfigError([Problem(f"{run.recording.path} holds no cycle, so there is nothing to explain")])
    if until_s is not None and until_s > last_s + 1.0:
        message = f"'{at}' is {until_s:.1f} s after the beginning, and the recording ends after {last_s:.1f} s"
        raise ConfigError([Problem(message, key="--at")])
    return _explain_decision(decision, rule), last_s


def _explain_decision(decision: Decision, name: str) -> Explanation:
    """Explain a rule of that moment: a reload before or after it may have changed which rules there are."""
    names = [trace.rule for trace in decision.rules]
    if name not in names:
        raise ConfigError([Problem(f"there is no rule '{name}'", hint=did_you_mean_or_list(name, names))])
    return explain(decision, name)


def seconds_since_the_beginning(at: str, began_at: str) -> float:
    """Read a moment, in seconds since the beginning; below zero if it was before.

    Args:
        at: As typed: ``12.5``, ``12.5 s``, ``14:03``, ``14:03:20.5`` or ``2026-06-01 14:03:20``.
        began_at: When the recording began, ISO 8601; anything else in a damaged one.
    """
    after_s = _duration_s(at)
    if after_s is not None:
        return after_s
    try:
        began = datetime.fromisoformat(began_at).astimezone()
    except (ValueError, OverflowError) as error:
        message = f"'{at}' cannot be found: the recording does not say when it began"
        hint = 'write a time since the beginning, such as "12.5 s"'
        raise ConfigError([Problem(message, key="--at", hint=hint)]) from error
    try:
        return (_time_of_day(at, began) - began).total_seconds()
    except (ValueError, OverflowError) as error:
        hint = 'write a time since the beginning, such as "12.5 s", or a time of day, such as "14:03:20"'
        raise ConfigError([Problem(f"'{at}' is no moment", key="--at", hint=hint)]) from error


def seconds_ago(at: str, now: datetime) -> float:
    """Read a moment that is over, in seconds before now: ``12.5 s``, or a time of day; else `ConfigError`."""
    ago_s = _duration_s(at)
    if ago_s is not None:
        return ago_s
    return 12 * 3600.0 - seconds_since_the_beginning(at, (now - timedelta(hours=12)).isoformat())


def _duration_s(text: str) -> float | None:
    """Return a duration, in seconds unless it has a unit; None if it is none."""
    for written in (text, f"{text} s"):
        with suppress(ValueError):
            return parse_duration(written)
    return None


def _time_of_day(at: str, began: datetime) -> datetime:
    """Return the first such time of day that is not before the recording began."""
    if any(mark in at for mark in "-T "):
        found = datetime.fromisoformat(at)
        return found if found.tzinfo else found.replace(tzinfo=began.tzinfo)
    day: date = began.date()
    found = datetime.combine(day, time.fromisoformat(at), began.tzinfo)
    # The label of the beginning is rounded, so a moment just before it is meant to be it.
    return found if found >= began - timedelta(seconds=1) else found + timedelta(days=1)
