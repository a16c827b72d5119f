"""Questions about the lens: distances before the camera, pictures at known distances, a camera file, or a guess."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from stadimeter.app.detectors import build_detectors
from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.units import parse_angle, parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.calibration import DISTANCE_RELATIVE_SIGMA
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.calibration.live_distance import APART_MIN, LiveDistance
from stadimeter.workbench.setup.answers import words_of
from stadimeter.workbench.setup.lens import (
    contradiction,
    guess_lens,
    is_unusual,
    lens_from,
    lens_in_words,
    parse_distance,
    picture_at,
    today,
)
from stadimeter.workbench.setup.question import (
    BOARD_FILE,
    CAMERA_FILE,
    PICTURES,
    Accepted,
    Known,
    Option,
    Question,
    SetupStep,
)
from stadimeter.workbench.setup.target import build_target, look, why_not_measured

# The width of what a usual webcam sees.
GUESS = "60 deg"

SKIP = "skip"


class CalibrationStep(SetupStep):
    """How far away things are that look so large."""

    key = "calibration"
    names_files = True

    def question(self, known: Known) -> Question:
        """Have the most certain way ready that there is."""
        name = known.answers["target"]
        put = f" Put the {name} into the middle of the picture." if known.is_live else ""
        options = [*_known_files(known), *_live(known), *_named_pictures(known)]
        options.append(Option(GUESS, "a guess: the camera sees that much across; distances may be wrong by a tenth"))
        return Question(
            key=self.key,
            text=f"How far away is the {name}? That calibrates the camera.{put} {_how_to_measure(known)}",
            found=_drawn_distances(known),
            options=tuple(options),
            ready=options[0].answer,
            unattended=GUESS if known.is_live and options[0].answer != CAMERA_FILE else "",
            form=(
                f"a distance to {_measured_to(name)}, such as 1 m, or 1 m ± 5 mm if you know how well; pictures with "
                "their distances to its middle, such as near.jpg@50cm far.jpg@2m; a camera file; or the width of the "
                "view, such as 60 deg"
            ),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Find out the focal length."""
        if text.endswith(".toml"):
            return _from_file(known, text)
        if re.fullmatch(r"[\d.,]+\s*(deg|°)", text):
            rough = ("This is rough: distances may be wrong by a tenth of themselves.",)
            return _accept_lens(known, guess_lens(known.frame, _angle(text)), text, rough)
        pictures, seen = (_pictures(known, text), ()) if "@" in text else _picture_now(known, text)
        is_one_word = len(pictures) == 1 and " " not in pictures[0]
        answer = pictures[0] if is_one_word else shlex.join(pictures)
        return _from_pictures(known, pictures, answer, seen)


class ProofStep(SetupStep):
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
        why = contradiction([picture_at(known.folder, each) for each in pictures], build_target(known))
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


def _pictures(known: Known, text: str) -> list[str]:
    """Return the pictures of an answer; a distance may have a space before its unit, a camera's picture no folder."""
    pictures: list[str] = []
    for word in words_of(text):
        if pictures and "@" not in word:
            pictures[-1] += word
        else:
            pictures.append(word)
    paths = {Path(frame.source).name: str(_path_from(known.folder, frame)) for frame in known.frames if frame.source}
    named = (each.rpartition("@") for each in pictures)
    return [f"{paths.get(name, name)}{at}{distance}" for name, at, distance in named]


def _path_from(folder: Path, frame: Frame) -> Path:
    path = Path(frame.source)
    return path.relative_to(folder) if path.is_relative_to(folder) else path


def _measured_to(name: str) -> str:
    return "its nearest point" if name == "ball" else f"the {name}"


def _how_to_measure(known: Known) -> str:
    """Say between which points a distance is meant: to a ball, that with a picture is another than that alone."""
    to = _measured_to(known.answers["target"])
    if known.is_live or not _limb_radius_m(known):
        return f"Measure from the lens to {to}."
    return f"Measure from the lens: to the ball's middle if you name a picture, to {to} if you give a distance alone."


def _drawn_distances(known: Known) -> tuple[str, ...]:
    """Draw both distances to a ball; nothing for what is flat, of which they are the same."""
    behind_m = _limb_radius_m(known)
    if not behind_m:
        return ()
    middle_m = f"{1 + behind_m:.4g}"
    return (
        "lens |<------- 1 m ------->( + )   alone, such as 1 m: to its nearest point",
        f"lens |<------ {middle_m} m ------->+     with a picture, near.jpg@{middle_m}m: to its middle",
    )


def _far(known: Known) -> str:
    shape_m = _limb_radius_m(known)
    near_m = picture_at(known.folder, known.answers["calibration"]).depth_m - shape_m
    return f"{3 * near_m:.3g} m"


def _limb_radius_m(known: Known) -> float:
    (named,) = build_detectors([build_target(known)], None)
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
        named.append(f"{_path_from(known.folder, frame)}@{name.stem}")
    return [Option(shlex.join(sorted(set(named))), "the distances to the middle that the names say")] if named else []


def _from_file(known: Known, text: str) -> Accepted:
    model = load_camera_model(known.path(text))
    model.for_frame(known.frame)  # refuses another aspect
    return _accept_lens(known, model, text, (), model_file="" if text == BOARD_FILE else text)


def _from_pictures(known: Known, pictures: list[str], answer: str, seen: tuple[str, ...]) -> Accepted:
    taken = [picture_at(known.folder, each) for each in pictures]
    model, notes = lens_from(taken, build_target(known))
    model.for_frame(known.frame)  # refuses pictures of another aspect than the camera's
    return _accept_lens(known, model, answer, (*seen, *notes))


def _accept_lens(
    known: Known, model: CameraModel, answer: str, notes: tuple[str, ...], model_file: str = ""
) -> Accepted:
    known.camera_model, known.model_file = model, model_file
    words = (*notes, lens_in_words(model))
    why_not = why_not_measured(known, model)
    return Accepted(
        answer=answer, notes=(*words, why_not) if why_not else words, doubt=is_unusual(model) or bool(why_not)
    )


def _picture_now(known: Known, text: str) -> tuple[list[str], tuple[str, ...]]:
    """Keep what the camera sees as a picture at a known distance.

    Returns:
        It as ``PICTURE@DEPTH``, and what was seen.
    """
    distance_m, relative_sigma = _distance(text)
    frame, seen = _take_live(known, distance_m) if known.is_live else _take_shown(known)
    picture = f"{PICTURES}/at-{distance_m:g}m.png"
    write_picture(known.path(picture), frame.image, frame.optics)
    depth_m = distance_m + _limb_radius_m(known)
    known_to = "" if relative_sigma == DISTANCE_RELATIVE_SIGMA else f"±{relative_sigma * depth_m:.4g}m"
    return [f"{picture}@{depth_m:.5g}m{known_to}"], (seen,)


def _take_live(known: Known, distance_m: float) -> tuple[Frame, str]:
    if known.camera is None:
        raise ConfigError("there is no camera")
    with LiveDistance(known.opening(known.camera), build_target(known), date=today()) as session:
        take = session.take(distance_m)
        frame = session.pictures[take.name]
    known.frames = (frame,)
    spread = f"spread {take.spread_share:.1%}"
    return frame, f"Found in {take.found} of {take.frames} frames, {take.size_px:.0f} px, {spread}."


def _take_shown(known: Known) -> tuple[Frame, str]:
    found, words = look(known, build_target(known))
    if found.status is not DetectionStatus.FOUND:
        raise ConfigError(words)
    return known.frame, words
