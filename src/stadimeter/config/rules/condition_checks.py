"""Which keys may stand together in the table of a condition, whether or not their values can be read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from stadimeter.config.findings import Finding, did_you_mean, known_keys
from stadimeter.config.rules.condition_tables import (
    DEEPEST,
    KEYS_ABOUT_DISTANCE,
    KEYS_OF_A_TARGET,
    KEYS_OF_NO_TARGET,
    KEYS_OF_OTHERS,
    WhenTable,
)
from stadimeter.config.toml_lines import KeyPath

_LIMITS = (("above", "below"), ("between",))
_KINDS = (*_LIMITS, *((key,) for key in (*KEYS_OF_A_TARGET, *KEYS_OF_NO_TARGET, *KEYS_OF_OTHERS)))
"""What a condition can be; a table with keys of several of these groups is short for all of them."""

_BETWEEN_LIMITS = ("bearing", "elevation", "closing_speed", "separation")
_INSIDE = ("bearing", "elevation", "closing_speed", "time_to_contact", "separation")
"""Conditions that are a table of their own, in which their deadbands and probabilities stand."""

_LIMITS_FORM = "write above, below, both of these, or between"
_NAMED = [key for group in _KINDS for key in group]
_KNOWN = known_keys(WhenTable)
_ONE_OF = f"write one of {', '.join(_NAMED[:-1])} and {_NAMED[-1]}"


def written_condition(at: KeyPath, table: Mapping[str, Any], depth: int = 1) -> Iterator[Finding]:
    """Check which keys stand in the table of a condition, and in those of the conditions that it is made of.

    Args:
        depth: How many conditions it stands inside of, itself included.
    """
    if depth > DEEPEST:
        message = f"conditions stand inside each other more than {DEEPEST} deep"
        yield Finding(at, message, "make rules of some of them, and ask for those with rule", "too-deep")
        return
    written = [key for group in _KINDS for key in group if key in table]
    yield from _not_empty(at, table, written)
    yield from _limits_of_one_form(at, table)
    if written:
        yield from _meaningless(at, table, written)
    yield from _inner_tables(at, table)
    for path, part in _parts(at, table):
        yield from written_condition(path, part, depth + 1)


def _not_empty(at: KeyPath, table: Mapping[str, Any], written: list[str]) -> Iterator[Finding]:
    misspelt = any(did_you_mean(key, _NAMED) for key in table if key not in _KNOWN)
    if not written and not misspelt:
        yield Finding(at, "the condition is empty", _ONE_OF, "condition-keys")


def _meaningless(at: KeyPath, table: Mapping[str, Any], written: list[str]) -> Iterator[Finding]:
    if any(key in group for group in _LIMITS for key in written):
        return
    kinds = " and ".join(f"'{kind}'" for kind in written)
    inside = next((kind for kind in written if kind in _INSIDE), "")
    for key in (key for key in KEYS_ABOUT_DISTANCE if key in table):
        hint = f"write it inside {inside}" if inside and key != "of" else "leave it out"
        yield Finding((*at, key), f"'{key}' has no meaning beside {kinds}", hint, "condition-keys")
    if "target" in table and not any(kind in KEYS_OF_A_TARGET for kind in written):
        of_others = any(kind in KEYS_OF_OTHERS for kind in written)
        hint = "write it inside each condition that is about another target" if of_others else "leave it out"
        yield Finding((*at, "target"), f"'target' has no meaning beside {kinds}", hint, "condition-keys")


def _inner_tables(at: KeyPath, table: Mapping[str, Any]) -> Iterator[Finding]:
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    for key in (key for key in _BETWEEN_LIMITS if key in inner):
        yield from _limits_of_one_form((*at, key), inner[key])
        yield from _any_limit((*at, key), inner[key])
    if "count" in inner and not inner["count"].keys() & {"at_least", "at_most"}:
        hint = "add at_least, at_most, or both"
        yield Finding((*at, "count"), "how many targets is not said", hint, "condition-keys")
    separation = inner.get("separation", {}).get("of")
    if isinstance(separation, list) and len(separation) == 2 and separation[0] == separation[1]:
        message = f"'{separation[0]}' is always where it is itself"
        yield Finding((*at, "separation", "of"), message, "name two targets", "condition-keys")
    between = inner.get("time", {}).get("between")
    if isinstance(between, list) and len(between) == 2 and between[0] == between[1]:
        hint = 'write ["00:00", "24:00"] for the whole day'
        message = f"the time begins and ends at {between[0]}"
        yield Finding((*at, "time", "between"), message, hint, "empty-interval")


def _limits_of_one_form(at: KeyPath, table: Mapping[str, Any]) -> Iterator[Finding]:
    written = [" and ".join(used) for group in _LIMITS if (used := [key for key in group if key in table])]
    if len(written) > 1:
        message = f"a condition cannot have {', '.join(written)} at once"
        yield Finding(at, message, _LIMITS_FORM, "condition-keys")


def _any_limit(at: KeyPath, table: Mapping[str, Any]) -> Iterator[Finding]:
    names = [key for group in _LIMITS for key in group]
    if not any(key in table for key in names) and not any(did_you_mean(key, names) for key in table):
        yield Finding(at, f"'{at[-1]}' has no limit", _LIMITS_FORM, "condition-keys")


def _parts(at: KeyPath, table: Mapping[str, Any]) -> Iterator[tuple[KeyPath, Mapping[str, Any]]]:
    for key in ("all", "any"):
        entries = table.get(key)
        for number, entry in enumerate(entries if isinstance(entries, list) else ()):
            if isinstance(entry, Mapping):
                yield (*at, key, number), entry
    if isinstance(table.get("not"), Mapping):
        yield (*at, "not"), table["not"]
