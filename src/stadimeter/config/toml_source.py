"""A TOML file of a user: its text, what it holds, and where each key of it stands.

The standard library's parser calls itself for every list inside a list, and runs out of stack where they are nested too
deep; what it can read and no configuration needs is refused here, with its line.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct

from stadimeter.config.files import read_untrusted_text
from stadimeter.config.findings import Finding, hints, problems
from stadimeter.config.toml_lines import KeyPath, SourceSpan, key_spans, syntax_error
from stadimeter.core.bounds import MAX_PLAIN
from stadimeter.errors import ConfigError, Problem, UnreadableError

# The code of a file of which not even the text could be read.
UNREADABLE = "unreadable"

# Enough for 20 conditions inside each other, in lists, in the table of a rule.
MAX_DEPTH = 64
_TOO_DEEP = f"tables and lists stand inside each other more than {MAX_DEPTH} deep"

# The integers that every reader of TOML must take (TOML 1.0, section Integer); no key means more.
_INTEGERS = range(-(2**63), 2**63)


class TomlSource(Struct, frozen=True, kw_only=True):
    """A TOML text that was parsed."""

    text: str
    table: dict[str, Any]
    spans: Mapping[KeyPath, SourceSpan]


# What is to be read in place of files, by their paths: what was typed and not saved yet, or stands in a recording.
Texts = Mapping[Path, str]


def read_toml(path: Path, most_bytes: int, missing_hint: str = "", texts: Texts | None = None) -> TomlSource:
    """Read a TOML file, or the text that stands for it.

    Raises:
        ConfigError: It cannot be read, or as for `parse_toml`.
    """
    try:
        text = (texts or {}).get(path)
        if text is None:
            text = read_untrusted_text(path, most_bytes)
    except UnreadableError as error:
        is_missing = isinstance(error.__cause__, FileNotFoundError)
        message = error.reason if is_missing else f"the file cannot be read: {error.reason}"
        hint = missing_hint if is_missing else "save it as UTF-8, or is it no TOML file?" if error.line else ""
        raise ConfigError([Problem(message, str(path), error.line, hint=hint, code=UNREADABLE)]) from error
    return parse_toml(text, str(path))


def parse_toml(text: str, file: str) -> TomlSource:
    """Parse a TOML text, unless it cannot be meant as a configuration.

    Raises:
        ConfigError: It is not TOML, nests too deep, or holds a number beyond all bounds; with the line.
    """
    try:
        table, spans = tomllib.loads(text), key_spans(text)
    except tomllib.TOMLDecodeError as error:
        message, line = syntax_error(error, text)
        hint = _syntax_hint(message, text.split("\n")[line - 1] if line else "")
        raise ConfigError(
            [Problem(f"this is not valid TOML: {message}", file, line, hint=hint, code="syntax")]
        ) from error
    except (RecursionError, ValueError) as error:  # a number of thousands of digits is no syntax error
        message = _TOO_DEEP if isinstance(error, RecursionError) else "a number has too many digits"
        raise ConfigError([Problem(message, file, hint="is it a configuration?", code="too-deep")]) from error
    if found := list(_out_of_bounds((), table)):
        raise ConfigError(problems(found, file, spans))
    return TomlSource(text=text, table=table, spans=spans)


def key_and_value(text: str) -> tuple[str, Any]:
    """Return an option of a driver as a configuration would have it; a value that is none of TOML is text."""
    key, _, value = text.partition("=")
    try:
        return key.strip(), parse_toml(f"value = {value}", "").table["value"]
    except ConfigError:
        return key.strip(), value.strip()


# A comma between two options. One in brackets stands between the parts of a list.
_OPTION_ENDS = re.compile(r",(?![^\[]*\])")


def camera_table(text: str) -> dict[str, Any]:
    """Return the table ``[camera]`` for a device, an address, or a driver, each with options behind commas.

    Such as ``0``, ``/dev/video0``, ``http://pi.local/stream,latency=200ms`` or ``picamera2,colour_gains=[2.1,1.5]``.
    """
    driver, *options = _OPTION_ENDS.split(text)
    if driver.isdecimal() or driver.startswith("/") or "://" in driver:
        driver, options = "opencv", [f"device={driver}", *options]
    return {"driver": driver, **dict(map(key_and_value, options))}


def as_toml(value: object) -> str:
    """Return a value as TOML has it in one line, such as ``{ below = "50 cm" }``.

    JSON's escapes are among TOML's, but the delete character needs one here too.
    """
    match value:
        case Mapping():
            return f"{{ {', '.join(f'{key} = {as_toml(entry)}' for key, entry in value.items())} }}"
        case list():
            return f"[{', '.join(map(as_toml, value))}]"
        case bool():
            return str(value).lower()
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
        case _:
            return str(value)


# Of a line that is no TOML, as much as a person wrote.
_LOOKED_AT = 1000

_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"|\'[^\']*\'')
# A byte of zero is from UTF-16.
_PLAIN = {*map(chr, range(32, 127)), "\0", "\t"}


def _syntax_hint(message: str, line: str) -> str:
    """Return the remedy for a line that is no TOML: mostly a character looks right, or quotes are missing."""
    # Patterns take the square of the time on a line of megabytes.
    bare = re.sub("#.*", "", _QUOTED.sub('""', line[:_LOOKED_AT]))
    key = bare.partition("=")[0]
    for at, each in enumerate(bare):
        kind = f"{unicodedata.category(each)} {unicodedata.name(each, '')}{' IN A KEY' * (at < len(key))}"
        remedies = (words for pattern, words in hints()["characters"] if re.search(pattern, kind))
        if each not in _PLAIN and (remedy := next(remedies, "")):
            return str(remedy.format(each, f"U+{ord(each):04X}", unicodedata.normalize("NFKC", each)))
    matches = ((re.search(pattern, f"{message}\n{bare}"), remedy) for pattern, remedy in hints()["lines"])
    return next(str(remedy.format(*found.groups())) for found, remedy in matches if found)


def _out_of_bounds(path: KeyPath, value: Any) -> Iterator[Finding]:
    if isinstance(value, dict | list) and len(path) > MAX_DEPTH:
        yield Finding(path[:1], _TOO_DEEP, "is it a configuration?", "too-deep")
    elif isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _out_of_bounds((*path, key), inner)
    elif isinstance(value, int) and value not in _INTEGERS:
        yield Finding(path, "this whole number does not fit into 64 bits", code="bad-value")
    elif isinstance(value, float) and MAX_PLAIN < abs(value) < math.inf:
        yield Finding(path, f"{value:g} is too large a number; at most {MAX_PLAIN:g} is taken", code="bad-value")
