"""Findings of checks, and the problems that they become once their lines are looked up."""

from __future__ import annotations

import difflib
import re
import tomllib
import typing
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from msgspec import Struct
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from stadimeter.config.addresses import words_for_people
from stadimeter.config.toml_lines import KeyPath, SourceSpan, find_span
from stadimeter.config.units import si_unit_of
from stadimeter.errors import Problem

# The code of a finding that has none of its own.
OTHER = "other"

# The longest messages list what could have been written; longer ones repeat what was.
_MAX_LENGTH = 600

# The code of a mistake in a test of rules.
OF_A_TEST = "test"


class Finding(Struct, frozen=True):
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


@cache
def hints() -> dict[str, Any]:
    """Return the tables of ``hints.toml``, which says what each is."""
    return tomllib.loads(Path(__file__).with_name("hints.toml").read_text("utf-8"))


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a question such as ``did you mean 'below'?``, or an empty string if no known word is meant for sure.

    That is another program's word for it, one that is written nearly so, or the only one that begins so.
    """
    words, others = list(known), hints()["words"]
    plain = re.sub(r"_([cm]?m|in|inch|ft|deg)$", "", re.sub(r"[\s-]+", "_", word.strip().lower()))
    one = plain.removesuffix("s")
    close = [each for each in words if one == each.removesuffix("s") or plain in others.get(each, "").split()]
    if not close and not any(plain in each.split() for each in others.values()):
        lower = {each.lower(): each for each in words}
        alike = difflib.get_close_matches(word.lower(), lower, n=1, cutoff=0.75)
        begun = [each for each in lower if each.startswith(plain) or plain.startswith(f"{each}_")] * (len(plain) > 2)
        ends = [each for each in lower if each.endswith(f"/{plain}")]  # of a time zone, the city
        close = [lower[each] for each in alike or ends[:1] or begun * (len(begun) == 1)]
    return f"did you mean '{close[0]}'?" if close else ""


def did_you_mean_or_list(word: str, known: Iterable[str]) -> str:
    """Return a question such as ``did you mean 'below'?``, or else ``known are: above, below``."""
    words = sorted(known)
    return did_you_mean(word, words) or (f"known are: {', '.join(words)}" if words else "")


def problems(findings: Iterable[Finding], file: str, spans: Mapping[KeyPath, SourceSpan]) -> tuple[Problem, ...]:
    """Give findings their lines, in the order of the file, and leave passwords out of addresses."""
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
    return text if len(text) <= _MAX_LENGTH else f"{text[:_MAX_LENGTH]}…"


_MAX_VALUE_LENGTH = 60

# Complaints about the kind of a value, by the beginning of pydantic's name for the error.
_KINDS = {
    "bool": "neither true nor false",
    "bytes": "not text; put it in quotes",
    "date": "not a date",
    "dict": "not a table; write it as { … }",
    "float": "not a number",
    "frozen_set": "not a list; write it as [ … ]",
    "int": "not a whole number",
    "is_instance": "of the wrong kind",
    "list": "not a list; write it as [ … ]",
    "mapping": "not a table; write it as { … }",
    "model": "not a table; write it as { … }",
    "path": "not a path; put it in quotes",
    "set": "not a list; write it as [ … ]",
    "string": "not text; put it in quotes",
    "tuple": "not a list; write it as [ … ]",
}

# The same for limits, by pydantic's full name for the error.
_LIMITS = {
    "finite_number": "not a finite number",
    "greater_than": "not above {gt}",
    "greater_than_equal": "below {ge}",
    "less_than": "not below {lt}",
    "less_than_equal": "above {le}",
    "multiple_of": "not a multiple of {multiple_of}",
    "string_pattern_mismatch": "not of the form {pattern}",
    "string_too_long": "longer than {max_length} characters",
    "string_too_short": "shorter than {min_length} characters",
    "too_long": "a list of more than {max_length} entries",
    "too_short": "a list of fewer than {min_length} entries",
}


def findings_of(
    error: ValidationError,
    model: type[BaseModel],
    table: Mapping[str, Any],
    at: KeyPath,
    also_known: Iterable[str] = (),
) -> Iterator[Finding]:
    """Say in plain words what is wrong with a table.

    Args:
        also_known: Keys that the table may hold besides the model's.

    Yields:
        One finding for each key that is wrong, however many ways it could have been right.
    """
    by_path: dict[KeyPath, tuple[Any, list[ErrorDetails]]] = {}
    found = error.errors(include_url=False)
    for details in found:
        if details["type"] == "too_short" and _has_wrong_entries(details, found):
            continue
        path, value = _path_and_value(table, details)
        by_path.setdefault(path, (value, []))[1].append(details)
    for path, (value, complaints) in by_path.items():
        known = [*known_keys(model, path[:-1]), *(also_known if len(path) == 1 else ())]
        elsewhere = {key: hint for each in _models_at(model, path[:-1]) for key, hint in _elsewhere(each).items()}
        yield _finding((*at, *path), complaints, known, value, elsewhere)


def _has_wrong_entries(of_list: ErrorDetails, found: Iterable[ErrorDetails]) -> bool:
    """Check whether entries of a list are wrong: pydantic counts only the others, and takes the list for too short."""
    at = of_list["loc"]
    return any(len(each["loc"]) > len(at) and each["loc"][: len(at)] == at for each in found)


def known_keys(model: type[BaseModel], path: KeyPath = ()) -> list[str]:
    """Return the keys that a table may hold.

    Args:
        path: The way from there to the table in question.

    Returns:
        The keys as they are written; none where the way leads out of the model.
    """
    return [key for each in _models_at(model, path) for key, _ in _fields(each)]


def _models_at(model: type[BaseModel], path: KeyPath) -> list[type[BaseModel]]:
    models: list[type[BaseModel]] = [model]
    for part in path:
        if isinstance(part, str):
            fields = [field for each in models for key, field in _fields(each) if key == part]
            # What is no key of theirs is a name in a table of tables, which leads no further.
            models = [inner for annotation in fields for inner in _models_in(annotation)] if fields else models
    return models


def _elsewhere(model: type[BaseModel]) -> Mapping[str, str]:
    """Return the text to write in place of keys that people try in a table, those of its bases included."""
    of_each = (vars(each).get("written_elsewhere", {}) for each in reversed(model.__mro__))
    return {key: hint for hints in of_each for key, hint in hints.items()}


def format_value(value: object) -> str:
    """Write a value of TOML shortly, such as ``'35 cm'``, ``true`` or ``[1, 2]``."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list):
        text = f"[{', '.join(format_value(entry) for entry in value)}]"
    else:
        text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= _MAX_VALUE_LENGTH else f"{text[:_MAX_VALUE_LENGTH]}…"


def _fields(model: type[BaseModel]) -> Iterator[tuple[str, Any]]:
    for name, field in model.model_fields.items():
        yield field.alias or name, field.annotation


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from _models_in(argument)


def _path_and_value(table: Mapping[str, Any], details: ErrorDetails) -> tuple[KeyPath, Any]:
    """Leave out what pydantic adds to a path to name an alternative: the file holds no such key."""
    path: KeyPath = ()
    value: Any = table
    *_, last = details["loc"] or ("",)
    for part in details["loc"]:
        try:
            value = value[part]
        except (LookupError, TypeError):
            if details["type"] != "missing" or part != last:
                continue
        path = (*path, part)
    return path, value


def _finding(
    path: KeyPath, complaints: list[ErrorDetails], known: list[str], written: Any, elsewhere: Mapping[str, str]
) -> Finding:
    key = str(path[-1]) if path else ""
    types = {details["type"] for details in complaints}
    if "extra_forbidden" in types:
        others = [word for word in known if word != key]
        hint = elsewhere.get(key) or did_you_mean_or_list(key, others)
        return Finding(path, f"unknown key '{key}'", hint, "unknown-key")
    if "missing" in types:
        return Finding(path, f"'{key}' is missing", code="missing-key")
    sentences = _unique(_sentence(details) for details in complaints)
    if any(sentences):
        return Finding(path, "; ".join(filter(None, sentences)), code="bad-value")
    wrong = " and ".join(_unique(_complaint(details, written) for details in complaints))
    return Finding(path, f"{format_value(written)} is {wrong}", _suggestion(written, complaints), "bad-value")


def _unique(texts: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(texts))


def _sentence(details: ErrorDetails) -> str:
    """Return the words of one of our own checks, which need no rewording."""
    if details["type"] in {"value_error", "assertion_error"}:
        return str(details.get("ctx", {}).get("error", ""))
    return ""


def _complaint(details: ErrorDetails, written: Any) -> str:
    name, context = details["type"], details.get("ctx", {})
    if name in _LIMITS:
        # The limit of a quantity is known only in the unit that the program computes in.
        is_quantity = isinstance(written, str) and isinstance(details["input"], float)
        unit = f" {si_unit_of(written)}" if is_quantity else ""
        limits = {key: f"{limit:.10g}" if isinstance(limit, float) else limit for key, limit in context.items()}
        return _LIMITS[name].format(**limits) + unit
    if name in {"literal_error", "enum"}:
        return f"not one of: {', '.join(_choices(details))}"
    kind = next((text for start, text in _KINDS.items() if name.startswith(start)), "")
    return kind or f"wrong: {details['msg'].removeprefix('Input ')}"


def _choices(details: ErrorDetails) -> list[str]:
    expected = str(details.get("ctx", {}).get("expected", ""))
    return re.findall(r"'([^']*)'", expected) or re.split(r", | or ", expected)


def _suggestion(value: object, complaints: list[ErrorDetails]) -> str:
    choices = [word for details in complaints if "expected" in details.get("ctx", {}) for word in _choices(details)]
    return did_you_mean(str(value), choices)
