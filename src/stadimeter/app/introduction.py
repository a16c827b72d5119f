"""The facts that a run tells of itself to each client that connects."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING

import stadimeter
from stadimeter.app.control.recording import recordings_folder
from stadimeter.app.service import is_service
from stadimeter.config.untrusted_file import sha256_of

if TYPE_CHECKING:
    from stadimeter.app.loop import Loop
    from stadimeter.config.loader import Configuration


def introduction(loop: Loop) -> dict[str, object]:
    """Return the facts about a run that each client gets when it connects."""
    configuration = loop.parts.configuration
    return {
        "configuration": str(configuration.path.resolve()),
        "pid": os.getpid(),
        "version": stadimeter.__version__,
        "digest": sha256_of(configuration.text),
        "configuration_age_s": round(time.monotonic() - loop.configured_at_s, 1),
        "is_service": is_service(),
        "recordings": str(recordings_folder(configuration.path)),
        "world": loop.parts.world is not None,
    }


def colours_of(configuration: Configuration) -> dict[str, str]:
    """Return the targets that are found by a colour, each with the name of its table."""
    return {
        target: choice.name
        for choice in configuration.targets
        if getattr(choice.options, "hsv", None) is not None
        for target in choice.members or (choice.name,)
    }
