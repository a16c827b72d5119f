"""The folders that systemd makes for a service: one for its state, which lasts, and one for its run, in memory."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

# That of the package's service.
SERVICE_STATE = Path("/var/lib/stadimeter")


def state_directory(environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the first folder of ``$STATE_DIRECTORY``; None outside a service."""
    return _first(environ.get("STATE_DIRECTORY", ""))


def runtime_directory(environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the first folder of ``$RUNTIME_DIRECTORY``; None outside a service."""
    return _first(environ.get("RUNTIME_DIRECTORY", ""))


def mounting_places(configuration: Path, environ: Mapping[str, str] = os.environ) -> list[Path]:
    """Return where the saved view of a camera may be: beside the configuration, or where only that can be written."""
    beside, state = configuration.with_suffix(".mounting"), state_directory(environ)
    return [beside, *([state / beside.name] if state is not None else [])]


def _first(folders: str) -> Path | None:
    first = folders.split(":", maxsplit=1)[0]
    return Path(first) if first else None
