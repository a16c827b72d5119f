"""Questions about the lens: distances before the camera, pictures at known distances, a camera file, or a guess."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from stadimeter.app.detectors import build_detectors
from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.paper import PAPER
from stadimeter.config.units import parse_angle, parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.calibration import DISTANCE_RELATIVE_SIGMA
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.calibration.live_distance import APART_MIN, LiveDistance
from stadimeter.workbench.setup.answers import words_of
from stadimeter.workbench.setup.known import BOARD_FILE, CAMERA_FILE, PICTURES, Known
from stadimeter.workbench.setup.lens import (
    PictureAt,
    contradiction,
    guessed_lens,
    is_unusual,
    lens_from,
    lens_in_words,
    parse_distance,
    picture_at,
    today,
)
from stadimeter.workbench.setup.question import Accepted, Option, Question, Step
from stadimeter.workbench.setup.target import chosen_target, look

GUESS = "60 deg"
"""The width of what a usual webcam sees."""

SKIP = "skip"


class CalibrationStep(Step):
    """How far away things are that look so large."""

    key = "calibration"
    names_files = True

    def question(self, known: Known) -> Question:
        """Have the most certain way ready that there is."""
        name = known.answers["target"]
        live = f" Put the {name} into the middle of the picture; measure from the lens to {_measured_to(name)}."
        options = [*_known_files(known), *_live(known), *_named_pictures(known)]
        options.append(Option(GUESS, "a guess: the camera sees that much across; distances may be wrong by a tenth"))
        return Question(
            key=self.key,
            text=f"How far away is the {name}? That calibrates the camera.{live if known.is_live else ''}",
            options=tuple(options),
            ready=options[0].answer,
            unattended=GUESS if known.is_live and options[0].answer != CAMERA_FILE else "",
            form=(
                "a distance, such as 1 m, or 1 m ± 5 mm if you know how well; pictures at known distances of its "
                "middle, such as near.jpg@50cm far.jpg@2m; a camera file; or the width of the view, such as 60 deg"
            ),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Find out the focal length."""
        if text.endswith(".toml"):
            return _from_file(known, text)
        if re.fullmatch(r"[\d.]+\s*(deg|°)", text):
            known.camera_model, known.model_file = guessed_lens(known.frame, _angle(text)), ""
            return Accepted(answer=text, notes=("This is rough: distances may be wrong by a tenth of themselves.",))
        pictures, seen = (_pictures(text), ()) if "@" in text else _picture_now(known, text)
        answer = pictures[0] if len(pictures) == 1 else shlex.join(pictures)
        return _from_pictures(known, pictures, answer, seen)


class ProofStep(Step):
    """A second distance, which the first must agree with."""

    key = "proof"
    names_files = True

    def is_asked(self, known: Known) -> bool:
        """Return whether the camera was calibrated with what it saw just now."""
        answer = known.answers.get("calibration", "")
        return known.is_live and answer.startswith(f"{PICTURES}/") and answer != BOARD_FILE

    def question(self, known: Known) -> Question:
        """Ask for a distance several times as large."""
        name, far = known.answers["target"], _far(known)
        return Question(
            key=self.key,
            text=f"Now put the {name} farther away, which proves the first distance. How far away is it?",
            options=(Option(far, "three times as far"), Option(SKIP, "no proof")),
            ready=far,
            unattended=SKIP,
            form="another distance, such as 3 m, or 3 m ± 1 cm",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Look at the second distance; refuse what contradicts the first."""
        if text == SKIP:
            return Accepted(answer=SKIP)
        if "@" not in text:
            _check_apart(known, text)
        second, seen = ([text], ()) if "@" in text else _picture_now(known, text)
        pictures = [known.answers["calibration"], *second]
        why = contradiction([picture_at(known.folder, each) for each in pictures], chosen_target(known))
        if why:
            raise CalibrationError(why)
        return _from_pictures(known, pictures, second[0], (*seen, "The two distances agree."))


def _check_apart(known: Known, text: str) -> None:
    """Refuse a second distance that is as good as the first: it proves nothing."""
    second_m, _ = _distance(text)
    first_m = picture_at(known.folder, known.answers["calibration"]).depth_m - _limb_radius_m(known)
    if max(first_m, second_m) < APART_MIN * min(first_m, second_m):
        raise CalibrationError(
            f"{second_m:.3g} m proves nothing beside {first_m:.3g} m: one must be {APART_MIN:g} times as far as the "
            f"other, such as {_far(known)}"
        )


def _angle(text: str) -> float:
    try:
        return parse_angle(text)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _distance(text: str) -> tuple[float, float]:
    try:
        return parse_distance(text)
    except ValueError as error:
        raise ConfigError(f"{error}; or give pictures, such as near.jpg@50cm") from error


def _pictures(text: str) -> list[str]:
    """Return the pictures of an answer; a distance may have a space before its unit."""
    pictures: list[str] = []
    for word in words_of(text):
        if pictures and "@" not in word:
            pictures[-1] += word
        else:
            pictures.append(word)
    return pictures


def _measured_to(name: str) -> str:
    return "its nearest point" if name == "ball" else f"the {name}"


def _far(known: Known) -> str:
    shape_m = _limb_radius_m(known)
    near_m = picture_at(known.folder, known.answers["calibration"]).depth_m - shape_m
    return f"{3 * near_m:.3g} m"


def _limb_radius_m(known: Known) -> float:
    (named,) = build_detectors([chosen_target(known)], None)
    return named.detector.target_shape.limb_radius_m


def _known_files(known: Known) -> list[Option]:
    try:
        load_camera_model(known.path(CAMERA_FILE)).for_frame(known.frame)
    except (ConfigError, CalibrationError):
        return []
    return [Option(CAMERA_FILE, "the camera file in this folder")]


def _live(known: Known) -> list[Option]:
    return [Option("1 m", f"the {known.answers['target']} is 1 m from the lens now")] if known.is_live else []


def _named_pictures(known: Known) -> list[Option]:
    """Return the pictures whose names are distances, such as ``2ft.png``."""
    named = []
    for frame in known.frames:
        name = Path(frame.source)
        try:
            parse_length(name.stem)
        except ValueError:
            continue
        path = name.relative_to(known.folder) if name.is_relative_to(known.folder) else name
        named.append(f"{path}@{name.stem}")
    return [Option(shlex.join(sorted(set(named))), "the distances that the names of the pictures say")] if named else []


def _from_file(known: Known, text: str) -> Accepted:
    model = load_camera_model(known.path(text))
    model.for_frame(known.frame)  # refuses another aspect
    return _taken(known, model, text, (), model_file="" if text == BOARD_FILE else text)


def _from_pictures(known: Known, pictures: list[str], answer: str, seen: tuple[str, ...]) -> Accepted:
    taken = [picture_at(known.folder, each) for each in pictures]
    try:
        model, notes = lens_from(taken, chosen_target(known))
    except CalibrationError as error:
        other = _other_paper(known, taken[:1])
        raise CalibrationError(f"{error}{other}") from error
    model.for_frame(known.frame)  # refuses pictures of another aspect than the camera's
    return _taken(known, model, answer, (*seen, *notes))


def _other_paper(known: Known, pictures: list[PictureAt]) -> str:
    """Return which paper it is rather than the one of the answers: the one with which it is found; empty for none."""
    if known.answers["target"] != "sheet":
        return ""
    for name in ("letter", "A4", *PAPER):  # the two that are mistaken for each other, first
        try:
            lens_from(pictures, chosen_target(known, size=name))
        except CalibrationError:
            continue
        return f". As {name} it is found: is it {name} instead of {known.answers['size']}? Then go back to the size"
    return ""


def _taken(known: Known, model: CameraModel, answer: str, notes: tuple[str, ...], model_file: str = "") -> Accepted:
    known.camera_model, known.model_file = model, model_file
    return Accepted(answer=answer, notes=(*notes, lens_in_words(model)), doubt=is_unusual(model))


def _picture_now(known: Known, text: str) -> tuple[list[str], tuple[str, ...]]:
    """Keep what the camera sees as a picture at a known distance.

    Returns:
        It as ``PICTURE@DEPTH``, and what was seen.
    """
    distance_m, relative_sigma = _distance(text)
    frame, seen = _taken_live(known, distance_m) if known.is_live else _shown(known)
    picture = f"{PICTURES}/at-{distance_m:g}m.png"
    write_picture(known.path(picture), frame.image, frame.optics)
    depth_m = distance_m + _limb_radius_m(known)
    known_to = "" if relative_sigma == DISTANCE_RELATIVE_SIGMA else f"±{relative_sigma * depth_m:.4g}m"
    return [f"{picture}@{depth_m:.5g}m{known_to}"], (seen,)


def _taken_live(known: Known, distance_m: float) -> tuple[Frame, str]:
    if known.camera is None:
        raise ConfigError("there is no camera")
    with LiveDistance(known.opening(known.camera), chosen_target(known), date=today()) as session:
        take = session.take(distance_m)
        frame = session.pictures[take.name]
    known.frames = (frame,)
    spread = f"spread {take.spread_share:.1%}"
    return frame, f"Found in {take.found} of {take.frames} frames, {take.size_px:.0f} px, {spread}."


def _shown(known: Known) -> tuple[Frame, str]:
    found, words = look(known, chosen_target(known))
    if found.status is not DetectionStatus.FOUND:
        raise ConfigError(words)
    return known.frame, words
