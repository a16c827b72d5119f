"""Where what alarms remember is kept, unless somebody names a file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

ENDING = ".sqlite3"


def state_file(configuration: Path, environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the state file of a configuration.

    Args:
        configuration: The configuration.
        environ: The environment.

    Returns:
        A file named after the configuration in ``$STATE_DIRECTORY``, which systemd makes for a service; else in
        ``$XDG_STATE_HOME/stadimeter``, by default ``~/.local/state/stadimeter``. None for a user without a home.
    """
    name = f"{configuration.stem}{ENDING}"
    for_service = environ.get("STATE_DIRECTORY", "").split(":")[0]
    if for_service:
        return Path(for_service) / name
    of_user = environ.get("XDG_STATE_HOME")
    if of_user:
        return Path(of_user) / "stadimeter" / name
    try:
        return Path.home() / ".local" / "state" / "stadimeter" / name
    except RuntimeError:  # no home
        return None
