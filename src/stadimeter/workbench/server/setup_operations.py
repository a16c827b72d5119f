"""The set-up, one question at a time: the interview of `stadimeter init` with a live picture beside it.

A picture takes less than a tenth of a second on a desktop computer. These take a second or more on a small Pi: to open
a camera (``camera``, and ``begin`` where answers are taken up again), ``take``, and ``colour``
with clicks or ``look``. Answers come in order, so no picture comes meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.errors import ConfigError
from stadimeter.workbench.colour_aids import NOTHING_STANDS_OUT, colour_picture
from stadimeter.workbench.picture_quality import better_exposure_s
from stadimeter.workbench.server.arguments import get_bool, get_number, get_points, get_text, get_texts
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.server.setup_desk import SetupDesk
from stadimeter.workbench.setup import colour_step
from stadimeter.workbench.setup.camera_step import PLAYED_KEYS, table_of, with_exposure, with_playing, with_resolution
from stadimeter.workbench.setup.trying import (
    DRAWINGS,
    draw_findings,
    jpeg_of,
    look_for_target,
    target_so_far,
    values_of,
)


def setup_of(desk: Desk) -> SetupDesk:
    """Return the set-up of a workbench process."""
    if "setup" not in desk.kept:
        desk.kept["setup"] = made = SetupDesk(desk.configuration, desk.run_socket)
        desk.at_rest.append(made.camera.close)
    found: SetupDesk = desk.kept["setup"]
    return found


@operation
def state(desk: Desk, _args: Mapping[str, Any]) -> DeskReply:
    """Answer the answers so far, and the question that is next."""
    return DeskReply(data=setup_of(desk).state())


@operation
def begin(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Begin, or go on where it was left."""
    setup = setup_of(desk)
    setup.begin(anew=get_bool(args, "anew"))
    return DeskReply(data=setup.state())


@operation
def answer(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Answer the question; a doubtful answer is asked again, once, unless ``confirm`` is false.

    With ``question``, its key, no other question is answered: another device may have gone on.
    """
    setup = setup_of(desk)
    if "question" in args and get_text(args, "question") != setup.interview.next_key:
        raise ConfigError("another question is asked now: the set-up went on, on another device")
    accepted = setup.answer(get_text(args, "answer"), confirm=get_bool(args, "confirm", default=True))
    return DeskReply(data={**setup.state(), "notes": list(accepted.notes)})


@operation
def back(desk: Desk, _args: Mapping[str, Any]) -> DeskReply:
    """Take back the last answer."""
    setup = setup_of(desk)
    if not setup.back():
        raise ConfigError("this is the first question")
    return DeskReply(data=setup.state())


@operation
def leave(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Close the camera, and keep the answers. With ``camera_only`` the set-up stays at its question."""
    setup = setup_of(desk)
    if get_bool(args, "camera_only"):
        setup.camera.close()
    else:
        setup.leave()
    return DeskReply(data=setup.state())


@operation
def picture(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Answer what the camera sees now: figures, and a JPEG that may be smaller than they are about.

    With ``file``, the picture of that name among those that the camera shows.
    """
    setup, draw = setup_of(desk), get_text(args, "draw", "target")
    if draw not in DRAWINGS:
        raise ConfigError(f"draw is one of {', '.join(DRAWINGS)}")
    name, width_px = get_text(args, "file", ""), int(get_number(args, "width_px", 0))
    frame = setup.picture(name) if name else setup.newest()
    if draw == "mask" and setup.trial.colour:
        seen = colour_step.view(frame, setup.trial.colour)
        values = {**values_of(frame, seen.detection, None), "words": colour_step.in_words(seen)}
        image = colour_picture(frame.image, seen, setup.trial.colour)
        return DeskReply(data=values, attached=jpeg_of(image, width_px))
    target = None if draw == "plain" else target_so_far(setup.known, setup.trial.colour)
    if target is None:
        return DeskReply(data=values_of(frame, None, None), attached=jpeg_of(frame.image, width_px))
    found, measured = look_for_target(setup.known, frame, target)
    if measured is not None and not name:
        setup.remember(replace(measured, captured_at_s=frame.captured_at_s))
    image = draw_findings(frame, found, measured, with_candidates=draw == "candidates")
    return DeskReply(data=values_of(frame, found, measured), attached=jpeg_of(image, width_px))


@operation
def camera(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Look through a camera that is offered; with ``exposure``, lock that at a time such as ``10 ms``.

    ``resolution`` is one to ask it for, such as ``1280x720``; ``played``, how files are played. The answer to give,
    with all of it, is in the reply; ``picture`` shows what it sees.
    """
    setup, wanted = setup_of(desk), get_text(args, "camera")
    exposure, resolution, played = (
        get_text(args, "exposure", ""),
        get_text(args, "resolution", ""),
        get_texts(args, "played"),
    )
    if played:
        wanted = with_playing(wanted, played)
    if resolution:
        wanted = with_resolution(wanted, resolution)
    if exposure:
        wanted = with_exposure(wanted, exposure)
    choice = setup.offer(wanted)
    frame = setup.newest()
    with setup.camera.opened(choice) as source:
        settings = source.capture.remarks()
    told = {
        "answer": wanted,
        "settings": [f"{each[0].upper()}{each[1:]}." for each in settings],
        "has_resolution": hasattr(choice.options, "width_px"),
        "has_exposure": hasattr(choice.options, "exposure"),
        "pictures": setup.pictures(),
        "played": {key: value for key, value in table_of(wanted).items() if key in PLAYED_KEYS}
        if hasattr(choice.options, "loop")
        else None,
        "is_locked": getattr(choice.options, "exposure", None) is not None,
        "proposed_exposure_s": better_exposure_s(frame.image, frame.exposure_s),
    }
    return DeskReply(data={**values_of(frame, None, None), **told})


@operation
def colour(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Try a range of colours: from clicks on the picture that was shown last, or a given one, widened or narrowed.

    With ``look``, that of what stands out by itself, which takes seconds. ``forget`` takes back all clicks if it is
    true, or the one of that number, from 0, as the answer lists them.
    """
    setup = setup_of(desk)
    clicks, frame, trial = get_points(args, "clicks"), setup.shown or setup.newest(), setup.trial
    if args.get("forget") is True:
        trial.forget()
    elif "forget" in args:
        trial.forget_click(int(get_number(args, "forget")))
    if "range" in args:
        trial.take(get_text(args, "range"), frame)
    if get_bool(args, "look") and not trial.look(frame):
        raise ConfigError(f"{NOTHING_STANDS_OUT}; click on it")
    is_pointed_at = True
    if clicks:
        is_pointed_at = trial.point(frame, clicks, same_picture=get_text(args, "of", "newest") == "kept")
    if "widen" in args:
        trial.widen(int(get_number(args, "widen")))
    if not trial.colour:
        return DeskReply(
            data={"range": "", "found": False, "words": colour_step.CLICK, "others": [], "pictures": 0, "clicks": []}
        )
    seen = colour_step.view((trial.seen_in if clicks else None) or frame, trial.colour)
    is_found = is_pointed_at and seen.detection.status is not DetectionStatus.NOT_FOUND
    return DeskReply(
        data={
            "range": trial.colour,
            "widen": trial.steps,
            "widen_max": colour_step.MAX_STEPS,
            "found": is_found,
            "words": colour_step.in_words(seen, is_pointed_at=is_pointed_at),
            "centre_px": list(seen.detection.centre_px) if is_found else None,
            "width_px": seen.detection.width_px if is_found else None,
            "others": [{"centre_px": list(each.centre_px), "size_px": each.size_px} for each in seen.others],
            "pictures": len(trial.samples),
            "clicks": [list(place) for place in trial.places],
        }
    )


@operation
def take(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Take frames of the target at a known distance, and say what lens follows; takes a second or more."""
    setup = setup_of(desk)
    key = setup.interview.next_key
    if key not in {"calibration", "proof"}:
        raise ConfigError("no distance is asked for now")
    sigma = get_text(args, "sigma", "").strip()
    given = get_text(args, "distance") + (f" ± {sigma}" if sigma else "")
    accepted = setup.answer(given, confirm=get_bool(args, "confirm", default=True))
    return DeskReply(data={**setup.state(), **lens_as_json(setup.known.camera_model), "notes": list(accepted.notes)})


def lens_as_json(model: CameraModel | None) -> dict[str, Any]:
    """Return the focal length and what goes with it; nulls for no lens yet."""
    if model is None:
        return {"focal_px": None, "focal_sigma_px": None, "edge_bias_px": None}
    sigma_px = model.fx_px * model.focal_relative_sigma
    return {"focal_px": model.fx_px, "focal_sigma_px": sigma_px, "edge_bias_px": model.edge_bias_px}


@operation
def world(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Put the ball of the simulated room somewhere: so far ahead, and to the left."""
    room = setup_of(desk).camera.room
    if room is None:
        raise ConfigError("there is no simulated room before this camera; move the real thing")
    room.place(get_number(args, "x_m"), get_number(args, "y_m", 0.0))
    return DeskReply(data=room.where())
