"""Findings of checks, and the problems that they become once their lines are looked up."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from stadimeter.config.addresses import words_for_people
from stadimeter.config.toml_lines import KeyPath, SourceSpan, find_span
from stadimeter.errors import Problem

OTHER = "other"
"""The code of what has none of its own."""

MOST_EXPLAINED = 1000
"""More wrong keys of one table than this are only counted: to look for similar words takes 0.1 ms for each."""

_LONGEST = 600
"""The longest messages list what could have been written; longer ones repeat what was."""

OF_A_TEST = "test"
"""The code of what is wrong in a test of rules."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong, or worth a warning, at a path of the configuration.

    Attributes:
        message: What is wrong, with the value, in one sentence.
        hint: What to do about it, or an empty string.
        code: The kind of problem, for programs.
    """

    path: KeyPath
    message: str
    hint: str = ""
    code: str = ""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a question that offers the likeliest of the known words.

    Returns:
        Such as ``did you mean 'below'?``, or an empty string if none is close.
    """
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"did you mean '{close[0]}'?" if close else ""


def did_you_mean_or_list(word: str, known: Iterable[str]) -> str:
    """Return a question that offers the likeliest of the known words, or else all of them.

    Returns:
        Such as ``did you mean 'below'?`` or ``known are: above, below``.
    """
    words = sorted(known)
    return did_you_mean(word, words) or (f"known are: {', '.join(words)}" if words else "")


def problems(findings: Iterable[Finding], file: str, spans: Mapping[KeyPath, SourceSpan]) -> tuple[Problem, ...]:
    """Give findings their lines, in the order of the file.

    Returns:
        One problem for each finding, without passwords in the addresses that it repeats.
    """
    located = [(find_span(spans, finding.path), finding) for finding in findings]
    located.sort(key=lambda pair: (pair[0].line, pair[0].column) if pair[0] else (0, 0))
    return tuple(
        Problem(
            message=_readable(words_for_people(finding.message)),
            file=file,
            line=span.line if span else 0,
            column=span.column if span else 0,
            end_column=span.end_column if span else 0,
            key=".".join(str(part) or '""' for part in finding.path),
            hint=_readable(words_for_people(finding.hint)),
            code=finding.code or (OF_A_TEST if finding.path[:1] == ("tests",) else OTHER),
        )
        for span, finding in located
    )


def _readable(text: str) -> str:
    """Cut what repeats a value of many pages."""
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
