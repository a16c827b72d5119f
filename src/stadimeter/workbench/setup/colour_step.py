"""The question for the colour of a ball: a proposal from pictures, and trying a range before it is the answer."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct, field

from stadimeter.config.plugins import DETECTORS, load_driver
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import ColourProposal, ColourSample, ColourView, ProposesColour
from stadimeter.errors import ConfigError
from stadimeter.workbench import colour_aids
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.measuring import open_picture
from stadimeter.workbench.setup.camera_step import SHOWN
from stadimeter.workbench.setup.question import PICTURES, Accepted, Known, Question, SetupStep, words_of
from stadimeter.workbench.setup.target import ANY_COLOUR, build_target, is_doubtful, kind_of, look

# Pictures that are kept with their clicks; the oldest makes room for another.
MAX_PICTURES = 6

NOT_THERE = "No ball is seen where you point: point at another part of it, or bring it nearer."
MISSED = "No ball is seen with this range."
CLICK = "Click on the ball."
OTHERS = "Something else has this colour, at {places}: take it away, narrow the range, or point at more of the ball."


class ColourTrial(Struct):
    """Clicks on pictures of a ball, and the range that follows from them.

    Attributes:
        samples: The pictures that were clicked on, each with its clicks.
        colour: The range that follows from the clicks, or that was given; empty for none yet.
        seen_in: The picture of the last click; None before the first.
    """

    samples: list[ColourSample] = field(default_factory=list)
    colour: str = ""
    seen_in: Frame | None = None

    def point(self, frame: Frame, places: Sequence[colour_aids.Place], *, same_picture: bool) -> bool:
        """Fit the range to further clicks on the ball, and return whether a ball is seen where they are.

        Clicks in several lights, and on several colours of a ball, count together. A click beside the ball would spoil
        the others, so one where no ball is seen does not count.

        Args:
            same_picture: Whether the clicks belong to the picture of the clicks before.

        Raises:
            ConfigError: A click is outside the picture, or on the background; nothing has changed.
        """
        kept, newest = self.samples, ColourSample(frame, tuple(places))
        if same_picture and kept:
            kept, newest = kept[:-1], ColourSample(kept[-1].frame, (*kept[-1].places_px, *places))
        for place in places:
            colour_aids.check_place(place, "the picture", newest.frame)
        samples = [*kept, newest]
        proposal = ball_colours().propose_colour(samples)
        if proposal is None:
            raise ConfigError(colour_aids.ONLY_BACKGROUND)
        self.seen_in = newest.frame
        is_seen = colour_aids.is_where_pointed(newest, proposal.views[-1])
        if is_seen or not self.colour:
            self.colour = proposal.colour
        if is_seen:
            self.samples = samples[-MAX_PICTURES:]
        return is_seen

    def look(self, frame: Frame) -> bool:
        """Try the range of what stands out in a picture by itself, and return whether anything does; takes seconds."""
        proposal = ball_colours().propose_colour([ColourSample(frame)])
        if proposal is None or proposal.views[-1].detection.status is DetectionStatus.NOT_FOUND:
            return False
        self.colour = proposal.colour
        return True

    def take(self, colour: str, frame: Frame) -> None:
        """Try a range that a person gives; a `ConfigError` if it is none."""
        view_range(frame, colour)
        self.colour = colour


def ball_colours() -> type[ProposesColour]:
    """Return the detector that works with ranges of colours; `ConfigError` if the installed driver does not."""
    driver = load_driver(DETECTORS, "ball")
    if not issubclass(driver, ProposesColour):
        raise ConfigError("the detector for balls goes by no colour")
    return driver


def view_range(frame: Frame, colour: str) -> ColourView:
    """Return a view of what a range shows in a frame; a `ConfigError` if it is none."""
    try:
        return ball_colours().view_colour(frame, colour)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def describe_view(seen: ColourView, *, is_pointed_at: bool = True) -> str:
    """Say what a range shows in a picture, and what else has the colour."""
    if seen.detection.status is DetectionStatus.NOT_FOUND or not is_pointed_at:
        return MISSED if is_pointed_at else NOT_THERE
    x_px, y_px = seen.detection.centre_px
    ball = f"A ball at {x_px:.0f},{y_px:.0f}, {seen.detection.width_px:.0f} px across."
    if not seen.others:
        return ball
    places = " and ".join(f"{each.centre_px[0]:.0f},{each.centre_px[1]:.0f}" for each in seen.others[:3])
    return f"{ball} {OTHERS.format(places=places)}"


COLOURED = f"{PICTURES}/colour.png"

NO_COLOUR = (
    "{word!r} is no picture. Point at the ball instead: give a place on it in {shown}, in pixels from the left and "
    "from the top, such as 312,240; or a range such as 29,86,6:64,255,255"
)

_PLACE = re.compile(r"\d+(\.\d+)?,\d+(\.\d+)?")


class ColourStep(SetupStep):
    """The colour of a ball: a range such as `29,86,6:64,255,255`, or places on it in the picture such as `312,240`."""

    key = "colour"
    names_files = True

    def is_asked(self, known: Known) -> bool:
        """Check whether the target goes by colour."""
        return "target" in known.answers and kind_of(known.answers).has_colour

    def question(self, known: Known) -> Question:
        """Propose the range of what stands out."""
        ready, found, is_sure = _what_stands_out(known) if known.looks_ahead else ("", (), False)
        return Question(
            text="What colour is the ball?",
            found=found,
            ready=ready,
            is_sure=is_sure,
            form=(
                f"places on the ball in {SHOWN}, in pixels to the right and down, such as 312,240 330,262; "
                'pictures with places, such as dusk.jpg@290,255; a range such as "29,86,6:64,255,255"; or '
                f"{ANY_COLOUR}, if it stands out by its outline alone"
            ),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Take a range, or find one for places and pictures."""
        if text == ANY_COLOUR or (":" in text and "@" not in text):
            found, words = look(known, build_target(known, colour=text))
            return Accepted(answer=text, notes=(words,), doubt=is_doubtful(found))
        samples = _samples(known, text)
        proposal = ball_colours().propose_colour(samples)
        if proposal is None:
            raise ConfigError(
                colour_aids.ONLY_BACKGROUND
                if any(each.places_px for each in samples)
                else colour_aids.NOTHING_STANDS_OUT
            )
        return Accepted(answer=proposal.colour, notes=_notes_on(known, samples, proposal), doubt=True)


def _what_stands_out(known: Known) -> tuple[str, tuple[str, ...], bool]:
    """Return the range of what stands out in a picture, words about it, and whether nothing else has the colour.

    That picture becomes the one that is shown.
    """
    for frame in known.frames:
        samples = [ColourSample(frame)]
        proposal = ball_colours().propose_colour(samples)
        if proposal is not None and proposal.views[0].detection.status is DetectionStatus.FOUND:
            known.frames = (frame, *(each for each in known.frames if each is not frame))
            write_picture(known.path(SHOWN), frame.image)
            return proposal.colour, _notes_on(known, samples, proposal), not proposal.views[0].others
    words = f"{colour_aids.NOTHING_STANDS_OUT[0].upper()}{colour_aids.NOTHING_STANDS_OUT[1:]}: point at it in {SHOWN}."
    return "", (words,), False


def _samples(known: Known, text: str) -> list[ColourSample]:
    """Return the pictures and places that an answer names; places without a picture are in the one that is shown."""
    words = words_of(text)
    here = [word for word in words if _PLACE.fullmatch(word)]
    samples = [colour_aids.colour_sample(known.frame, SHOWN, here)] if here else []
    for word in words:
        if word not in here:
            if not Path(word).suffix and "@" not in word and not known.path(word).is_file():  # such as `green`
                raise ConfigError(NO_COLOUR.format(word=word, shown=SHOWN))
            name, places = colour_aids.split_places(str(known.path(word)))
            samples.append(colour_aids.colour_sample(open_picture(known.path(name)), name, places))
    return samples


def _notes_on(known: Known, samples: Sequence[ColourSample], proposal: ColourProposal) -> tuple[str, ...]:
    """Say what a range shows, and draw it."""
    view = proposal.views[0]
    write_picture(known.path(COLOURED), colour_aids.colour_picture(samples[0].frame.image, view, proposal.colour))
    is_pointed_at = colour_aids.is_where_pointed(samples[0], view)
    return (f"{describe_view(view, is_pointed_at=is_pointed_at)}{known.shown_in(COLOURED)}",)
