"""Questions for a size that is not known: pictures from places along a way of the camera, in which the target grows."""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.size_from_motion import StepErrors, StepView, learn_size
from stadimeter.workbench.annotation import write_picture
from stadimeter.workbench.calibration.size_by_steps import SizeSession, parse_move
from stadimeter.workbench.setup.calibration_steps import GUESS, CalibrationStep, take_shown
from stadimeter.workbench.setup.question import CAMERA_FILE, PICTURES, Accepted, Known, Question, SetupStep, words_of
from stadimeter.workbench.setup.target import build_target, is_unknown, kind_of

# How far a live camera is from where it began. A third place shows whether the target stood still.
PLACES = ("0 cm", "20 cm", "40 cm")

WITHOUT_DISTANCE = "a camera file, or the width of the view, such as 60 deg"

KEYS = ("way", "way_2", "way_3")


class SizelessCalibrationStep(CalibrationStep):
    """The question of how the camera was calibrated, where the target's size is not known and so calibrates nothing."""

    def is_asked(self, known: Known) -> bool:
        """Check whether the size is not known."""
        return is_unknown(known.answers.get("size", ""))

    def question(self, known: Known) -> Question:
        """Offer what needs no target."""
        options = tuple(each for each in super().question(known).options if each.answer in {CAMERA_FILE, GUESS})
        text = "How was the camera calibrated? A size that is not known calibrates nothing."
        return Question(text=text, options=options, ready=options[0].answer, form=WITHOUT_DISTANCE)

    def accept(self, known: Known, text: str) -> Accepted:
        """Take a lens that is known without the target."""
        if not text.endswith((".toml", "deg", "°")):
            raise ConfigError(f"{text!r}: without a size a distance calibrates nothing; give {WITHOUT_DISTANCE}")
        return super().accept(known, text)


@dataclass
class WayStep(SetupStep):
    """A place on the way of the camera; of pictures that were taken already, all of them."""

    number: int
    kind = "way"
    names_files = True

    def __post_init__(self) -> None:
        self.key = KEYS[self.number]

    def is_asked(self, known: Known) -> bool:
        """Check whether the size is to be learnt, or just was."""
        is_learnt = is_unknown(known.answers.get("size", "")) or KEYS[0] in known.answers
        return is_learnt and (known.is_live or self.number == 0)

    def question(self, known: Known) -> Question:
        """Ask for the camera at the next place."""
        thing, ready = kind_of(known.answers).thing, PLACES[self.number]
        grows = f"The size of the {thing} follows from how it grows as the camera comes nearer."
        if not known.is_live:
            form = "the first picture, and behind the others how far the camera had moved: a.jpg b.jpg@20cm c.jpg@40cm"
            return Question(text=f"Which pictures show that? {grows}", form=form)
        begin = f"Put the camera where it shall begin. {grows} From now on the {thing} stays where it is."
        move = f"Now move the camera straight towards the {thing}. How far is it from where it began?"
        return Question(text=move if self.number else begin, ready=ready, form="a length, such as 20 cm or 10 cm:right")

    def accept(self, known: Known, text: str) -> Accepted:
        """Look at the target from there, and learn its size at the last place."""
        is_taken = not known.is_live or text.startswith(f"{PICTURES}/")
        pictures = text if is_taken else self._take(known, text)
        earlier = [known.answers[key] for key in KEYS[: self.number]]
        session = SizeSession(build_target(known, size="unknown"), known.lens)
        views = [_view(known, session, each) for word in (*earlier, pictures) for each in words_of(word)]
        if known.is_live and self.number < len(PLACES) - 1:
            return Accepted(answer=pictures)
        learnt = learn_size(views, known.lens, StepErrors())
        sizes_m = session.sizes_m(learnt)
        tolerance_m = sizes_m.pop("tolerance")
        (size_m,) = sizes_m.values()
        size = f"{1000 * size_m:.4g} mm ± {1000 * tolerance_m:.2g} mm"
        known.answers["size"] = size
        return Accepted(answer=pictures, notes=(f"The {kind_of(known.answers).thing} measures {size}.",))

    def _take(self, known: Known, text: str) -> str:
        """Keep what the camera sees from a place, and return it as ``PICTURE@MOVE``."""
        parse_move(text, self.key)
        frame, _ = take_shown(known)
        write_picture(known.path(f"{PICTURES}/{self.key}.png"), frame.image, frame.optics)
        return f"{PICTURES}/{self.key}.png@{text.replace(' ', '')}"


def _view(known: Known, session: SizeSession, text: str) -> StepView:
    name, at, move = text.rpartition("@")
    path = known.path(name if at else text)
    looked = session.look_in_file(path, parse_move(move if at else "0 cm", str(path)))
    if looked.view is None:
        raise CalibrationError(f"{path}: it is not found whole: {looked.detection.reason}")
    return looked.view
