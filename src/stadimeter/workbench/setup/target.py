"""The target of the answers so far: its kind, what the detector asks about it, and looking for it in pictures."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from stadimeter.app.detectors import build_detectors
from stadimeter.app.live import pictures
from stadimeter.config.driver_tables import TARGET, read_driver_table
from stadimeter.config.files import is_file
from stadimeter.config.plugins import DriverChoice, DriverOptions, ReportsLacks, driver_names, load_driver
from stadimeter.config.units import UNKNOWN_SIZE, split_spread, validation_context
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, TargetShape
from stadimeter.core.frame import Frame, Image
from stadimeter.core.measurement import Measurement
from stadimeter.core.words import metres
from stadimeter.errors import ConfigError, DriverError, StadimeterError
from stadimeter.workbench.annotation import Mark, annotate, write_picture
from stadimeter.workbench.frame_source import BALL, take_frame
from stadimeter.workbench.measuring import Measuring, remedies_for
from stadimeter.workbench.picture_metadata import picture_remarks
from stadimeter.workbench.setup.camera_step import SIMULATED
from stadimeter.workbench.setup.question import PICTURES, Accepted, Known, Option, Question, SetupStep
from stadimeter.workbench.setup.recipes import Blank, Recipe, driver_blanks, fill, load_recipes, option_examples

FOUND = f"{PICTURES}/found.png"

# The answer for a ball of which no range of colours is wanted.
ANY_COLOUR = "any"

# The detector whose ball the simulated room holds.
IN_ROOM = "ball"

# Sizes beyond these are written in another unit than was meant.
MIN_SIZE_M, MAX_SIZE_M = 0.005, 3.0

# Nearer than where a target fills this share of the picture's shorter side, it is cut off sooner or later.
WHOLE_SHARE = 0.9


def offered_kinds() -> Mapping[str, Recipe]:
    """Return the kinds of target of every installed detector, by name, in the order of the list.

    A detector of another package, which no recipe knows, asks for what its options need.
    """
    return _kinds(tuple(driver_names(TARGET.group)))


@cache
def _kinds(drivers: tuple[str, ...]) -> Mapping[str, Recipe]:
    known = load_recipes("recipes/targets")
    models = {}
    for driver in drivers:
        with suppress(DriverError):  # its library is missing
            models[driver] = load_driver(TARGET.group, driver)
    found = {
        key: replace(kind, blanks=tuple(_named(blank, models[kind.driver]) for blank in kind.blanks))
        for key, kind in known.items()
        if kind.driver in models
    }
    others = [each for each in models if each not in {kind.driver for kind in known.values()}]
    for driver in (each for each in others if not models[each].needs_world):
        blanks = tuple(driver_blanks(models[driver]))
        table = "\n".join(f"{{{blank.key}}}" for blank in blanks)
        title = models[driver].title or driver
        found[driver] = Recipe(key=driver, driver=driver, title=title, blanks=blanks, configuration=table)
    return found


def _named(blank: Blank, model: type[DriverOptions]) -> Blank:
    """Add the names that an option of the driver knows, such as those of balls."""
    if not blank.option:
        return blank
    names = tuple(each for each in option_examples(model.model_fields[blank.option]) if each[:1].isalpha())
    return replace(blank, names=names, form=f"{blank.form}: {', '.join(names)}" if names else blank.form)


def kind_of(answers: Mapping[str, str]) -> Recipe:
    """Return the kind of the answers; a `ConfigError` if its detector is not installed any more."""
    kinds = offered_kinds()
    if answers["target"] not in kinds:
        raise ConfigError(f"{answers['target']!r} is none of {', '.join(kinds)}")
    return kinds[answers["target"]]


def thing_of(answers: Mapping[str, str]) -> str:
    """Return the word for one target."""
    kind = kind_of(answers)
    return kind.thing or kind.key


def target_table(answers: Mapping[str, str]) -> dict[str, Any]:
    """Return the table of the target, such as ``[targets.ball]``; ready answers stand for those that are not given."""
    kind = kind_of(answers)
    table = {TARGET.key: kind.driver, **tomllib.loads(fill(kind.configuration, kind.texts(answers)))}
    if any(blank.kind in {"size", "sides"} for blank in kind.blanks):
        _, tolerance = split_spread(answers.get("size", ""))
        table |= {"tolerance": tolerance} if tolerance else {}
    colour = answers.get("colour", ANY_COLOUR) if kind.has_colour else ANY_COLOUR
    return table if colour == ANY_COLOUR else {**table, "hsv": colour}


def members_of(answers: Mapping[str, str]) -> tuple[str, ...]:
    """Return the targets that the answers make: one, or several of one kind."""
    at = ("targets", answers["target"])
    choice, _ = read_driver_table(TARGET, at, target_table(answers), validation_context(Path()), [])
    return choice.members if choice else at[1:]


def target_shape(choice: DriverChoice) -> TargetShape:
    """Return a target's shape, as far as its detector knows it."""
    (named,) = build_detectors([choice], None)
    return named.detector.target_shape


def build_target(known: Known, **answers: str) -> DriverChoice:
    """Return the target with further answers; a `ConfigError` says what is wrong with them, in people's units too."""
    table = target_table({**known.answers, **answers})
    choice = known.choose(TARGET, ("targets", known.answers["target"]), table)
    size_m = target_shape(choice).shortest_m
    if not MIN_SIZE_M <= size_m <= MAX_SIZE_M:
        likely = "millimetres or inches" if size_m > MAX_SIZE_M else "centimetres or metres"
        raise ConfigError(
            f"{answers.get('size', '')!r} is {size_m:g} m; targets have {MIN_SIZE_M * 1000:g} mm to {MAX_SIZE_M:g} m; "
            f"did you mean {likely}?"
        )
    return choice


def detect_in(frames: Sequence[Frame], choice: DriverChoice, lens: CameraModel | None) -> tuple[Frame, Detection]:
    """Return the first frame in which the target is found, or perhaps, or the first of all; and what is seen in it."""
    (named,) = build_detectors([choice], lens)
    seen: list[tuple[Frame, Detection]] = []
    for frame in frames:
        seen.append((frame, named.detector.detect(frame, lens=lens and lens.for_frame(frame))))
        if seen[-1][1].status is DetectionStatus.FOUND:
            return seen[-1]
    return next((each for each in seen if each[1].is_whole), seen[0])


def look(known: Known, choice: DriverChoice, size: str = "") -> tuple[Detection, str]:
    """Look for the target in new pictures of a live camera, or those of a recording.

    The picture in which it is found becomes the one that is shown, and is drawn with its outline.

    Args:
        size: The answer for its size that is tried; empty for the one that was given.

    Returns:
        Where it is in that picture, and a sentence about it.
    """
    if known.is_live and known.camera is not None:
        known.frames = (take_frame(known.camera, known.opening),)
    frame, found = detect_in(known.frames, choice, known.camera_model)
    known.frames = (frame, *(each for each in known.frames if each is not frame))
    words = f"{describe_detection(choice.name, found)}"
    words += _remedy_in_words(choice, found, frame, known.camera_model, size or known.answers.get("size", ""))
    mark = Mark(detection=found, headline=choice.name, lines=(words,))
    write_picture(known.path(FOUND), annotate(frame.image, [mark]))
    return found, f"{words}{known.shown_in(FOUND)}" if found.is_whole else words


def why_not_measured(known: Known, lens: CameraModel) -> str:
    """Say why the target is not found through a lens in any of the pictures; empty if it is found in one.

    Before a live camera it need not be there now: only what is found without the lens contradicts it.
    """
    choice = build_target(known)
    frame, found = detect_in(known.frames, choice, lens)
    if found.is_whole:
        return ""
    if known.is_live and detect_in([frame], choice, None)[1].status is not DetectionStatus.FOUND:
        return ""
    remedy = _remedy_in_words(choice, found, frame, lens, known.answers.get("size", ""))
    return f"Through this lens nothing is measured. {describe_detection(choice.name, found)}{remedy}"


def _remedy_in_words(
    choice: DriverChoice, refused: Detection, frame: Frame, lens: CameraModel | None, size: str
) -> str:
    """Say which other answer for the size makes the target found; empty for none."""
    remedies = remedies_for(choice, refused, frame, lens and lens.for_frame(frame))
    own, _ = split_spread(size)
    answers = [f"{own} ± {each.value}" if each.key == "tolerance" else each.value for each in remedies]
    return f" It is found with the size {' or '.join(answers)}." if answers else ""


def describe_detection(name: str, found: Detection) -> str:
    """Say what was found, or why it was not."""
    x_px, y_px = found.centre_px
    number = "" if found.number is None else f" number {found.number}"
    reason = f"; {found.reason}" if found.reason else ""
    match found.status:
        case DetectionStatus.FOUND | DetectionStatus.PERHAPS:
            size = (
                f"{found.width_px:.0f} px across"
                if number or found.width_px == found.height_px
                else (f"{found.width_px:.0f} × {found.height_px:.0f} px")
            )
            how = "Found" if found.status is DetectionStatus.FOUND else "This is perhaps"
            return f"{how} the {name}{number} at {x_px:.0f},{y_px:.0f}, {size}{reason}."
        case DetectionStatus.TRUNCATED:
            return f"The {name} is cut off by the border of the picture{reason}."
        case _:
            return f"The {name} is not found{reason}."


class TargetStep(SetupStep):
    """The thing to measure: the name of a kind of target."""

    key = "target"

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """List the kinds of every detector."""
        options = tuple(Option(kind.key, kind.title, kind.group, kind.picture) for kind in offered_kinds().values())
        return Question(text="What shall be measured?", options=options, ready=options[0].answer)

    def accept(self, known: Known, text: str) -> Accepted:  # noqa: ARG002
        """Take one of the kinds."""
        return Accepted(answer=kind_of({"target": text.lower()}).key)


def kind_steps(answers: Mapping[str, str]) -> Iterator[KindStep]:
    """Yield the questions of the kind that was chosen."""
    if (kind := offered_kinds().get(answers.get("target", ""))) is not None:
        yield from (KindStep(kind, blank) for blank in kind.blanks)


@dataclass
class KindStep(SetupStep):
    """A question about a kind of target."""

    of: Recipe
    blank: Blank

    def __post_init__(self) -> None:
        self.key = self.blank.key
        # A length that spreads among all that may come has no field for a number alone.
        self.kind = "" if self.blank.kind in {"size", "sides"} else "thing"
        self.names_files = bool(self.blank.files)

    def question(self, known: Known) -> Question:
        """Ask for it, with what the picture shows or the folder holds as the ready answer."""
        seen = self._in_view(known)
        shows = (f"The picture shows {seen or f'no {self.of.key}'}.",) if self.blank.tries and known.looks_ahead else ()
        files = sorted(path.name for path in known.folder.glob(self.blank.files)) if self.blank.files else []
        has_room = self.key == "size" and self.of.driver == IN_ROOM and known.answers["camera"] == SIMULATED
        return Question(
            text=self.blank.text,
            found=shows,
            options=tuple(Option(name, "a file in this folder") for name in files),
            ready=BALL if has_room else seen or (files[0] if len(files) == 1 else self.blank.ready),
            form=self.blank.form,
            names=self.blank.names,
        )

    def _in_view(self, known: Known) -> str:
        """Return the first of the answers to try with which the target is found in the pictures, and its number."""
        for text in self.blank.tries if known.looks_ahead else ():
            try:
                choice = build_target(known, **{self.key: text})
            except StadimeterError:
                continue
            _, found = detect_in(known.frames, choice, None)
            if found.status is DetectionStatus.FOUND:
                return f"{text} {found.number}"
        return ""

    def accept(self, known: Known, text: str) -> Accepted:
        """Check the answer with the others; then look for the target, if nothing else says what it is."""
        if self.key == "size" and text.lower() in UNKNOWN_SIZE:
            raise ConfigError(
                "it can be found out by moving the camera: answer with something of known size, such as a sheet of A4, "
                "which calibrates the camera; then `stadimeter calibrate size` learns the size of this one"
            )
        self.blank.check(text, known.answers)
        if self.names_files and not is_file(known.path(text)):
            raise ConfigError(f"there is no file {known.path(text)}")
        answers = {**known.answers, self.key: text}
        is_last = all(each.key in answers for each in self.of.blanks) and not self.of.has_colour
        own = None if is_last else self._own_keys(answers)
        if not known.check(TARGET, ("targets", self.of.key), target_table(answers), own):
            return Accepted(answer=text)
        choice = build_target(known, **{self.key: text})
        named = (_describe_size(choice.options),) if self.key == "size" and text[:1].isalpha() else ()
        if not is_last:
            return Accepted(answer=text, notes=named)
        if isinstance(choice.options, ReportsLacks) and (lacks := choice.options.lacks()):
            raise ConfigError("; ".join(lacks))
        found, words = look(known, choice, text if self.key == "size" else "")
        return Accepted(answer=text, notes=(*named, words), doubt=is_doubtful(found))

    def _own_keys(self, answers: Mapping[str, str]) -> set[str]:
        """Return the keys of the target's table that follow from this answer."""
        mine = "\n".join(line for line in self.of.configuration.splitlines() if f"{{{self.key}}}" in line)
        return {"tolerance", *tomllib.loads(fill(mine, self.of.texts(answers)))}


def _describe_size(options: Any) -> str:
    """Say how large a thing is that was given by its name."""
    sides_m = [getattr(options, key) for key in ("diameter", "width", "height") if hasattr(options, key)]
    return f"That is {' × '.join(f'{100 * side_m:g}' for side_m in sides_m)} cm."


def is_doubtful(found: Detection) -> bool:
    """Check whether a person should look again: there is no target, or it looks like another one."""
    return found.status is not DetectionStatus.FOUND or " instead of " in found.reason


# Pictures for a page: the target looked for in one, before the answers are complete, drawn and described --------------

JPEG_QUALITY = 80

DRAWINGS = ("plain", "target", "mask")


def target_so_far(known: Known, colour: str = "") -> DriverChoice | None:
    """Return the target as far as the answers tell it; None before it can be looked for.

    Args:
        colour: A range that is tried; empty for that of the answers.
    """
    answers = known.answers
    if "target" not in answers or any(step.key not in answers for step in kind_steps(answers)):
        return None
    if kind_of(answers).has_colour and not (colour or "colour" in answers):
        return None
    try:
        return build_target(known, **({"colour": colour} if colour else {}))
    except StadimeterError:
        return None


def look_for_target(known: Known, frame: Frame, target: DriverChoice) -> tuple[Detection, Measurement | None]:
    """Look for the target in a frame, and measure it if the lens is known already."""
    (named,) = build_detectors([target], known.camera_model)
    if known.camera_model is None:
        return named.detector.detect(frame), None
    result = Measuring([named], known.camera_model).measure(frame, "").targets[0]
    return result.detection or Detection(target=target.name, status=DetectionStatus.NOT_FOUND), result.measurement


def describe_picture(frame: Frame, seen: Detection | None, measured: Measurement | None) -> Mapping[str, Any]:
    """Describe what is known of a picture, as JSON has it; places are in the camera's own pixels."""
    remarks = [f"{each[0].upper()}{each[1:]}." for each in picture_remarks(frame.image, frame.exposure_s)]
    return {
        "width_px": frame.width_px,
        "height_px": frame.height_px,
        "exposure_s": frame.exposure_s,
        "remarks": remarks,
        "words": describe_detection(seen.target, seen) if seen else "",
        "found": seen is not None and seen.is_whole,
        "distance_m": measured.distance_m if measured else None,
        "sigma_m": measured.sigma_m if measured else None,
    }


def draw_findings(frame: Frame, seen: Detection, measured: Measurement | None) -> Image:
    """Return the picture with the target's outline."""
    headline = seen.target
    if measured is not None and measured.distance_m is not None:
        headline = f"{headline}: {metres(measured.distance_m, measured.sigma_m or 0.0)}"
    mark = Mark(detection=seen, has_corners=len(seen.outline_px) == 4, headline=headline)
    return annotate(frame.image, [mark])


def encode_jpeg(image: Image, width_px: int = 0) -> bytes:
    """Return a picture as JPEG, no wider than asked for; 0 for as it is."""
    scale = width_px / image.shape[1] if width_px > 0 else 1.0
    return pictures.encode_jpeg(pictures.shrink(image, scale), JPEG_QUALITY)
