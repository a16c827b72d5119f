"""The set-up, one question at a time: the interview of `stadimeter init` with a live picture beside it.

A picture takes less than a tenth of a second on a desktop computer. These take a second or more on a small Pi: to open
a camera (``camera``, and ``begin`` where answers are taken up again), ``take``, and ``colour``
with clicks or ``look``. Answers come in order, so no picture comes meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.errors import ConfigError
from stadimeter.workbench.colour_aids import NOTHING_STANDS_OUT, colour_picture
from stadimeter.workbench.picture_metadata import better_exposure_s
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.server.setup_desk import SetupDesk
from stadimeter.workbench.setup import colour_step
from stadimeter.workbench.setup.camera_step import with_settings
from stadimeter.workbench.setup.trying import (
    DRAWINGS,
    describe_picture,
    draw_findings,
    encode_jpeg,
    look_for_target,
    target_so_far,
)


def setup_of(desk: Desk) -> SetupDesk:
    """Return the set-up of a workbench process."""
    if "setup" not in desk.kept:
        desk.kept["setup"] = made = SetupDesk(desk.configuration, desk.run_socket)
        desk.at_rest.append(made.camera.close)
    found: SetupDesk = desk.kept["setup"]
    return found


@operation
def state(desk: Desk) -> Mapping[str, Any]:
    """Answer the answers so far, and the question that is next."""
    return setup_of(desk).state()


@operation
def begin(desk: Desk, *, anew: bool = False) -> Mapping[str, Any]:
    """Begin, or go on where it was left."""
    setup = setup_of(desk)
    setup.begin(anew=anew)
    return setup.state()


@operation
def answer(desk: Desk, answer: str, question: str | None = None, *, confirm: bool = True) -> dict[str, Any]:
    """Answer the question; a doubtful answer is asked again, once, unless ``confirm`` is false.

    With ``question``, its key, no other question is answered: another device may have gone on.
    """
    setup = setup_of(desk)
    if question is not None and question != setup.interview.next_key:
        raise ConfigError("another question is asked now: the set-up went on, on another device")
    accepted = setup.answer(answer, confirm=confirm)
    return {**setup.state(), "notes": list(accepted.notes)}


@operation
def back(desk: Desk) -> Mapping[str, Any]:
    """Take back the last answer."""
    setup = setup_of(desk)
    if not setup.back():
        raise ConfigError("this is the first question")
    return setup.state()


@operation
def leave(desk: Desk, *, camera_only: bool = False) -> Mapping[str, Any]:
    """Close the camera, and keep the answers. With ``camera_only`` the set-up stays at its question."""
    setup = setup_of(desk)
    if camera_only:
        setup.camera.close()
    else:
        setup.leave()
    return setup.state()


@operation
def picture(desk: Desk, draw: str = "target", width_px: int = 0) -> DeskReply:
    """Answer what the camera sees now: figures, and a JPEG that may be smaller than they are about."""
    setup = setup_of(desk)
    if draw not in DRAWINGS:
        raise ConfigError(f"draw is one of {', '.join(DRAWINGS)}")
    frame = setup.newest()
    if draw == "mask" and setup.trial.colour:
        seen = colour_step.view_range(frame, setup.trial.colour)
        values = {**describe_picture(frame, seen.detection, None), "words": colour_step.describe_view(seen)}
        values["range"] = setup.trial.figures(frame, seen)
        image = colour_picture(frame.image, seen, setup.trial.colour)
        return DeskReply(data=values, attached=encode_jpeg(image, width_px))
    target = None if draw == "plain" else target_so_far(setup.known, setup.trial.colour)
    if target is None:
        return DeskReply(data=describe_picture(frame, None, None), attached=encode_jpeg(frame.image, width_px))
    found, measured = look_for_target(setup.known, frame, target)
    image = draw_findings(frame, found, measured, with_candidates=draw == "candidates")
    return DeskReply(data=describe_picture(frame, found, measured), attached=encode_jpeg(image, width_px))


@operation
def camera(desk: Desk, camera: str, exposure: str = "", resolution: str = "") -> dict[str, Any]:
    """Look through a camera that is offered; with ``exposure``, lock that at a time such as ``10 ms``.

    ``resolution`` is one to ask it for, such as ``1280x720``. The answer to give, with all of it, is in the reply;
    ``picture`` shows what it sees.
    """
    setup = setup_of(desk)
    wanted = with_settings(camera, exposure=exposure, resolution=resolution)
    choice = setup.offer(wanted)
    frame = setup.newest()
    with setup.camera.hold(choice) as source:
        settings = source.capture.remarks()
    told = {
        "answer": wanted,
        "settings": [f"{each[0].upper()}{each[1:]}." for each in settings],
        "has_resolution": hasattr(choice.options, "width_px"),
        "has_exposure": hasattr(choice.options, "exposure"),
        "is_locked": getattr(choice.options, "exposure", None) is not None,
        "proposed_exposure_s": better_exposure_s(frame.image, frame.exposure_s),
    }
    return {**describe_picture(frame, None, None), **told}


@operation
def colour(
    desk: Desk,
    clicks: tuple[tuple[float, float], ...] = (),
    forget: bool | int | None = None,
    range_: str | None = None,
    of: str = "newest",
    *,
    look: bool = False,
) -> dict[str, Any]:
    """Try a range of colours: from clicks on the picture that was shown last, or a given one.

    With ``look``, that of what stands out by itself, which takes seconds. ``forget`` takes back all clicks if it is
    true, or the one of that number, from 0, as the answer lists them.
    """
    setup = setup_of(desk)
    frame, trial = setup.shown or setup.newest(), setup.trial
    if forget is True:
        trial.forget()
    elif forget is not None:
        trial.forget_click(forget)
    if range_ is not None:
        trial.take(range_, frame)
    if look and not trial.look(frame):
        raise ConfigError(f"{NOTHING_STANDS_OUT}; click on it")
    is_pointed_at = True
    if clicks:
        is_pointed_at = trial.point(frame, clicks, same_picture=of == "kept")
    if not trial.colour:
        return {"range": "", "found": False, "words": colour_step.CLICK, "others": [], "pictures": 0, "clicks": []}
    seen = colour_step.view_range((trial.seen_in if clicks else None) or frame, trial.colour)
    is_found = is_pointed_at and seen.detection.status is not DetectionStatus.NOT_FOUND
    return {
        "range": trial.colour,
        "found": is_found,
        "words": colour_step.describe_view(seen, is_pointed_at=is_pointed_at),
        "centre_px": list(seen.detection.centre_px) if is_found else None,
        "width_px": seen.detection.width_px if is_found else None,
        "others": [{"centre_px": list(each.centre_px), "size_px": each.size_px} for each in seen.others],
        "pictures": len(trial.samples),
        "clicks": [list(place) for place in trial.places],
    }


@operation
def take(desk: Desk, distance: str, sigma: str = "", *, confirm: bool = True) -> dict[str, Any]:
    """Take frames of the target at a known distance, and say what lens follows; takes a second or more."""
    setup = setup_of(desk)
    if setup.interview.next_key != "calibration":
        raise ConfigError("no distance is asked for now")
    given = f"{distance} ± {sigma.strip()}" if sigma.strip() else distance
    accepted = setup.answer(given, confirm=confirm)
    return {**setup.state(), **lens_as_json(setup.known.camera_model), "notes": list(accepted.notes)}


def lens_as_json(model: CameraModel | None) -> dict[str, Any]:
    """Return the focal length and what goes with it; nulls for no lens yet."""
    if model is None:
        return {"focal_px": None, "focal_sigma_px": None, "edge_bias_px": None}
    sigma_px = model.fx_px * model.focal_relative_sigma
    return {"focal_px": model.fx_px, "focal_sigma_px": sigma_px, "edge_bias_px": model.edge_bias_px}


@operation
def world(desk: Desk, x_m: float, y_m: float = 0.0) -> Mapping[str, Any]:
    """Put the ball of the simulated room somewhere: so far ahead, and to the left."""
    room = setup_of(desk).camera.room
    if room is None:
        raise ConfigError("there is no simulated room before this camera; move the real thing")
    room.place(x_m, y_m)
    return room.where()
