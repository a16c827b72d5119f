"""Questions about the target: its kind, its size, and which tag it is."""

from __future__ import annotations

from typing import Any

from stadimeter.config.ball_sizes import BALLS
from stadimeter.config.paper import PAPER
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.errors import ConfigError
from stadimeter.workbench.setup.camera_step import SIMULATED
from stadimeter.workbench.setup.known import Known
from stadimeter.workbench.setup.question import Accepted, Option, Question, Step
from stadimeter.workbench.setup.target import chosen_target, family_in_view, look
from stadimeter.workbench.simulated_room import BALL

KINDS = (
    Option("ball", "a ball of one colour"),
    Option("sheet", "a sheet of paper or a card, lying flat"),
    Option("tag", "a printed AprilTag or ArUco tag (`stadimeter print tag` makes one)"),
    Option("disc", "a flat disc of one brightness, such as a lid or a plate"),
)

_SIZES = {
    "ball": ("tennis ball", f"its diameter, such as 6.4 cm, or a name: {', '.join(BALLS)}"),
    "sheet": (
        "A4",
        f"width and height, such as 11 in, 8.5 in, or a name: {', '.join(PAPER)}; cut by hand or not flat: A4 ± 3 mm",
    ),
    "tag": ("8 cm", "the side of its black square, such as 8 cm"),
    "disc": ("12 cm", "its diameter, such as 12 cm"),
}
"""The ready answer, and how one may look."""


_NAMES = {"ball": tuple(BALLS), "sheet": tuple(PAPER)}


class TargetStep(Step):
    """What to measure."""

    key = "target"

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """Return the kinds of targets."""
        return Question(key=self.key, text="What shall be measured?", options=KINDS, ready="ball")

    def accept(self, known: Known, text: str) -> Accepted:  # noqa: ARG002
        """Take one of the kinds."""
        kinds = [kind for kind, _ in KINDS]
        if text.lower() not in kinds:
            raise ConfigError(f"{text!r} is none of {', '.join(kinds)}")
        return Accepted(answer=text.lower())


class SizeStep(Step):
    """How large the target is."""

    key = "size"

    def question(self, known: Known) -> Question:
        """Ask for the size that the kind of target has."""
        kind = known.answers["target"]
        ready, form = _SIZES[kind]
        ready = BALL if kind == "ball" and known.answers["camera"] == SIMULATED else ready
        return Question(
            key=self.key,
            text=f"How large is the {kind}? The distances are as right as this is: measure it.",
            ready=ready,
            form=form,
            names=_NAMES.get(kind, ()),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check the size, and look for what needs no more to be found."""
        choice = chosen_target(known, size=text)
        named = (_in_figures(choice.options),) if text[:1].isalpha() else ()
        if known.answers["target"] not in {"sheet", "disc"}:
            return Accepted(answer=text, notes=named)
        found, words = look(known, choice, text)
        return Accepted(answer=text, notes=(*named, words), doubt=is_doubtful(found))


class TagStep(Step):
    """Which tag it is."""

    key = "tag"

    def is_asked(self, known: Known) -> bool:
        """Return whether the target is a tag."""
        return known.answers.get("target") == "tag"

    def question(self, known: Known) -> Question:
        """Look for tags of several families."""
        seen = family_in_view(known)
        return Question(
            key=self.key,
            text="Which family of tags, and which number?",
            found=(f"The picture shows {seen}.",) if seen else ("The picture shows no tag.",),
            ready=seen or "36h11",
            form="a family such as 36h11 or 4x4-50, and the number unless any will do, such as 36h11 7",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check the family, and look for the tag."""
        found, words = look(known, chosen_target(known, tag=text))
        return Accepted(answer=text, notes=(words,), doubt=is_doubtful(found))


def _in_figures(options: Any) -> str:
    """Say how large a thing is that was given by its name."""
    sides_m = [getattr(options, key) for key in ("diameter", "width", "height") if hasattr(options, key)]
    return f"That is {' × '.join(f'{100 * side_m:g}' for side_m in sides_m)} cm."


def is_doubtful(found: Detection) -> bool:
    """Return whether a person should look again: there is no target, or it looks like another one."""
    return found.status is not DetectionStatus.FOUND or " instead of " in found.reason
