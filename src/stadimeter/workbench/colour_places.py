"""Pictures of a ball and the places in them that a person points at, as people write them: ``ball.jpg@312,240``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import ColourSample, ColourView
from stadimeter.errors import ConfigError, Problem

Place = tuple[float, float]

NOTHING_STANDS_OUT = "nothing in the picture stands out as a ball of one colour"
ONLY_BACKGROUND = "the place has no outline of its own, so it is background; point at the middle of the ball"


def split_places(text: str) -> tuple[str, list[str]]:
    """Return the path and the places of ``PATH@X,Y@X,Y``; a path may hold an ``@`` itself."""
    name, places = text, []
    while "@" in name and not Path(name).is_file():
        name, _, place = name.rpartition("@")
        places.append(place)
    return (name, places) if Path(name).is_file() else (text, [])


def colour_sample(frame: Frame, name: str, places: Sequence[str], option: str = "") -> ColourSample:
    """Return a picture with the places in it.

    Args:
        name: The picture's name, for messages.
        option: The option that the places come from.

    Raises:
        ConfigError: A place is none, or is outside the picture.
    """
    return ColourSample(frame, tuple(_place(each, name, frame, option) for each in places))


def is_where_pointed(sample: ColourSample, view: ColourView) -> bool:
    """Return whether a ball is seen, and where the person has pointed."""
    seen = view.detection
    if seen.status is DetectionStatus.NOT_FOUND:
        return False
    reach_px = seen.width_px / 2
    return not sample.places_px or any(math.dist(seen.centre_px, each) <= reach_px for each in sample.places_px)


def _place(text: str, name: str, frame: Frame, option: str) -> Place:
    x, _, y = text.partition(",")
    try:
        place = float(x), float(y)
    except ValueError as error:
        raise ConfigError([Problem(f"{text!r} is not a place; write it such as 312,240", key=option)]) from error
    if not (0 <= place[0] < frame.width_px and 0 <= place[1] < frame.height_px):
        size = f"{frame.width_px} × {frame.height_px} pixels"
        raise ConfigError([Problem(f"{text} is not in {name}, which has {size}", key=option)])
    return place
