"""``calibrate board --live``: views of the board are taken from a camera, while a person moves the board about."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import typer
from pydantic import ValidationError

from stadimeter.cli.known_pictures import today
from stadimeter.cli.target_options import key_and_value
from stadimeter.config import plain_words
from stadimeter.config.plugins import CAMERAS, DriverChoice, load_plugin
from stadimeter.config.untrusted_file import is_file
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError, ConfigError, EndOfFramesError, Problem
from stadimeter.workbench.calibration.board_corners import Board
from stadimeter.workbench.calibration.board_session import BoardSession, Source, open_source

FRAME_WAIT_S = 0.5
SAY_EVERY_S = 2.0
"""Why no view is taken is said this often at most, in time of capture."""


def views_from_camera(live: str, board: Board) -> BoardSession:
    """Take views until they are enough, the camera's frames end, or Ctrl-C is pressed.

    Args:
        live: ``--live``: a configuration, whose camera is taken, or a camera driver such as ``opencv,device=0``.

    Returns:
        The views that were taken, perhaps none.

    Raises:
        ConfigError: There is no such configuration or driver.
        DriverError: The camera cannot be opened.
        CalibrationError: The camera changes its resolution.
    """
    source = open_source(_camera(live))
    session = BoardSession(board, date=today(), must_be_steady=source.is_live)
    source.capture.open()
    try:
        for remark in source.capture.remarks():
            typer.echo(f"note: {remark}", err=True)
        if source.is_live:
            typer.echo("move the board about, tilt it, and hold it still for a moment each time; Ctrl-C ends it")
        _collect(source, session)
    except KeyboardInterrupt:
        typer.echo(f"stopped with {len(session.views)} views", err=True)
    finally:
        source.capture.close()
    return session


def _collect(source: Source, session: BoardSession) -> None:
    teller = _Teller(is_live=source.is_live)
    while not session.is_done:
        try:
            frame = source.capture.latest(FRAME_WAIT_S)
        except CaptureTimeoutError as error:
            typer.echo(f"note: {error}", err=True)
            continue
        except EndOfFramesError:
            return
        teller.tell(frame, session.look(frame), session)


class _Teller:
    """Reports each view that was taken at once, and now and then why none is; of a recording, every frame."""

    def __init__(self, *, is_live: bool) -> None:
        self._is_live = is_live
        self._said = ""
        self._said_at_s = -math.inf

    def tell(self, frame: Frame, why_not: str, session: BoardSession) -> None:
        if not why_not:
            self._said = ""
            _tell_view(session)
        elif not self._is_live:
            typer.echo(f"left out: {frame.source or f'frame {frame.sequence}'}: {why_not}", err=True)
        elif why_not != self._said and frame.captured_at_s >= self._said_at_s + SAY_EVERY_S:
            self._said, self._said_at_s = why_not, frame.captured_at_s
            typer.echo(f"          {why_not}")


def _tell_view(session: BoardSession) -> None:
    made, newest = session.calibration, session.views[-1]
    figures = f"{len(newest.corners_px)} corners"
    if made is not None:
        each = made.views[-1]
        error = f", left out: {each.why_left_out}" if each.was_left_out else f", error {each.rms_px:.2f} px"
        model = made.camera_model
        focal = f"focal length {model.fx_px:.0f} px ± {model.focal_relative_sigma:.1%}"
        figures += f"{error}; {focal}, corners in {made.coverage:.0%} of the picture"
    bell = "\a" if sys.stdout.isatty() else ""  # whoever holds the board may be too far away to read
    typer.echo(f"{bell}{newest.picture}  {figures}")
    missing = session.missing()
    typer.echo(f"          still missing: {'; '.join(missing)}" if missing else "          that is enough")


def _camera(live: str) -> DriverChoice:
    if Path(live).suffix.lower() == ".toml" or is_file(Path(live)):
        from stadimeter.config.loader import load_camera_choice  # noqa: PLC0415 - most of a start, and rarely needed

        return load_camera_choice(Path(live))
    driver, *options = live.split(",")
    plugin = load_plugin(CAMERAS, driver)
    table = dict(map(key_and_value, options))
    try:
        return DriverChoice(name="camera", driver=driver, plugin=plugin, options=plugin.options.model_validate(table))
    except ValidationError as error:
        found = plain_words.findings(error, plugin.options, table, ())
        hint = f"write it such as --live {driver},KEY=VALUE, or write a configuration and give that"
        raise ConfigError([Problem(f"{driver}: {each.message}", key="--live", hint=hint) for each in found]) from error
