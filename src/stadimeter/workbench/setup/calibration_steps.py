"""Questions about the lens: distances before the camera, pictures at known distances, a camera file, or a guess."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from stadimeter.app.detectors import build_detectors
from stadimeter.config.camera_file import load_camera_model
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import parse_angle, parse_length, path_from, split_spread
from stadimeter.core.camera_model import CameraModel, Provenance
from stadimeter.core.frame import Frame
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.calibration import DISTANCE_RELATIVE_SIGMA, KnownDistance
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.calibration.board_session import today
from stadimeter.workbench.calibration.live_distance import (
    fit_distances,
    look_at_distance,
    off_axis_words,
    remedy_words,
    take_at,
)
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.picture_metadata import check_lens_settings, with_lens_settings
from stadimeter.workbench.setup.question import (
    CAMERA_FILE,
    PICTURES,
    Accepted,
    Known,
    Option,
    Question,
    SetupStep,
    words_of,
)
from stadimeter.workbench.setup.target import build_target, look, target_shape, thing_of, why_not_measured

# The width of what a usual webcam sees.
GUESS = "60 deg"


class CalibrationStep(SetupStep):
    """The distance of the target now; or pictures such as `near.jpg@50cm`, a camera file, or the width of the view."""

    key = "calibration"
    names_files = True

    def question(self, known: Known) -> Question:
        """Have the most certain way ready that there is."""
        name, has_limb = thing_of(known.answers), bool(target_shape(build_target(known)).limb_radius_m)
        put = f" Put the {name} into the middle of the picture." if known.is_live else ""
        # To a ball, a distance with a picture is another than one alone.
        to = "its nearest point" if has_limb else f"the {name}"
        to_middle = " to the ball's middle" if has_limb else ""
        measure = f"Measure from the lens to {to}."
        if has_limb and not known.is_live:
            measure = f"Measure from the lens:{to_middle} if you name a picture, to {to} if you give a distance alone."
        options = tuple(_options(known, to_middle))
        return Question(
            text=f"How far away is the {name}? That calibrates the camera.{put} {measure}",
            options=options,
            ready=options[0].answer,
            unattended=GUESS if known.is_live and options[0].answer != CAMERA_FILE else "",
            form=(
                f"a distance to {to}, such as 1 m, or 1 m ± 5 mm if you know how well; pictures with "
                f"their distances{to_middle}, such as near.jpg@50cm far.jpg@2m; a camera file; or how wide "
                "the camera sees, such as 60 deg"
            ),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Find out the focal length."""
        if text.endswith(".toml"):
            return _from_file(known, text)
        if re.fullmatch(r"[\d.,]+\s*(deg|°)", text):
            rough = ("This is a guess: distances may be wrong by 10 %.",)
            return _accept_lens(known, guess_lens(known.frame, text), text, rough)
        if "@" not in text:
            picture, seen = _picture_now(known, text)
            return _from_pictures(known, [picture], picture, seen)
        pictures = _pictures(known, text)
        is_one_word = len(pictures) == 1 and " " not in pictures[0]
        return _from_pictures(known, pictures, pictures[0] if is_one_word else shlex.join(pictures), ())


def _pictures(known: Known, text: str) -> list[str]:
    """Return the pictures of an answer; a distance may have a space before its unit, a camera's picture no folder."""
    pictures: list[str] = []
    for word in words_of(text):
        if pictures and "@" not in word:
            pictures[-1] += word
        else:
            pictures.append(word)
    paths = {Path(frame.source).name: known.relative(frame.source) for frame in known.frames if frame.source}
    named = (each.rpartition("@") for each in pictures)
    return [f"{paths.get(name, name)}{at}{distance}" for name, at, distance in named]


def _options(known: Known, to_middle: str) -> Iterator[Option]:
    """Yield answers, the most certain first: a camera file, a live picture, pictures named ``2ft.png``, and a guess."""
    if _is_usable(known, CAMERA_FILE):
        yield Option(CAMERA_FILE, "the camera file in this folder")
    if known.is_live:
        yield Option("1 m", f"the {thing_of(known.answers)} is 1 m from the lens now")
    named = {f"{known.relative(each.source)}@{Path(each.source).stem}" for each in known.frames if _is_named(each)}
    if named:
        yield Option(shlex.join(sorted(named)), f"the distances in the names of the pictures{to_middle}")
    yield Option(GUESS, "a guess of how wide the camera sees; distances may be wrong by 10 %")


def _is_usable(known: Known, file: str) -> bool:
    try:
        load_camera_model(known.path(file)).for_frame(known.frame)
    except (ConfigError, CalibrationError):
        return False
    return True


def _is_named(frame: Frame) -> bool:
    try:
        return parse_length(Path(frame.source).stem) > 0
    except ValueError:
        return False


def _from_file(known: Known, text: str) -> Accepted:
    model = load_camera_model(known.path(text))
    model.for_frame(known.frame)  # refuses another aspect
    return _accept_lens(known, model, text, (), model_file=text)


def _from_pictures(known: Known, pictures: list[str], answer: str, seen: tuple[str, ...]) -> Accepted:
    taken = [picture_at(known.folder, each) for each in pictures]
    model, notes = fit_lens(taken, build_target(known))
    model.for_frame(known.frame)  # refuses pictures of another aspect than the camera's
    return _accept_lens(known, model, answer, (*seen, *notes))


def _accept_lens(
    known: Known, model: CameraModel, answer: str, notes: tuple[str, ...], model_file: str = ""
) -> Accepted:
    known.camera_model, known.model_file, known.reach_m = model, model_file, None
    words = (*notes, describe_lens(model))
    why_not = why_not_measured(known, model)
    return Accepted(
        answer=answer, notes=(*words, why_not) if why_not else words, doubt=is_unusual(model) or bool(why_not)
    )


def _picture_now(known: Known, text: str) -> tuple[str, tuple[str, ...]]:
    """Keep what the camera sees as a picture at a known distance.

    Returns:
        It as ``PICTURE@DEPTH``, and what was seen.
    """
    distance_m, relative_sigma = parse_distance(text)
    choice = build_target(known)
    if known.is_live and known.camera is not None:
        with known.opening(known.camera) as source:
            take = take_at(source, choice, distance_m)
        known.frames, seen = (take.frame,), f"{take.words[0].upper()}{take.words[1:]}."
    else:
        found, seen = look(known, choice)
        if not found.is_whole:
            raise ConfigError(seen)
    picture = f"{PICTURES}/at-{distance_m:g}m.png"
    write_picture(known.path(picture), known.frame.image, known.frame.optics)
    depth_m = distance_m + target_shape(choice).limb_radius_m
    known_to = "" if relative_sigma == DISTANCE_RELATIVE_SIGMA else f"±{relative_sigma * depth_m:.4g}m"
    return f"{picture}@{depth_m:.5g}m{known_to}", (seen,)


# Relative standard deviation of a focal length from a guessed width of the view.
GUESS_RELATIVE_SIGMA = 0.1

# Nobody measures from a lens better than this share of a distance; and worse than that says nothing.
BEST_KNOWN, WORST_KNOWN = 0.001, 0.2

# A camera that sees more or less than this is unusual: a size or a distance may be in another unit than was meant.
MIN_VIEW_RAD, MAX_VIEW_RAD = math.radians(20), math.radians(130)


class PictureAt(NamedTuple):
    """A picture in which the target's centre has a known depth."""

    path: Path
    depth_m: float
    relative_sigma: float


def parse_distance(text: str) -> tuple[float, float]:
    """Read a distance such as ``1 m``, or ``1 m ± 5 mm``; return it in metres, and how well it is known.

    Returns:
        The distance, and its standard deviation as a share of it: that of a tape, unless it is named.

    Raises:
        ConfigError: It is no distance, or is not known well enough to calibrate with.
    """
    length, sigma = split_spread(text)
    try:
        distance_m = parse_length(length)
        share = parse_length(sigma) / distance_m if sigma else DISTANCE_RELATIVE_SIGMA
    except ValueError as error:
        raise ConfigError(f"{error}; or give pictures, such as near.jpg@50cm") from error
    if not 0 < share <= WORST_KNOWN:
        raise ConfigError(f"{text!r}: a distance that is known to {share:.0%} of itself calibrates nothing")
    return distance_m, max(share, BEST_KNOWN)


def picture_at(folder: Path, text: str) -> PictureAt:
    """Read ``PICTURE@DISTANCE``; a `ConfigError` if it is none."""
    path, at, length = text.rpartition("@")
    if not (at and path):
        raise ConfigError(f"{text!r} does not say how far away the target is; write it such as 2ft.png@24in")
    return PictureAt(path_from(folder, path), *parse_distance(length))


def fit_lens(pictures: Sequence[PictureAt], choice: DriverChoice) -> tuple[CameraModel, tuple[str, ...]]:
    """Find out the focal length from pictures, and return what a person should know about them.

    Raises:
        CalibrationError: The target is not found in a picture, or no lens explains what was seen.
        PictureError: A picture cannot be read.
    """
    check_lens_settings([each.path for each in pictures])
    fit = fit_distances(
        _known_distances(pictures, choice),
        _frame_of,
        [choice],
        distance_relative_sigma=max(each.relative_sigma for each in pictures),
    )
    _check_found(fit.left_out, choice)
    if fit.calibration is None:
        raise CalibrationError("no picture can be used")
    reads = [f"{Path(each.picture).name} reads {each.residual_share:+.1%}" for each in fit.calibration.pictures]
    several = ("With this, " + ", ".join(reads) + ".",) if len(reads) > 1 else ()
    aside = [
        off_axis_words(Path(each.picture).name, each.off_axis_rad, f"{each.depth_m:.3g} m")
        for each in fit.calibration.pictures
    ]
    notes = (*several, *(f"{words}." for words in aside if words))
    return with_lens_settings(fit.calibration.camera_model, [each.path for each in pictures]), notes


def guess_lens(frame: Frame, width: str) -> CameraModel:
    """Return the lens of a camera that sees an angle across its picture; a `ConfigError` if no camera does."""
    try:
        view_rad = parse_angle(width)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if not 0 < view_rad < math.radians(170):
        raise ConfigError(f"no camera sees {math.degrees(view_rad):g}° across; write it such as 60 deg")
    focal_px = frame.width_px / 2 / math.tan(view_rad / 2)
    return replace(
        CameraModel.with_focal_length(focal_px, frame.width_px, frame.height_px),
        focal_relative_sigma=GUESS_RELATIVE_SIGMA,
        provenance=Provenance(method=f"a guess: {math.degrees(view_rad):g} degrees across", date=today()),
    )


def describe_lens(model: CameraModel) -> str:
    """Say what a lens sees, and whether that is unusual."""
    words = (
        f"Focal length {model.fx_px:.0f} px ± {model.focal_relative_sigma:.1%}: the camera sees "
        f"{math.degrees(_view_rad(model)):.0f}° across."
    )
    return f"{words} That is unusual: check the size and the distance, and their units." if is_unusual(model) else words


def is_unusual(model: CameraModel) -> bool:
    """Check whether hardly any camera has such a lens."""
    return not MIN_VIEW_RAD <= _view_rad(model) <= MAX_VIEW_RAD


def _view_rad(model: CameraModel) -> float:
    return 2 * math.atan(model.width_px / 2 / model.fx_px)


def _known_distances(pictures: Sequence[PictureAt], choice: DriverChoice) -> tuple[KnownDistance, ...]:
    (target,) = build_detectors([choice], None)
    seen = (look_at_distance(str(each.path), open_picture(each.path), each.depth_m, target) for each in pictures)
    known = tuple(replace(each, is_confirmed=True) for each in seen)  # it was shown to the person, who went on
    _check_found(known, choice)
    return known


def _check_found(known: Sequence[KnownDistance], choice: DriverChoice) -> None:
    for each in known:
        if not each.is_usable:
            remedy = remedy_words(each, _frame_of(each.picture), choice)
            raise CalibrationError(f"{each.picture}: the target is not found whole: {each.detection.reason}{remedy}")


def _frame_of(name: str) -> Frame:
    return open_picture(Path(name))
