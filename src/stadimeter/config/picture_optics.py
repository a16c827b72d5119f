"""How the camera was set that took a picture, kept in the picture: in a PNG, as a chunk of text."""

from __future__ import annotations

import json
import re
import struct
import zlib
from dataclasses import asdict

from pydantic import ValidationError

from stadimeter.config.camera_file import OpticsTable
from stadimeter.core.frame import Optics

_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_HEADER_BYTES = 33
_OPTICS = b"stadimeter-optics\0"
_OPTICS_CHUNK = re.compile(rb"(.{4})tEXt" + _OPTICS + rb"(\{[ -~]{1,1000}\})", re.DOTALL)


def with_optics(data: bytes, optics: Optics | None) -> bytes:
    """Return a picture file with the settings of its camera: a PNG as a chunk of text, any other kind unchanged.

    A chunk is its length, its kind, its data and a CRC of both (ISO/IEC 15948, 5.3); the first one is the header.
    """
    if optics is None or not data.startswith(_PNG_START):
        return data
    body = b"tEXt" + _OPTICS + json.dumps(asdict(optics)).encode("ascii")
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return data[:_PNG_HEADER_BYTES] + chunk + data[_PNG_HEADER_BYTES:]


def optics_in(data: bytes) -> Optics | None:
    """Return how the camera was set that took a picture, if its file says it behind its header."""
    found = _OPTICS_CHUNK.match(data, _PNG_HEADER_BYTES) if data.startswith(_PNG_START) else None
    try:
        return OpticsTable.model_validate_json(found[2]).to_optics() if found else None
    except ValidationError:
        return None
