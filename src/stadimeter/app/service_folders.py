"""The folders that systemd makes for a service: one for its state, which lasts, and one for its run, in memory."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path


def state_directory(environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the first folder of ``$STATE_DIRECTORY``; None outside a service."""
    return _first(environ.get("STATE_DIRECTORY", ""))


def runtime_directory(environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the first folder of ``$RUNTIME_DIRECTORY``; None outside a service."""
    return _first(environ.get("RUNTIME_DIRECTORY", ""))


def _first(folders: str) -> Path | None:
    first = folders.split(":", maxsplit=1)[0]
    return Path(first) if first else None
