"""The run that a desk is for, and where it keeps things. What takes long to load is loaded only without a run."""

from __future__ import annotations

from pathlib import Path

from stadimeter.app.control.client import HELLO_WAIT_S, ask, find
from stadimeter.errors import ControlError
from stadimeter.workbench.server.operations import Desk


def run_socket(desk: Desk) -> Path:
    """Return where the run of this configuration listens; `ControlError` if there is none."""
    return desk.run_socket or find(desk.configuration, names_others=False)


def folder_of(desk: Desk) -> Path:
    """Return the folder of recordings: that which the run names, or did name, or else that which one would take."""
    try:
        named = ask(run_socket(desk), "hello", wait_s=HELLO_WAIT_S).get("recordings")
    except ControlError:
        named = None
    if isinstance(named, str) and named:
        desk.kept["recordings folder"] = named
    if "recordings folder" not in desk.kept:
        from stadimeter.app.control.recording import recordings_folder  # noqa: PLC0415 - loads all of a configuration

        return recordings_folder(desk.configuration)
    return Path(desk.kept["recordings folder"])
