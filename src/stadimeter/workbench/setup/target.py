"""The target of the answers so far: its questions (kind, size, which tag), and looking for it in pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from stadimeter.app.detectors import build_detectors
from stadimeter.config.driver_tables import TARGET
from stadimeter.config.named_sizes import BALLS, PAPER, UNKNOWN_SIZE
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import split_quantities, split_spread
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.core.target import TargetShape
from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.annotation import Mark, annotate, write_picture
from stadimeter.workbench.frame_source import BALL, take_frame
from stadimeter.workbench.measuring import remedies_for
from stadimeter.workbench.setup.camera_step import SIMULATED
from stadimeter.workbench.setup.question import PICTURES, Accepted, Known, Option, Question, SetupStep

FOUND = f"{PICTURES}/found.png"

# The answer for a ball of which no range of colours is wanted.
ANY_COLOUR = "any"

# Sizes beyond these are written in another unit than was meant.
MIN_SIZE_M, MAX_SIZE_M = 0.005, 3.0


def target_table(answers: Mapping[str, str]) -> dict[str, Any]:
    """Return the table of the target, ``[targets.ball]`` for one, from complete answers."""
    kind, (size, tolerance) = answers["target"], size_and_tolerance(answers["size"])
    known_to = {"tolerance": tolerance} if tolerance else {}
    if kind == "ball":
        colour = answers.get("colour", ANY_COLOUR)
        return {"detector": kind, "diameter": size, **known_to, **({} if colour == ANY_COLOUR else {"hsv": colour})}
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
    return split_spread(text)


def _tag_keys(text: str) -> dict[str, Any]:
    """Return the keys for a family and, behind it, the number of a tag."""
    family, _, number = text.strip().partition(" ")
    keys: dict[str, Any] = {"family": family} if family else {}
    if number:
        keys["id"] = int(number) if number.strip().isdecimal() else number.strip()
    return keys


def target_shape(choice: DriverChoice) -> TargetShape:
    """Return what a target's detector knows of its shape."""
    (named,) = build_detectors([choice], None)
    return named.detector.target_shape


def build_target(known: Known, **answers: str) -> DriverChoice:
    """Return the target with further answers; a `ConfigError` says what is wrong with them, in people's units too."""
    table = target_table({**known.answers, **answers})
    choice = known.choose(TARGET, ("targets", table["detector"]), table)
    size_m = target_shape(choice).shortest_m
    if not MIN_SIZE_M <= size_m <= MAX_SIZE_M:
        likely = "millimetres or inches" if size_m > MAX_SIZE_M else "centimetres or metres"
        raise ConfigError(
            f"{answers.get('size', '')!r} is {size_m:g} m; targets have {MIN_SIZE_M * 1000:g} mm to {MAX_SIZE_M:g} m; "
            f"did you mean {likely}?"
        )
    return choice


def detect_in(frames: Sequence[Frame], choice: DriverChoice, lens: CameraModel | None) -> tuple[Frame, Detection]:
    """Return the first frame in which the target is found, or else the first of all, with what is detected in it."""
    (named,) = build_detectors([choice], lens)
    seen: list[tuple[Frame, Detection]] = []
    for frame in frames:
        seen.append((frame, named.detector.detect(frame, lens=lens and lens.for_frame(frame))))
        if seen[-1][1].status is DetectionStatus.FOUND:
            return seen[-1]
    return seen[0]


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
    words += _remedy_in_words(choice, found, frame, known.camera_model, size or known.answers["size"])
    mark = Mark(detection=found, headline=choice.name, lines=(words,))
    write_picture(known.path(FOUND), annotate(frame.image, [mark]))
    return found, f"{words}{known.shown_in(FOUND)}" if found.status is DetectionStatus.FOUND else words


def why_not_measured(known: Known, lens: CameraModel) -> str:
    """Say why the target is not found through a lens in any of the pictures; empty if it is found in one.

    Before a live camera it need not be there now: only what is found without the lens contradicts it.
    """
    choice = build_target(known)
    frame, found = detect_in(known.frames, choice, lens)
    if found.status is DetectionStatus.FOUND:
        return ""
    if known.is_live and detect_in([frame], choice, None)[1].status is not DetectionStatus.FOUND:
        return ""
    remedy = _remedy_in_words(choice, found, frame, lens, known.answers["size"])
    return f"Through this lens nothing is measured. {describe_detection(choice.name, found)}{remedy}"


def _remedy_in_words(
    choice: DriverChoice, refused: Detection, frame: Frame, lens: CameraModel | None, size: str
) -> str:
    """Say which other answer for the size makes the target found; empty for none."""
    remedies = remedies_for(choice, refused, frame, lens and lens.for_frame(frame))
    own, _ = size_and_tolerance(size)
    answers = [f"{own} ± {each.value}" if each.key == "tolerance" else each.value for each in remedies]
    return f" It is found with the size {' or '.join(answers)}." if answers else ""


def describe_detection(name: str, found: Detection) -> str:
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
            choice = build_target(known, tag=family)
        except StadimeterError:
            continue
        _, found = detect_in(known.frames, choice, None)
        if found.status is DetectionStatus.FOUND:
            return f"{family} {found.number}"
    return ""


# Families that are looked for, those that are least often seen in mere clutter first.
FAMILIES = ("36h11", "5x5-50", "4x4-50", "6x6-50", "25h9", "16h5", "aruco-original")

KINDS = (
    Option("ball", "a ball of one colour"),
    Option("sheet", "a sheet of paper or a card, lying flat"),
    Option("tag", "a printed AprilTag or ArUco tag (`stadimeter print tag` makes one)"),
    Option("disc", "a flat disc of one brightness, such as a lid or a plate"),
)

# The ready answer, and how one may look.
_SIZES = {
    "ball": ("tennis ball", f"its diameter, such as 6.4 cm, or a name: {', '.join(BALLS)}"),
    "sheet": (
        "A4",
        f"width and height, such as 11 in, 8.5 in, or a name: {', '.join(PAPER)}; cut by hand or not flat: A4 ± 3 mm",
    ),
    "tag": ("8 cm", "the side of its black square, such as 8 cm"),
    "disc": ("12 cm", "its diameter, such as 12 cm"),
}


_NAMES = {"ball": tuple(BALLS), "sheet": tuple(PAPER)}


class TargetStep(SetupStep):
    """What to measure."""

    key = "target"

    asked = Question(text="What shall be measured?", options=KINDS, ready="ball")

    def accept(self, known: Known, text: str) -> Accepted:  # noqa: ARG002
        """Take one of the kinds."""
        kinds = [kind.answer for kind in KINDS]
        if text.lower() not in kinds:
            raise ConfigError(f"{text!r} is none of {', '.join(kinds)}")
        return Accepted(answer=text.lower())


class SizeStep(SetupStep):
    """How large the target is."""

    key = "size"

    def question(self, known: Known) -> Question:
        """Ask for the size that the kind of target has."""
        kind = known.answers["target"]
        ready, form = _SIZES[kind]
        ready = BALL if kind == "ball" and known.answers["camera"] == SIMULATED else ready
        return Question(
            text=f"How large is the {kind}? The distances are as right as this is: measure it.",
            ready=ready,
            form=f"{form}; unknown if you do not know it",
            names=_NAMES.get(kind, ()),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check the size, and look for what needs no more to be found."""
        if text.lower() in UNKNOWN_SIZE:
            raise ConfigError(
                "it can be found out by moving the camera: answer with something of known size, such as a sheet of A4, "
                "which calibrates the camera; then `stadimeter calibrate size` learns the size of this one"
            )
        choice = build_target(known, size=text)
        named = (_describe_size(choice.options),) if text[:1].isalpha() else ()
        if known.answers["target"] not in {"sheet", "disc"}:
            return Accepted(answer=text, notes=named)
        found, words = look(known, choice, text)
        return Accepted(answer=text, notes=(*named, words), doubt=is_doubtful(found))


class TagStep(SetupStep):
    """Which tag it is."""

    key = "tag"

    def is_asked(self, known: Known) -> bool:
        """Return whether the target is a tag."""
        return known.answers.get("target") == "tag"

    def question(self, known: Known) -> Question:
        """Look for tags of several families."""
        seen = family_in_view(known)
        return Question(
            text="Which family of tags, and which number?",
            found=(f"The picture shows {seen}.",) if seen else ("The picture shows no tag.",),
            ready=seen or "36h11",
            form="a family such as 36h11 or 4x4-50, and the number unless any will do, such as 36h11 7",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check the family, and look for the tag."""
        found, words = look(known, build_target(known, tag=text))
        return Accepted(answer=text, notes=(words,), doubt=is_doubtful(found))


def _describe_size(options: Any) -> str:
    """Say how large a thing is that was given by its name."""
    sides_m = [getattr(options, key) for key in ("diameter", "width", "height") if hasattr(options, key)]
    return f"That is {' × '.join(f'{100 * side_m:g}' for side_m in sides_m)} cm."


def is_doubtful(found: Detection) -> bool:
    """Return whether a person should look again: there is no target, or it looks like another one."""
    return found.status is not DetectionStatus.FOUND or " instead of " in found.reason
