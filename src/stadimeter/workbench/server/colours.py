"""The range of colours of a running configuration's ball: tried on the picture of the run, and saved."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from stadimeter.app.detectors import build_detectors
from stadimeter.config.loader import Configuration
from stadimeter.config.toml_lines import set_value
from stadimeter.config.toml_source import as_toml
from stadimeter.core.detection import Detection
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement
from stadimeter.detectors.protocol import ProposesColour
from stadimeter.errors import ConfigError
from stadimeter.workbench.colour_aids import colour_picture, range_figures
from stadimeter.workbench.frame_source import SETTLING_WAIT_S, RunCamera
from stadimeter.workbench.measuring import Measuring
from stadimeter.workbench.server.editing import load_text, save, saved_text, version_of
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.server.run_of_desk import run_socket
from stadimeter.workbench.setup.target import describe_picture, encode_jpeg


@operation
def picture(desk: Desk, target: str, range_: str = "", width_px: int = 0) -> DeskReply:
    """Answer the run's picture with what has a range of colours, and what the ball and the rest would give.

    Without a range, that of the saved configuration. ``colour`` in the answer is the one that is shown, ``range`` what
    it gives.
    """
    text = saved_text(desk) or ""
    tried = _load_tried(desk, text, target, range_)
    options: object = next((each.options for each in tried.targets if each.name == target), None)
    colour = str(getattr(options, "hsv", None) or "")
    if not isinstance(options, ProposesColour) or not colour or tried.camera_model is None:
        raise ConfigError(f"there is no target {target!r} that is measured by its colour")
    frame = RunCamera(run_socket(desk)).latest(SETTLING_WAIT_S)
    found, measured = _look(tried, target, frame)
    view = replace(options.view_colour(frame, colour), detection=found)
    shown = {"colour": colour, "version": version_of(text), "range": range_figures(view)}
    values = {**describe_picture(frame, found, measured), **shown}
    return DeskReply(data=values, attached=encode_jpeg(colour_picture(frame.image, view, colour), width_px))


@operation
def keep(desk: Desk, target: str, range_: str, base_version: str = "") -> dict[str, Any]:
    """Save a range into the configuration; what was there is kept as a version."""
    text = saved_text(desk) or ""
    reply: dict[str, Any] = save(desk, with_range(text, target, range_), base_version=base_version)
    return reply


def with_range(text: str, target: str, colour: str) -> str:
    """Return the text of a configuration in which a target has another range of colours; all else stays as it is."""
    return set_value(text, ("targets", target, "hsv"), as_toml(colour))


def _load_tried(desk: Desk, text: str, target: str, colour: str) -> Configuration:
    """Return the configuration with the range that is tried, or the saved one; loaded anew where it has changed."""
    wanted = text, target, colour
    return desk.remember("colours", wanted, lambda: load_text(desk, with_range(*wanted) if colour else text))


def _look(configuration: Configuration, target: str, frame: Frame) -> tuple[Detection, Measurement]:
    """Look for a target as a run of a configuration does that knows nothing of the frames before."""
    choices, lens = [each for each in configuration.targets if each.name == target], configuration.camera_model
    assert lens is not None  # noqa: S101 - see `picture`
    result = Measuring(build_detectors(choices, lens, configuration.footings), lens).measure(frame, "").targets[0]
    assert result.detection is not None  # noqa: S101 - the frame could be read
    return result.detection, result.measurement
