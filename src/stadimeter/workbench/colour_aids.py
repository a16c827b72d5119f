"""Help with a target's colour: places on a ball (``ball.jpg@312,240``), pictures of what matches, what else to try."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stadimeter.config.plugins import DriverChoice
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.protocol import ColourSample, ColourView, ProposesColour
from stadimeter.errors import ConfigError, Problem
from stadimeter.workbench.annotation import Mark, annotate
from stadimeter.workbench.measuring import PictureResult


def colour_notes(result: PictureResult, choices: Sequence[DriverChoice], noted: set[str]) -> Iterator[str]:
    """Yield a sentence for each target of which a picture shows nothing at all, though a ball stands out in it.

    Args:
        choices: The targets' detectors.
        noted: The targets that were tried in earlier pictures; each is tried once, since it takes seconds.
    """
    proposers = {
        choice.name: choice.options
        for choice in choices
        if isinstance(choice.options, ProposesColour) and choice.name not in noted
    }
    for each in result.targets:
        proposer, seen = proposers.get(each.measurement.target), each.detection
        if proposer is None or result.frame is None or seen is None:
            continue
        if seen.status is not DetectionStatus.NOT_FOUND or seen.rejected:
            continue
        noted.add(each.measurement.target)
        proposal = proposer.propose_colour([ColourSample(result.frame)])
        found = proposal and proposal.views[0].detection
        if proposal and found and found.status is DetectionStatus.FOUND:
            (x_px, y_px), size_px = found.centre_px, found.width_px
            yield (
                f"{result.file}: something round, {size_px:.0f} px across at {x_px:.0f},{y_px:.0f}, has other colours; "
                f'if it is the target, its range is hsv = "{proposal.colour}"'
            )


# An outline of fewer points encloses nothing.
MIN_OUTLINE = 3

# Brightness of what has another colour, beside how it was.
BEHIND = 0.35


def colour_picture(image: Image, view: ColourView, colour: str) -> Image:
    """Return a picture in which what has the colour stands out, the target is outlined, and other things are numbered.

    What has another colour is grey and dark.
    """
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    shown = np.where(view.mask[..., None] > 0, image, (BEHIND * grey).astype(np.uint8))
    words = f"{view.detection.width_px:.0f} px" if len(view.detection.outline_px) else "no ball is seen with it"
    mark = Mark(
        detection=view.detection,
        headline=words,
        lines=(f'hsv = "{colour}"', words),
        rejected=tuple(enumerate(view.others, start=1)),
    )
    return annotate(np.asarray(shown, np.uint8), [mark])


def range_figures(view: ColourView) -> dict[str, Any]:
    """Return the figures that a range gives on the ball that it shows, and on the rest of a picture, as JSON has it."""
    ball = view.detection
    has_ball, inside = len(ball.outline_px) >= MIN_OUTLINE, np.zeros_like(view.mask)
    if has_ball:
        hull = cv2.convexHull(np.round(ball.outline_px).astype(np.int32))
        cv2.fillConvexPoly(inside, hull, 255)
    on_ball, in_all, ball_px = (int(np.count_nonzero(each)) for each in (view.mask & inside, view.mask, inside))
    is_found = ball.status is not DetectionStatus.NOT_FOUND
    return {
        "ball_share": on_ball / ball_px if has_ball else None,
        "elsewhere_px": in_all - on_ball,
        "elsewhere_share": (in_all - on_ball) / max(1, inside.size - ball_px),
        "is_found": is_found,
        # The size alone: what the lens and the ball's own size add is the same for every range.
        "sigma_share": ball.size_sigma_px / ball.width_px if is_found and ball.width_px else None,
    }


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
    """Check whether a ball is seen, and where the person has pointed."""
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
    check_place(place, name, frame, option)
    return place


def check_place(place: Place, name: str, frame: Frame, option: str = "") -> None:
    """Raise a `ConfigError` for a place that is not in a picture, see `colour_sample`."""
    if not (0 <= place[0] < frame.width_px and 0 <= place[1] < frame.height_px):
        size = f"{frame.width_px} × {frame.height_px} pixels"
        raise ConfigError([Problem(f"{place[0]:g},{place[1]:g} is not in {name}, which has {size}", key=option)])
