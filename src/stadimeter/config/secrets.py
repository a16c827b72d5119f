"""Secrets that stand in a configuration, which is shown, recorded and shared: they are taken out of its text."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import SecretStr

from stadimeter.config.draft import Draft
from stadimeter.config.findings import Finding
from stadimeter.config.toml_lines import KeyPath, Place

HIDDEN = "hidden://"
"""What stands in the place of a secret in the text that is recorded."""

_TEXT_VALUE = re.compile(r"""=\s*("[^"]*"|'[^']*')\s*$""")


def shown_address(address: str) -> str:
    """Return an address as it may be shown: without user, password, query and fragment, where tokens are.

    Args:
        address: A URL, or what somebody wrote in place of one.

    Returns:
        The address, with an ellipsis for a query.
    """
    scheme, separator, rest = address.partition("://") if "://" in address else ("", "", address)
    head, *hidden = re.split(r"[?#]", rest, maxsplit=1)
    place, slash, path = head.partition("/")
    if "@" in rest[len(place) :]:  # a password with one of / ? # in it, which belong before a path
        return f"{scheme}{separator}…"
    return f"{scheme}{separator}{place.rpartition('@')[2]}{slash}{path}{'?…' if hidden else ''}"


def secret_warnings(draft: Draft) -> Iterator[Finding]:
    """Find secrets that stand in a configuration.

    Args:
        draft: What could be read of it.

    Yields:
        A warning for each.
    """
    for path in _secrets(draft):
        if _value(draft.table, path) != HIDDEN:
            message = "this may hold a secret, and configurations are shown and shared"
            hint = f'put it into a file of its own and write {path[-1]}_file = "…"'
            yield Finding(path, message, hint, "secret")


def without_secrets(draft: Draft, text: str, places: Mapping[KeyPath, Place]) -> tuple[str, tuple[Finding, ...]]:
    """Return the text of a configuration as it may be recorded.

    Args:
        draft: What was read from the text.
        text: The text.
        places: Where each key of it stands.

    Returns:
        The text with something else for each secret; and what is wrong with a secret that cannot be taken out.
    """
    lines = text.split("\n")
    paths = [path for path in _secrets(draft) if path in places]
    for path in sorted(paths, key=lambda path: places[path].column, reverse=True):  # the last of a line first
        place = places[path]
        line = lines[place.line - 1]
        hidden = _TEXT_VALUE.sub(f'= "{HIDDEN}"', line[place.column : place.end_column])
        lines[place.line - 1] = line[: place.column] + hidden + line[place.end_column :]
    safe_text = "\n".join(lines)
    if all(_reads(safe_text, path) == HIDDEN for path in _secrets(draft)):
        return safe_text, ()
    hint = "write it as text in simple quotes on the line of its key"
    return text, tuple(
        Finding(path, "this may hold a secret that cannot be left out", hint, "secret") for path in paths
    )


def _secrets(draft: Draft) -> Iterator[KeyPath]:
    for at, part in draft.parts():
        for name, field in type(part.options).model_fields.items():
            if isinstance(getattr(part.options, name), SecretStr):
                yield (*at, field.alias or name)


def _reads(text: str, path: KeyPath) -> Any:
    try:
        return _value(tomllib.loads(text), path)
    except tomllib.TOMLDecodeError:
        return None


def _value(table: Any, path: KeyPath) -> Any:
    for key in path:
        table = table.get(key) if isinstance(table, Mapping) else None
    return table
