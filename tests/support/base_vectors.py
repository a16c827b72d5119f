"""The wire vectors of `tests/bases/base_vectors.json`: as vendors and firmware have them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

_FILE = Path(__file__).parents[1] / "bases" / "base_vectors.json"
_ALL: list[dict[str, Any]] = json.loads(_FILE.read_text("utf-8"))["vectors"]


def vectors(protocol: str, direction: str | None = None, *, valid: bool | None = None) -> dict[str, dict[str, Any]]:
    """Return the vectors of a protocol by name: all, those to the base (``tx``), or those from it (``rx``)."""
    return {
        vector["name"]: vector
        for vector in _ALL
        if vector["protocol"] == protocol and direction in {None, vector["direction"]}
        if valid in {None, vector["valid"]}
    }


def wire(protocol: str, name: str) -> bytes:
    """Return the bytes of a vector."""
    return bytes.fromhex(vectors(protocol)[name]["bytes_hex"])
