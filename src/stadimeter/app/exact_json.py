"""Values as JSON that reads back to the same bits.

msgspec alone would write infinity and NaN as null, which reads back as something else, and a bare NaN is no JSON: they
are written as text. Kinds of values that take turns in one place, such as commands, carry a tag in their class.
"""

from __future__ import annotations

from functools import cache
from typing import Any, TypeVar, cast

from msgspec import to_builtins
from msgspec.json import Decoder
from pydantic_core import to_json

_T = TypeVar("_T")


def plain(value: object) -> Any:
    """Return a value as dictionaries, lists, texts and numbers."""
    return to_builtins(value, enc_hook=_plain_number)


def encode(value: object) -> bytes:
    """Return a value as JSON on one line."""
    return to_json(plain(value), inf_nan_mode="strings")


def decode(text: bytes | str, kind: type[_T]) -> _T:
    """Return the value of a type that `encode` wrote; `ValueError` says what is wrong, and where."""
    try:
        decoder: Decoder[_T] = _decoder(cast("Any", kind))
        return decoder.decode(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(str(error)) from error


def _plain_number(value: Any) -> float:
    return value.item()  # type: ignore[no-any-return]  # a number of numpy's


@cache
def _decoder(kind: Any) -> Decoder[Any]:
    # Not strict, so that a number may be text, such as infinity. Where the type asks for text, text stays text.
    return Decoder(kind, strict=False)
