"""Secrets that stand in a configuration, which is shown, recorded and shared: they are taken out of its text.

There are two kinds. What a driver declares as a `pydantic.SecretStr` is a secret as a whole. An address is often one in
part (see `addresses`): that part of every address is left out, wherever it stands in the file, comments included.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import SecretStr

from stadimeter.config.addresses import address_for_people, words_for_people
from stadimeter.config.draft import Draft
from stadimeter.config.findings import Finding
from stadimeter.config.toml_lines import KeyPath, SourceSpan

# Stands in place of a secret in the text that is recorded.
HIDDEN = "hidden://"

# Words in an address that most likely holds a secret. Others, such as ``?action=stream``, deserve no warning.
_TEXT_VALUE = re.compile(r"""(?:^|(?<==))\s*("(?:[^"\\]|\\.)*"|'[^']*')\s*$""")
_SCHEME = re.compile(r"\s*[\w+.-]+://")
_TELLING = re.compile(r"@|\w*(?:pass|pw|token|key|secret|auth|sig|cred)\w*=", re.IGNORECASE)

# The sections in which an address is a part of a sentence.
_TEXT_FOR_PEOPLE = frozenset({"rules", "tests"})


def secret_warnings(draft: Draft) -> Iterator[Finding]:
    """Find secrets that stand in a configuration."""
    for path in _secrets(draft):
        if _value(draft.table, path) != HIDDEN:
            message = "this may hold a secret, and configurations are shown and shared"
            hint = f'put it into a file of its own and write {path[-1]}_file = "…"'
            yield Finding(path, message, hint, "secret")
    for path, text in _addresses(draft):
        if path[0] not in _TEXT_FOR_PEOPLE and text != _without_secrets(path, text) and _TELLING.search(text):
            message = "this address holds a password or a token, and configurations are shown and shared"
            yield Finding(path, f"{message}; journals and recordings leave it out", _hint(draft, path), "secret")


def without_secrets(draft: Draft, text: str, spans: Mapping[KeyPath, SourceSpan]) -> tuple[str, tuple[Finding, ...]]:
    """Return the text of a configuration as it may be recorded.

    Returns:
        The text with something else for each secret; and what is wrong with a secret that cannot be taken out.
    """
    safe = {path: shown for path, value in _addresses(draft) if (shown := _without_secrets(path, value)) != value}
    safe |= dict.fromkeys(_secrets(draft), HIDDEN)
    lines = text.split("\n")
    hint = "write it as text in simple quotes on the line of its key"
    findings = []
    for path in sorted(safe, key=lambda path: spans[path].column if path in spans else 0, reverse=True):
        span = spans.get(path)  # the last of a line first, so that the others stay where they are
        before = lines[span.line - 1] if span else ""
        hidden, count = _replaced(before[span.column : span.end_column], safe[path]) if span else ("", 0)
        if span and count:
            lines[span.line - 1] = before[: span.column] + hidden + before[span.end_column :]
        elif safe[path] == HIDDEN or words_for_people(str(_value(draft.table, path))) != safe[path]:
            findings.append(Finding(path, "this may hold a secret that cannot be left out", hint, "secret"))
    return words_for_people("\n".join(lines)), tuple(findings)  # comments too, and text over several lines


def _without_secrets(path: KeyPath, text: str) -> str:
    """Return a text of a configuration without secrets: one that begins as an address is one, with all its blanks."""
    is_address = path[0] not in _TEXT_FOR_PEOPLE and _SCHEME.match(text)
    return address_for_people(text) if is_address else words_for_people(text)


def _replaced(key_and_value: str, value: str) -> tuple[str, int]:
    quoted = json.dumps(value, ensure_ascii=False)
    return _TEXT_VALUE.subn(lambda _: f" {quoted}", key_and_value)


def _hint(draft: Draft, path: KeyPath) -> str:
    beside = f"{path[-1]}_file"
    known = {(*at, name) for at, part in draft.drivers.items() for name in type(part.options).model_fields}
    if (*path[:-1], beside) in known:
        return f'put it into a file of its own and write {beside} = "…"'
    return "let only those read this file who may know it"


def _secrets(draft: Draft) -> Iterator[KeyPath]:
    for at, part in draft.drivers.items():
        for name, field in type(part.options).model_fields.items():
            if isinstance(getattr(part.options, name), SecretStr):
                yield (*at, field.alias or name)


def _addresses(draft: Draft) -> Iterator[tuple[KeyPath, str]]:
    """Go through every text in which an address stands, but not those that are secret as a whole."""
    secrets = set(_secrets(draft))
    waiting: list[tuple[KeyPath, Any]] = [((), draft.table)]
    while waiting:
        path, value = waiting.pop()
        if isinstance(value, Mapping):
            waiting += [((*path, key), each) for key, each in value.items()]
        elif isinstance(value, list):
            waiting += [((*path, number), each) for number, each in enumerate(value)]
        elif isinstance(value, str) and "://" in value and path not in secrets:
            yield path, value


def _value(table: Any, path: KeyPath) -> Any:
    for key in path:
        if isinstance(table, Mapping):
            table = table.get(key)
        else:
            table = table[key] if isinstance(table, list) and isinstance(key, int) else None
    return table
