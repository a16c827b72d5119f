"""The target of the answers so far, and a look for it in the camera's pictures."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from stadimeter.app.detectors import build_detectors
from stadimeter.config.driver_tables import TARGET
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import split_quantities
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.annotation import Mark, annotate, write_picture
from stadimeter.workbench.frame_source import settled_frame
from stadimeter.workbench.remedies import remedies_for
from stadimeter.workbench.setup.known import PICTURES, Known

FOUND = f"{PICTURES}/found.png"

PLUS_OR_MINUS = re.compile(r"\+/?-")
"""How ``±`` is typed."""

ANY_COLOUR = "0,0,0:179,255,255"
"""The range of a ball before its colour is known."""

SMALLEST_M, LARGEST_M = 0.005, 3.0
"""Sizes beyond these are written in another unit than was meant."""


def target_table(answers: Mapping[str, str]) -> dict[str, Any]:
    """Return the table of the target, ``[targets.ball]`` for one, from complete answers."""
    kind, (size, tolerance) = answers["target"], size_and_tolerance(answers["size"])
    known_to = {"tolerance": tolerance} if tolerance else {}
    if kind == "ball":
        return {"detector": kind, "diameter": size, **known_to, "hsv": answers.get("colour", ANY_COLOUR)}
    if kind == "disc":
        return {"detector": kind, "diameter": size, **known_to}
    if kind == "tag":
        return {"detector": kind, "side": size, **known_to, **_tag_keys(answers.get("tag", ""))}
    width, *height = split_quantities(size.replace(" x ", ", "))
    if not height:
        return {"detector": kind, "size": size, **known_to}
    return {"detector": kind, "width": width, "height": ", ".join(height), **known_to}


def size_and_tolerance(text: str) -> tuple[str, str]:
    """Return a size and how well it is known, from an answer such as ``A4 ± 3 mm``; the latter is empty mostly."""
    size, _, tolerance = PLUS_OR_MINUS.sub("±", text).partition("±")
    return size.strip(), tolerance.strip()


def _tag_keys(text: str) -> dict[str, Any]:
    """Return the keys for a family and, behind it, the number of a tag."""
    family, _, number = text.strip().partition(" ")
    keys: dict[str, Any] = {"family": family} if family else {}
    if number:
        keys["id"] = int(number) if number.strip().isdecimal() else number.strip()
    return keys


def chosen_target(known: Known, **answers: str) -> DriverChoice:
    """Return the target with further answers; a `ConfigError` says what is wrong with them, in people's units too."""
    table = target_table({**known.answers, **answers})
    choice = known.chosen(TARGET, ("targets", table["detector"]), table)
    (named,) = build_detectors([choice], None)
    size_m = named.detector.target_shape.shortest_m
    if not SMALLEST_M <= size_m <= LARGEST_M:
        likely = "millimetres or inches" if size_m > LARGEST_M else "centimetres or metres"
        raise ConfigError(
            f"{answers.get('size', '')!r} is {size_m:g} m; targets have {SMALLEST_M * 1000:g} mm to {LARGEST_M:g} m; "
            f"did you mean {likely}?"
        )
    return choice


def look(known: Known, choice: DriverChoice, size: str = "") -> tuple[Detection, str]:
    """Look for the target in new pictures of a live camera, or those of a recording.

    The picture in which it is found becomes the one that is shown, and is drawn with its outline.

    Args:
        size: The answer for its size that is tried; empty for the one that was given.

    Returns:
        Where it is in that picture, and a sentence about it.
    """
    if known.is_live and known.camera is not None:
        known.frames = (settled_frame(known.camera, known.opening),)
    (named,) = build_detectors([choice], known.camera_model)
    seen: list[tuple[Frame, Detection]] = []
    for frame in known.frames:
        lens = known.camera_model.for_frame(frame) if known.camera_model else None
        seen.append((frame, named.detector.detect(frame, lens=lens)))
        if seen[-1][1].status is DetectionStatus.FOUND:
            break
    frame, found = next((each for each in seen if each[1].status is DetectionStatus.FOUND), seen[0])
    known.frames = (frame, *(each for each in known.frames if each is not frame))
    words = f"{found_in_words(choice.name, found)}"
    words += _remedy_in_words(choice, found, frame, known.camera_model, size or known.answers["size"])
    mark = Mark(detection=found, headline=choice.name, lines=(words,))
    write_picture(known.path(FOUND), annotate(frame.image, [mark]))
    return found, f"{words}{known.shown_in(FOUND)}" if found.status is DetectionStatus.FOUND else words


def why_not_measured(known: Known, lens: CameraModel) -> str:
    """Say why the target is not found through a lens in any of the pictures; empty if it is found in one.

    Before a live camera it need not be there now: only what is found without the lens contradicts it.
    """
    choice, why = chosen_target(known), ""
    (named,) = build_detectors([choice], lens)
    for frame in known.frames:
        found = named.detector.detect(frame, lens=lens.for_frame(frame))
        if found.status is DetectionStatus.FOUND:
            return ""
        if not why and not (known.is_live and named.detector.detect(frame).status is not DetectionStatus.FOUND):
            remedy = _remedy_in_words(choice, found, frame, lens, known.answers["size"])
            why = f"Through this lens nothing is measured. {found_in_words(choice.name, found)}{remedy}"
    return why


def _remedy_in_words(
    choice: DriverChoice, refused: Detection, frame: Frame, lens: CameraModel | None, size: str
) -> str:
    """Say which other answer for the size makes the target found; empty for none."""
    remedies = remedies_for(choice, refused, frame, lens and lens.for_frame(frame))
    own, _ = size_and_tolerance(size)
    answers = [f"{own} ± {each.value}" if each.key == "tolerance" else each.value for each in remedies]
    return f" It is found with the size {' or '.join(answers)}." if answers else ""


def found_in_words(name: str, found: Detection) -> str:
    """Say what was found, or why it was not."""
    x_px, y_px = found.centre_px
    number = "" if found.number is None else f" number {found.number}"
    reason = f"; {found.reason}" if found.reason else ""
    match found.status:
        case DetectionStatus.FOUND:
            size = (
                f"{found.width_px:.0f} px across"
                if number or name == "ball"
                else (f"{found.width_px:.0f} × {found.height_px:.0f} px")
            )
            return f"Found the {name}{number} at {x_px:.0f},{y_px:.0f}, {size}{reason}."
        case DetectionStatus.TRUNCATED:
            return f"The {name} is cut off by the border of the picture{reason}."
        case _:
            return f"The {name} is not found{reason}."


def family_in_view(known: Known) -> str:
    """Return the family and the number of a tag in the pictures, or an empty text."""
    for family in FAMILIES:
        try:
            choice = chosen_target(known, tag=family)
        except StadimeterError:
            continue
        (named,) = build_detectors([choice], None)
        for frame in known.frames:
            found = named.detector.detect(frame)
            if found.status is DetectionStatus.FOUND:
                return f"{family} {found.number}"
    return ""


FAMILIES = ("36h11", "5x5-50", "4x4-50", "6x6-50", "25h9", "16h5", "aruco-original")
"""Families that are looked for, those that are least often seen in mere clutter first."""
