"""Questions about the lens: pictures at known distances, a camera file that is there, or a guess."""

from __future__ import annotations

import datetime as dt
import math
import re
import shlex
from dataclasses import replace
from pathlib import Path

from stadimeter.app.detectors import build_detectors
from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import parse_angle, parse_length
from stadimeter.core.camera_model import CameraModel, Provenance
from stadimeter.core.detection import DetectionStatus
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.calibration import Calibration, KnownDistance, calibrate
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.calibration.calibrating import check_lens_settings, known_distance, looked_at_again
from stadimeter.workbench.measuring import measure_picture
from stadimeter.workbench.setup.camera_step import words_of
from stadimeter.workbench.setup.known import CAMERA_FILE, PICTURES, Known
from stadimeter.workbench.setup.question import Accepted, Option, Question, Step
from stadimeter.workbench.setup.target import chosen_target, look

GUESS = "60 deg"
"""The width of what a usual webcam sees."""

GUESS_RELATIVE_SIGMA = 0.1

WIDEST_RAD, NARROWEST_RAD = math.radians(130), math.radians(20)
"""A camera that sees more or less than this is unusual: a size or a distance may be in another unit than was meant."""

TAPE_RELATIVE_SIGMA = 0.01
"""How well people measure a distance with a tape, as a share of it."""

CONTRADICTION_SIGMAS = 3.0

SKIP = "skip"


class CalibrationStep(Step):
    """How far away things are that look so large."""

    key = "calibration"

    def question(self, known: Known) -> Question:
        """Ask for the most certain way that is there."""
        name = known.answers["target"]
        options = [*_known_files(known), *_live(known), *_named_pictures(known)]
        options.append(Option(GUESS, "a guess: the camera sees that much across; distances may be wrong by a tenth"))
        put = f"Put the {name} into the middle of the picture, measure from the lens to it, and type the distance."
        return Question(
            key=self.key,
            text=f"How large does the {name} look, and how far away? {put if known.is_live else ''}".strip(),
            options=tuple(options),
            ready=options[0].answer,
            form=(
                "a distance now, such as 1 m; pictures at known distances, such as near.jpg@50cm far.jpg@2m; a camera "
                "file; or the width of the view, such as 60 deg"
            ),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Find out the focal length."""
        if text.endswith(".toml"):
            return _from_file(known, text)
        if re.fullmatch(r"[\d.]+\s*(deg|°)", text):
            known.camera_model, known.model_file = guessed_model(known, parse_angle(text)), ""
            return Accepted(answer=text, notes=("This is rough: distances may be wrong by a tenth of themselves.",))
        pictures = words_of(text) if "@" in text else [_picture_now(known, text)]
        answer = pictures[0] if len(pictures) == 1 else shlex.join(pictures)
        return Accepted(answer=answer, notes=_calibrate(known, pictures))


class ProofStep(Step):
    """A second distance, which the first must agree with."""

    key = "proof"

    def is_asked(self, known: Known) -> bool:
        """Return whether the camera was calibrated with what it saw just now."""
        return known.is_live and known.answers.get("calibration", "").startswith(f"{PICTURES}/")

    def question(self, known: Known) -> Question:
        """Ask for a distance several times as large."""
        _, at_m = _split(known.answers["calibration"])
        return Question(
            key=self.key,
            text=f"Now put the {known.answers['target']} elsewhere, to prove it, and type the distance.",
            options=(Option(f"{3 * at_m:g} m", "three times as far"), Option(SKIP, "no proof")),
            ready=f"{3 * at_m:g} m",
            form="a distance such as 3 m, or skip",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Measure at the second distance; refuse what contradicts the first."""
        if text == SKIP or known.camera_model is None:
            return Accepted(answer=SKIP)
        picture = text if "@" in text else _picture_now(known, text)
        path, said_m = _split(picture)
        agrees = _compared(known, known.path(path), said_m)
        return Accepted(answer=picture, notes=(agrees, *_calibrate(known, [known.answers["calibration"], picture])))


def guessed_model(known: Known, view_rad: float) -> CameraModel:
    """Return the lens of a camera that sees an angle across its picture; a `ConfigError` if no camera does."""
    if not 0 < view_rad < math.radians(170):
        raise ConfigError(f"no camera sees {math.degrees(view_rad):g}° across; write it such as {GUESS}")
    width_px, height_px = known.frame.width_px, known.frame.height_px
    made = CameraModel.with_focal_length(width_px / 2 / math.tan(view_rad / 2), width_px, height_px)
    return replace(
        made,
        focal_relative_sigma=GUESS_RELATIVE_SIGMA,
        provenance=Provenance(method=f"a guess: {math.degrees(view_rad):g} degrees across", date=_today()),
    )


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
        named.append(f"{name.relative_to(known.folder) if name.is_relative_to(known.folder) else name}@{name.stem}")
    return [Option(shlex.join(sorted(named)), "the distances that the names of the pictures say")] if named else []


def _from_file(known: Known, text: str) -> Accepted:
    model = load_camera_model(known.path(text))
    model.for_frame(known.frame)  # refuses another aspect
    known.camera_model, known.model_file = model, text
    return Accepted(answer=text, notes=(_view(model),))


def _picture_now(known: Known, text: str) -> str:
    """Keep what the camera sees as a picture at a known distance, and return it as ``PICTURE@DISTANCE``."""
    try:
        at_m = parse_length(text)
    except ValueError as error:
        raise ConfigError(f"{error}; or give pictures, such as near.jpg@50cm") from error
    found, words = look(known, chosen_target(known))
    if found.status is not DetectionStatus.FOUND:
        raise ConfigError(words)
    picture = f"{PICTURES}/at-{at_m:g}m.png"
    write_picture(known.path(picture), known.frame.image)
    return f"{picture}@{at_m:g}m"


def _split(picture: str) -> tuple[str, float]:
    path, at, length = picture.rpartition("@")
    if not (at and path):
        raise ConfigError(f"{picture!r} does not say how far away the target is; write it such as 2ft.png@24in")
    try:
        return path, parse_length(length)
    except ValueError as error:
        raise ConfigError(f"{picture}: {error}") from error


def _calibrate(known: Known, pictures: list[str]) -> tuple[str, ...]:
    """Find out the focal length from pictures at known distances, and return what to say about it."""
    taken = [(known.path(path), at_m) for path, at_m in map(_split, pictures)]
    notes = check_lens_settings([path for path, _ in taken])
    choice = chosen_target(known)
    (target,) = build_detectors([choice], None)
    usable = _found([known_distance(path, at_m, target) for path, at_m in taken])
    rough = _fitted(usable).camera_model
    made = _fitted(_found(looked_at_again(usable, [choice], rough)))
    made.camera_model.for_frame(known.frame)  # refuses pictures of another aspect than the camera's
    known.camera_model, known.model_file = made.camera_model, ""
    return (*notes, _view(made.camera_model))


def _found(known: list[KnownDistance] | tuple[KnownDistance, ...]) -> tuple[KnownDistance, ...]:
    for each in known:
        if each.detection.status is not DetectionStatus.FOUND:
            raise CalibrationError(f"{each.picture}: the target is not found whole: {each.detection.reason}")
    return tuple(known)


def _fitted(known: tuple[KnownDistance, ...]) -> Calibration:
    return calibrate(known, date=_today(), distance_relative_sigma=TAPE_RELATIVE_SIGMA)


def _view(model: CameraModel) -> str:
    view_rad = 2 * math.atan(model.width_px / 2 / model.fx_px)
    words = (
        f"Focal length {model.fx_px:.0f} px ± {model.focal_relative_sigma:.1%}: the camera sees "
        f"{math.degrees(view_rad):.0f}° across."
    )
    if NARROWEST_RAD <= view_rad <= WIDEST_RAD:
        return words
    return f"{words} That is unusual: check the size and the distance, and their units."


def _compared(known: Known, path: Path, said_m: float) -> str:
    """Measure a picture of which the distance is known; a `CalibrationError` if the figures contradict each other."""
    choice: DriverChoice = chosen_target(known)
    model = known.camera_model
    (result,) = measure_picture(path, build_detectors([choice], model), model).targets if model else ()
    read = result.measurement
    if read.depth_m is None or read.sigma_m is None:
        raise CalibrationError(f"{path}: {read.reason}")
    allowed_m = CONTRADICTION_SIGMAS * math.hypot(read.sigma_m, TAPE_RELATIVE_SIGMA * said_m)
    words = f"you say {said_m:.2f} m, the first distance gives {read.depth_m:.2f} m"
    if abs(read.depth_m - said_m) > allowed_m:
        raise CalibrationError(
            f"{words}, which is more apart than ± {allowed_m:.2f} m: does the focus move, is the size right, and were "
            "both distances measured from the lens?"
        )
    return f"They agree: {words}."


def _today() -> str:
    return dt.datetime.now().astimezone().date().isoformat()
