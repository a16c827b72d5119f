"""The question for the colour of a ball, with a proposal from the camera's pictures."""

from __future__ import annotations

import re
from collections.abc import Sequence

from stadimeter.config.plugins import DETECTORS, load_plugin
from stadimeter.core.detection import DetectionStatus
from stadimeter.detectors.protocol import ColourProposal, ColourSample
from stadimeter.errors import ConfigError
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.colour_picture import colour_picture
from stadimeter.workbench.colour_places import (
    NOTHING_STANDS_OUT,
    ONLY_BACKGROUND,
    colour_sample,
    is_where_pointed,
    split_places,
)
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.setup.answers import words_of
from stadimeter.workbench.setup.camera_step import SHOWN
from stadimeter.workbench.setup.known import PICTURES, Known
from stadimeter.workbench.setup.question import Accepted, Question, Step
from stadimeter.workbench.setup.target import chosen_target, look
from stadimeter.workbench.setup.target_steps import is_doubtful

COLOURED = f"{PICTURES}/colour.png"

_PLACE = re.compile(r"\d+(\.\d+)?,\d+(\.\d+)?")


class ColourStep(Step):
    """The range of colours of a ball."""

    key = "colour"
    names_files = True

    def __init__(self) -> None:
        self._proposed: tuple[str, tuple[str, ...]] | None = None
        self._camera = ""  # the one that it was proposed for

    def is_asked(self, known: Known) -> bool:
        """Return whether the target is a ball."""
        return known.answers.get("target") == "ball"

    def question(self, known: Known) -> Question:
        """Propose the range of what stands out, or the one that the last answer has led to."""
        if self._camera != known.answers["camera"]:
            self._proposed, self._camera = None, known.answers["camera"]
        ready, found = self._proposed or (self._what_stands_out(known) if known.looks_ahead else ("", ()))
        return Question(
            key=self.key,
            text="What colour is the ball?",
            found=found,
            ready=ready,
            form=(
                f"places on the ball in {SHOWN}, in pixels to the right and down, such as 312,240 330,262; "
                'pictures with places, such as dusk.jpg@290,255; or a range such as "29,86,6:64,255,255"'
            ),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Take a range, or find one for places and pictures."""
        if ":" in text and "@" not in text:
            self._proposed = None
            found, words = look(known, chosen_target(known, colour=text))
            return Accepted(answer=text, notes=(words,), doubt=is_doubtful(found))
        samples = _samples(known, text)
        proposal = _propose(samples)
        if proposal is None:
            raise ConfigError(ONLY_BACKGROUND if any(each.places_px for each in samples) else NOTHING_STANDS_OUT)
        notes = _told(known, samples, proposal)
        self._proposed = proposal.colour, notes
        return Accepted(answer=proposal.colour, notes=notes, doubt=True)

    def _what_stands_out(self, known: Known) -> tuple[str, tuple[str, ...]]:
        for frame in known.frames:
            samples = [ColourSample(frame)]
            proposal = _propose(samples)
            if proposal is not None and proposal.views[0].detection.status is DetectionStatus.FOUND:
                known.frames = (frame, *(each for each in known.frames if each is not frame))
                write_picture(known.path(SHOWN), frame.image)
                self._proposed = proposal.colour, _told(known, samples, proposal)
                return self._proposed
        words = f"{NOTHING_STANDS_OUT[0].upper()}{NOTHING_STANDS_OUT[1:]}: point at it in {SHOWN}."
        return "", (words,)


def _propose(samples: Sequence[ColourSample]) -> ColourProposal | None:
    found = load_plugin(DETECTORS, "ball").propose_colour
    return found(samples) if found else None


def _samples(known: Known, text: str) -> list[ColourSample]:
    """Return the pictures and places that an answer names; places without a picture are in the one that is shown."""
    words = words_of(text)
    here = [word for word in words if _PLACE.fullmatch(word)]
    samples = [colour_sample(known.frame, SHOWN, here)] if here else []
    for word in words:
        if word not in here:
            name, places = split_places(str(known.path(word)))
            samples.append(colour_sample(open_picture(known.path(name)), name, places))
    return samples


def _told(known: Known, samples: Sequence[ColourSample], proposal: ColourProposal) -> tuple[str, ...]:
    """Say what a range shows, and draw it."""
    view = proposal.views[0]
    write_picture(known.path(COLOURED), colour_picture(samples[0].frame.image, view, proposal.colour))
    x_px, y_px = view.detection.centre_px
    if not is_where_pointed(samples[0], view):
        notes = ["With this range, no ball is found where you point."]
    else:
        notes = [f"A ball at {x_px:.0f},{y_px:.0f}, {view.detection.width_px:.0f} px across.{known.shown_in(COLOURED)}"]
    for other in view.others:
        notes.append(f"Something else has that colour, at {other.centre_px[0]:.0f},{other.centre_px[1]:.0f}.")
    if view.others:
        notes.append("Take it away, or point at several places on the ball.")
    return tuple(notes)
