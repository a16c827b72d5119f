"""Which keys may stand together in the table of a condition, whether or not their values can be read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from stadimeter.config.findings import Finding, did_you_mean, known_keys
from stadimeter.config.rules.condition_tables import (
    DEEPEST,
    KEYS_OF_A_TARGET,
    KEYS_OF_NO_TARGET,
    KEYS_OF_OTHERS,
    WhenTable,
)
from stadimeter.config.toml_lines import KeyPath

_LIMITS = (("above", "below"), ("between",))
_KINDS = (*_LIMITS, *((key,) for key in (*KEYS_OF_A_TARGET, *KEYS_OF_NO_TARGET, *KEYS_OF_OTHERS)))
"""What a condition can be: keys of exactly one of these groups are in its table."""

_ABOUT_DISTANCE = ("of", "deadband", "deadband_sigmas", "probability", "probability_off")
_BETWEEN_LIMITS = ("bearing", "elevation", "closing_speed", "separation")
_INSIDE = ("bearing", "elevation", "closing_speed", "time_to_contact", "separation")
"""Conditions that are a table of their own, in which their deadbands and probabilities stand."""

_NAMED = [key for group in _KINDS for key in group]
_KNOWN = known_keys(WhenTable)
_ONE_OF = f"write one of {', '.join(_NAMED[:-1])} and {_NAMED[-1]}"


def written_condition(at: KeyPath, table: Mapping[str, Any], depth: int = 1) -> Iterator[Finding]:
    """Check which keys stand in the table of a condition, and in those of the conditions that it is made of.

    Args:
        at: Where the table stands.
        table: The table as it was written.
        depth: How many conditions it stands inside of, itself included.

    Yields:
        What is wrong.
    """
    if depth > DEEPEST:
        message = f"conditions stand inside each other more than {DEEPEST} deep"
        yield Finding(at, message, "make rules of some of them, and ask for those with rule", "too-deep")
        return
    groups = [[key for key in group if key in table] for group in _KINDS]
    written = [used for used in groups if used]
    yield from _one_kind(at, table, written)
    if len(written) == 1:
        yield from _meaningless(at, table, written[0][0])
    yield from _inner_tables(at, table)
    for path, part in _parts(at, table):
        yield from written_condition(path, part, depth + 1)


def _one_kind(at: KeyPath, table: Mapping[str, Any], written: list[list[str]]) -> Iterator[Finding]:
    if len(written) > 1:
        names = ", ".join(" and ".join(used) for used in written)
        message = f"a condition cannot have {names} at once"
        yield Finding(at, message, "put each into a table of its own: all = [{ … }, { … }], or any", "condition-keys")
    misspelt = any(did_you_mean(key, _NAMED) for key in table if key not in _KNOWN)
    if not written and not misspelt:
        yield Finding(at, "the condition is empty", _ONE_OF, "condition-keys")


def _meaningless(at: KeyPath, table: Mapping[str, Any], kind: str) -> Iterator[Finding]:
    if kind in _LIMITS[0] or kind in _LIMITS[1]:
        return
    for key in (key for key in _ABOUT_DISTANCE if key in table):
        hint = f"write it inside {kind}" if kind in _INSIDE and key != "of" else "leave it out"
        yield Finding((*at, key), f"'{key}' has no meaning beside '{kind}'", hint, "condition-keys")
    if kind not in KEYS_OF_A_TARGET and "target" in table:
        hint = (
            "write it inside each condition that is about another target" if kind in KEYS_OF_OTHERS else "leave it out"
        )
        yield Finding((*at, "target"), f"'target' has no meaning beside '{kind}'", hint, "condition-keys")


def _inner_tables(at: KeyPath, table: Mapping[str, Any]) -> Iterator[Finding]:
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    for key in (key for key in _BETWEEN_LIMITS if key in inner):
        yield from _limits((*at, key), inner[key])
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


def _limits(at: KeyPath, table: Mapping[str, Any]) -> Iterator[Finding]:
    written = [" and ".join(used) for group in _LIMITS if (used := [key for key in group if key in table])]
    if len(written) > 1:
        message = f"a condition cannot have {', '.join(written)} at once"
        yield Finding(at, message, "write above, below, both of these, or between", "condition-keys")
    names = [key for group in _LIMITS for key in group]
    if not written and not any(did_you_mean(key, names) for key in table):
        yield Finding(at, f"'{at[-1]}' has no limit", "write above, below, both of these, or between", "condition-keys")


def _parts(at: KeyPath, table: Mapping[str, Any]) -> Iterator[tuple[KeyPath, Mapping[str, Any]]]:
    for key in ("all", "any"):
        entries = table.get(key)
        for number, entry in enumerate(entries if isinstance(entries, list) else ()):
            if isinstance(entry, Mapping):
                yield (*at, key, number), entry
    if isinstance(table.get("not"), Mapping):
        yield (*at, "not"), table["not"]
