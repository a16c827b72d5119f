"""Colour profiles of pictures: whether their values mean the colours that everything here takes them for.

Phones write pictures in Display P3, some cameras in Adobe RGB. Read as sRGB, their hues are turned and their saturation
is less, so that a range of colours from other pictures may miss the target; and the tone curve of some differs.

A profile is a table of tags (ICC.1:2022, section 7). Its primaries tell whether it is sRGB, whatever it is called.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from stadimeter.config.untrusted_file import open_untrusted
from stadimeter.errors import UnreadableError

# Profiles stand before the pixels; those of cameras have some kilobytes.
_HEAD_MAX_BYTES = 1 << 20

_PROFILE_MAX_BYTES = 1 << 22
_ICC = b"ICC_PROFILE\0"
_HEADER_BYTES = 128
_TAGS_MAX = 100

# Of sRGB, adapted to the D50 of profiles (IEC 61966-2-1).
_SRGB_PRIMARIES = {
    b"rXYZ": (0.4361, 0.2225, 0.0139),
    b"gXYZ": (0.3851, 0.7169, 0.0971),
    b"bXYZ": (0.1431, 0.0606, 0.7141),
}

_SAME_PRIMARY = 0.01


def profile_notes(paths: Iterable[Path]) -> tuple[str, ...]:
    """Return a note for each colour profile among pictures that is not sRGB; none for what cannot be read."""
    of_profile: dict[str, list[Path]] = {}
    for path in paths:
        if name := other_profile(path):
            of_profile.setdefault(name, []).append(path)
    return tuple(_note(name, pictures) for name, pictures in of_profile.items())


def _note(name: str, pictures: list[Path]) -> str:
    others = f" and {len(pictures) - 1} more" if len(pictures) > 1 else ""
    return (
        f"{pictures[0]}{others}: the colours are in the profile '{name}', not sRGB, and are read as if they were sRGB; "
        "take the colour range of a ball from such pictures too, or convert them to sRGB"
    )


def other_profile(path: Path) -> str:
    """Return the name of a picture's colour profile if that is not sRGB; an empty string if it is, or has none."""
    try:
        with open_untrusted(path) as file:
            head = file.read(_HEAD_MAX_BYTES)
        profile = _profile_in(head)
        return _name_unless_srgb(profile)
    except (UnreadableError, OSError, struct.error, zlib.error, ValueError):
        return ""


def _profile_in(head: bytes) -> bytes:
    if head.startswith(b"\xff\xd8"):
        # A long profile is in several segments, each with its number and how many there are.
        parts = [body[len(_ICC) :] for code, body in _jpeg_segments(head) if code == 0xE2 and body.startswith(_ICC)]
        return b"".join(part[2:] for part in sorted(parts, key=lambda part: part[:1]))
    if head.startswith(b"\x89PNG"):
        return next((_inflate(body) for kind, body in _chunks(head, 8, ">", 12) if kind == b"iCCP"), b"")
    if head.startswith(b"RIFF") and head[8:12] == b"WEBP":
        return next((body for kind, body in _chunks(head, 12, "<", 8) if kind == b"ICCP"), b"")
    return b""


def _jpeg_segments(head: bytes) -> Iterator[tuple[int, bytes]]:
    at = 2
    while at + 4 <= len(head) and head[at] == 0xFF and head[at + 1] not in {0xD9, 0xDA}:
        (length,) = struct.unpack_from(">H", head, at + 2)
        yield head[at + 1], head[at + 4 : at + 2 + length]
        at += 2 + max(length, 2)


def _chunks(head: bytes, at: int, order: str, frame_bytes: int) -> Iterator[tuple[bytes, bytes]]:
    """Yield kind and content of the chunks of a PNG (length first, sum behind) or WebP (length second, padded)."""
    while at + 8 <= len(head):
        is_png = frame_bytes == 12
        kind = head[at + 4 : at + 8] if is_png else head[at : at + 4]
        (length,) = struct.unpack_from(f"{order}L", head, at if is_png else at + 4)
        if kind == b"IDAT":
            return
        yield kind, head[at + 8 : at + 8 + length]
        at += frame_bytes + length + (0 if is_png else length % 2)


def _inflate(chunk: bytes) -> bytes:
    """Return the profile of a PNG: behind its name, a null and the number of the method."""
    _, _, rest = chunk.partition(b"\0")
    return zlib.decompressobj().decompress(rest[1:], _PROFILE_MAX_BYTES)


def _name_unless_srgb(profile: bytes) -> str:
    if profile[16:20] != b"RGB ":
        return ""
    tags = _tags(profile)
    name = _text(tags.get(b"desc", b"")) or "without a name"
    primaries = [kind for kind in _SRGB_PRIMARIES if kind in tags]
    if not primaries:  # a table of colours instead
        return "" if "srgb" in name.lower() else name
    return "" if all(_is_same(tags[kind], _SRGB_PRIMARIES[kind]) for kind in primaries) else name


def _tags(profile: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">L", profile, _HEADER_BYTES)
    tags = {}
    for index in range(min(count, _TAGS_MAX)):
        kind, at, size = struct.unpack_from(">4sLL", profile, _HEADER_BYTES + 4 + 12 * index)
        tags[kind] = profile[at : at + size]
    return tags


def _is_same(tag: bytes, primary: tuple[float, ...]) -> bool:
    values = (each / 65536 for each in struct.unpack_from(">3l", tag, 8))
    return all(abs(value - wanted) < _SAME_PRIMARY for value, wanted in zip(values, primary, strict=True))


def _text(tag: bytes) -> str:
    """Return a description: ASCII in profiles of version 2, several languages in UTF-16 in those of version 4."""
    if tag.startswith(b"mluc"):
        length, at = struct.unpack_from(">LL", tag, 20)
        text = tag[at : at + length].decode("utf-16-be", "replace")
    else:
        (length,) = struct.unpack_from(">L", tag, 8) if tag else (0,)
        text = tag[12 : 12 + length].decode("ascii", "replace")
    return "".join(letter for letter in text if letter.isprintable())[:60].strip()
