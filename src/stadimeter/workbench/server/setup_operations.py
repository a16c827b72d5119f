"""The set-up, one form at a time: the interview of `stadimeter init` with a live picture beside it.

A picture takes less than a tenth of a second on a desktop computer. These take a second or more on a small Pi: to open
a camera (``camera``, and ``begin`` where answers are taken up again), a distance that calibrates, and ``colour``
with clicks or ``look``. Answers come in order, so no picture comes meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from msgspec.structs import replace

from stadimeter.app.exact_json import plain
from stadimeter.config.driver_tables import CAMERA, DRIVER_KINDS
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import HEADER, TAKEN
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.colour_aids import NOTHING_STANDS_OUT, colour_picture, range_figures
from stadimeter.workbench.frame_source import SETTLING_WAIT_S, source_beside_run
from stadimeter.workbench.picture_metadata import better_exposure_s
from stadimeter.workbench.printing import svg_of
from stadimeter.workbench.saving import check_is_not_ours
from stadimeter.workbench.server import editing
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.setup import colour_step, recipe_steps, target
from stadimeter.workbench.setup.camera_step import CameraStep, HeldCamera, table_of, with_exposure
from stadimeter.workbench.setup.interview import ANSWERS, Interview, load_answers, was_left
from stadimeter.workbench.setup.question import CONFIGURATION, Known, Question, SetupStep
from stadimeter.workbench.setup.recipes import SCREEN, part_table
from stadimeter.workbench.wiring import circuits_picture, find_outputs, header_labels


class SetupDesk:
    """An interview that may be left and taken up again; its answers are in the folder of the configuration.

    Attributes:
        begun: The interview; None before it has begun.
        trial: The range of colours that is tried.
        shown: The picture that was shown last, which clicks are about; None before the first.
        offered: A camera that is looked through before it is chosen.
        doubt: What there is to say of an answer that is asked again.
        notes: What followed from each answer, by its key.
        trouble: Why an earlier answer is asked again.
    """

    def __init__(self, desk: Desk) -> None:
        self.folder = desk.configuration.parent
        self.camera = HeldCamera(partial(source_beside_run, configuration=desk.configuration, socket=desk.run_socket))
        desk.at_end.append(self.camera.close)
        self.begun: Interview | None = None
        self.trial = colour_step.ColourTrial()
        self.shown: Frame | None = None
        self.offered: DriverChoice | None = None
        self.doubt: tuple[str, ...] = ()
        self.notes: dict[str, tuple[str, ...]] = {}
        self.trouble = ""

    @property
    def interview(self) -> Interview:
        """The interview; a `ConfigError` before it has begun."""
        if self.begun is None:
            raise ConfigError("the set-up has not begun; begin it first")
        return self.begun

    @property
    def saved(self) -> Mapping[str, str]:
        """The answers that are kept."""
        file = self.folder / ANSWERS
        return load_answers(file) if file.exists() else {}

    def move_on(self) -> None:
        """Forget what was about the question that was asked."""
        self.offered, self.doubt, self.trouble = None, (), ""

    def leave(self) -> None:
        """Close the camera, and keep the answers."""
        self.camera.close()
        self.move_on()
        self.begun, self.shown = None, None
        self.notes.clear()
        self.trial = colour_step.ColourTrial()

    def newest(self) -> Frame:
        """Return the picture that the camera sees now, or one of a recording.

        Raises:
            ConfigError: No camera has been chosen.
            DriverError: It gives no picture.
        """
        known = self.interview.known
        choice = self.offered or known.camera
        if choice is None:
            raise ConfigError("no camera has been chosen yet")
        if self.offered is None and not known.is_live:
            self.shown = known.frame
            return self.shown
        with self.camera.hold(choice) as source:
            self.shown = source.capture.latest(SETTLING_WAIT_S)
        return self.shown

    def next_question(self) -> Question | None:
        """Return the next question; where an earlier answer is of no use any more, that one is asked again."""
        while self.begun is not None and self.begun.next_key:
            try:
                return self.begun.question()
            except StadimeterError as error:
                self.trouble = str(error)
                if not self.begun.back():
                    raise
        return None


# Questions whose options leave others open, which one form asks together with them.
_OPENED_BY: Mapping[str, Callable[[Mapping[str, str]], Iterable[SetupStep]]] = {
    target.TargetStep.key: target.kind_steps,
    recipe_steps.RecipeStep.key: recipe_steps.recipe_steps,
}


def _as_json(interview: Interview, question: Question) -> dict[str, Any]:
    """Return a question as JSON has it, with the blanks of each of its options."""
    known, options = interview.known, []
    for option in question.options:
        chosen = replace(known, answers={**known.answers, question.key: option.answer})
        is_again = option.answer in interview.earlier.get(question.key, "").split()
        kept = interview.earlier if is_again else {}
        blanks = []
        for step in _OPENED_BY[question.key](chosen.answers) if question.key in _OPENED_BY else ():
            if isinstance(step, target.KindStep | recipe_steps.BlankStep):
                asked = step.question(chosen)
                ready = kept.get(step.key, asked.ready)
                blanks.append({**plain(asked), "key": step.key, "text": step.blank.text, "ready": ready})
        options.append({**option._asdict(), "blanks": blanks})
    return {**plain(question), "found": list(question.found), "options": options}


def setup_of(desk: Desk) -> SetupDesk:
    """Return the set-up of a workbench process."""
    return desk.remember("setup", None, lambda: SetupDesk(desk))


@operation
def state(desk: Desk) -> dict[str, Any]:
    """Answer the answers so far, and the question that is next."""
    setup = setup_of(desk)
    question, interview = setup.next_question(), setup.begun
    answers = interview.known.answers if interview else setup.saved
    return {
        "begun": interview is not None,
        "folder": str(setup.folder),
        "answers": [
            {"key": key, "answer": answer, "notes": list(setup.notes.get(key, ()))} for key, answer in answers.items()
        ],
        "question": _as_json(interview, question) if interview and question else None,
        "room": setup.camera.room.where() if setup.camera.room else None,
        "doubt": {"notes": list(setup.doubt)} if setup.doubt else None,
        "trouble": setup.trouble,
        "done": interview is not None and question is None,
    }


@operation
def begin(desk: Desk, *, anew: bool = False) -> dict[str, Any]:
    """Begin, or go on where it was left; ``anew`` asks everything again, with the answers of the last time ready."""
    check_is_not_ours(desk.configuration)
    setup = setup_of(desk)
    setup.leave()
    saved = setup.saved
    known = Known(folder=setup.folder, opening=setup.camera.hold, looks_ahead=False)
    goes_on = not anew and was_left(setup.folder / ANSWERS, desk.configuration)
    setup.begun = Interview(setup.folder, earlier={} if goes_on else saved, known=known)
    if goes_on:
        setup.notes = {key: accepted.notes for key, accepted in setup.begun.resume(saved)}
    return state(desk)


@operation
def answer(desk: Desk, answer: str, question: str | None = None, *, confirm: bool = True) -> dict[str, Any]:
    """Answer the question; a doubtful answer is asked again, once, unless ``confirm`` is false.

    With ``question``, its key, no other question is answered: another device may have gone on.
    """
    setup = setup_of(desk)
    key = setup.interview.next_key
    if question is not None and question != key:
        raise ConfigError("another question is asked now: the set-up went on, on another device")
    accepted = setup.interview.answer(answer, confirm=confirm)
    setup.move_on()
    if accepted.doubt:
        setup.doubt = accepted.notes
    else:
        setup.notes[key] = accepted.notes
    return {**state(desk), "notes": list(accepted.notes)}


@operation
def back(desk: Desk) -> dict[str, Any]:
    """Take back the last answer."""
    setup = setup_of(desk)
    setup.move_on()
    if not setup.interview.back():
        raise ConfigError("this is the first question")
    return state(desk)


@operation
def leave(desk: Desk, *, camera_only: bool = False) -> dict[str, Any]:
    """Close the camera, and keep the answers. With ``camera_only`` the set-up stays at its question."""
    setup = setup_of(desk)
    if camera_only:
        setup.camera.close()
    else:
        setup.leave()
    return state(desk)


@operation
def picture(desk: Desk, draw: str = "target", width_px: int = 0) -> DeskReply:
    """Answer what the camera sees now: figures, and a JPEG that may be smaller than they are about."""
    setup = setup_of(desk)
    if draw not in target.DRAWINGS:
        raise ConfigError(f"draw is one of {', '.join(target.DRAWINGS)}")
    frame = setup.newest()
    if draw == "mask" and setup.trial.colour:
        seen = colour_step.view_range(frame, setup.trial.colour)
        values = {**target.describe_picture(frame, seen.detection, None), "words": colour_step.describe_view(seen)}
        values["range"] = range_figures(seen)
        image = colour_picture(frame.image, seen, setup.trial.colour)
        return DeskReply(data=values, attached=target.encode_jpeg(image, width_px))
    known, found, measured, image = setup.interview.known, None, None, frame.image
    if draw != "plain" and (wanted := target.target_so_far(known, setup.trial.colour)) is not None:
        found, measured = target.look_for_target(known, frame, wanted)
        image = target.draw_findings(frame, found, measured)
    return DeskReply(data=target.describe_picture(frame, found, measured), attached=target.encode_jpeg(image, width_px))


@operation
def camera(desk: Desk, camera: str, exposure: str = "") -> dict[str, Any]:
    """Look through a camera that is offered; with ``exposure``, lock that at a time such as ``10 ms``.

    The answer to give, with that, is in the reply; ``picture`` shows what it sees.
    """
    setup = setup_of(desk)
    wanted = with_exposure(camera, exposure) if exposure else camera
    if setup.interview.next_key != CameraStep.key:
        raise ConfigError("the camera is chosen already; go back to that question to choose another")
    choice = setup.interview.known.choose(CAMERA, ("camera",), table_of(wanted))
    with setup.camera.hold(choice) as source:
        frame, settings = source.capture.latest(SETTLING_WAIT_S), source.capture.remarks()
    setup.shown, setup.offered = frame, choice
    told = {
        "answer": wanted,
        "settings": [f"{each[0].upper()}{each[1:]}." for each in settings],
        "has_exposure": hasattr(choice.options, "exposure"),
        "is_locked": getattr(choice.options, "exposure", None) is not None,
        "proposed_exposure_s": better_exposure_s(frame.image, frame.exposure_s),
    }
    return {**target.describe_picture(frame, None, None), **told}


@operation
def colour(
    desk: Desk,
    clicks: tuple[tuple[float, float], ...] = (),
    *,
    forget: bool = False,
    range_: str | None = None,
    of: str = "newest",
    look: bool = False,
) -> dict[str, Any]:
    """Try a range of colours: from clicks on the picture that was shown last, or a given one.

    With ``look``, that of what stands out by itself, which takes seconds. ``forget`` takes back all clicks.
    """
    setup = setup_of(desk)
    frame, trial = setup.shown or setup.newest(), setup.trial
    if forget:
        trial = setup.trial = colour_step.ColourTrial()
    if range_ is not None:
        trial.take(range_, frame)
    if look and not trial.look(frame):
        raise ConfigError(f"{NOTHING_STANDS_OUT}; click on it")
    is_pointed_at = True
    if clicks:
        is_pointed_at = trial.point(frame, clicks, same_picture=of == "kept")
    if not trial.colour:
        return {"range": "", "found": False, "words": colour_step.CLICK, "others": [], "pictures": 0}
    seen = colour_step.view_range((trial.seen_in if clicks else None) or frame, trial.colour)
    is_found = is_pointed_at and seen.detection.status is not DetectionStatus.NOT_FOUND
    return {
        "range": trial.colour,
        "found": is_found,
        "words": colour_step.describe_view(seen, is_pointed_at=is_pointed_at),
        "others": [{"centre_px": list(each.centre_px)} for each in seen.others],
        "pictures": len(trial.samples),
    }


@operation
def world(desk: Desk, x_m: float, y_m: float = 0.0) -> Mapping[str, Any]:
    """Put the ball of the simulated room somewhere: so far ahead, and to the left."""
    room = setup_of(desk).camera.room
    if room is None:
        raise ConfigError("there is no simulated room before this camera; move the real thing")
    room.place(x_m, y_m)
    return room.where()


@operation
def wiring(desk: Desk, output: str) -> DeskReply:
    """Answer the circuit of an output such as ``buzzer 23`` as SVG, its notes, and the pins that it may be on."""
    outputs = find_outputs(_chosen_parts(desk, output))
    labels = header_labels(outputs[:-1])  # of the others
    pins = [
        {"number": number, "gpio": what, "taken_by": list(labels.get(number, ())), "warning": TAKEN.get(what, "")}
        for number, what in enumerate(HEADER, start=1)
        if isinstance(what, int)
    ]
    data = {"pins": pins, "notes": [note for each in outputs[-1:] for note in each.notes]}
    return DeskReply(data=data, attached=svg_of(circuits_picture(outputs[-1:])).encode())


@operation
def files(desk: Desk) -> dict[str, Any]:
    """Answer the files that Save would write, what `check` finds in them, and what their tests come to."""
    setup = setup_of(desk)
    if setup.interview.next_key:
        raise ConfigError("there are questions left")
    known = setup.interview.known
    others = recipe_steps.configuration_files(known.answers, known.lens, known.model_file)
    text = others.pop(CONFIGURATION)
    checked = editing.check(desk, text, others, tests=True)
    return {
        "files": [{"name": name, "text": each} for name, each in {desk.configuration.name: text, **others}.items()],
        "findings": checked["problems"],
        "words": checked["words"],
        "tests": checked["tests"],
    }


def _chosen_parts(desk: Desk, proposed: str) -> tuple[DriverChoice, ...]:
    """Return the wired parts by the answers, the proposed output last."""
    known = setup_of(desk).interview.known
    outputs = [each for each in recipe_steps.parts_of_answers(known.answers, "output").values() if each != proposed]
    pressed = recipe_steps.parts_of_answers(known.answers, "button").values()
    return tuple(
        known.choose(DRIVER_KINDS[section], (section, answer.split()[0]), part_table(answer))
        for section, answers in (("buttons", pressed), ("actuators", [*dict.fromkeys(outputs), proposed]))
        for answer in answers
        if answer and answer != SCREEN
    )
