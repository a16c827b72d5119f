"""The set-up, one form at a time: the interview of `stadimeter init` with a live picture beside it.

A picture takes less than a tenth of a second on a desktop computer. These take a second or more on a small Pi: to open
a camera (``camera``, and ``begin`` where answers are taken up again), a distance that calibrates, and ``colour``
with clicks or ``look``. Answers come in order, so no picture comes meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from stadimeter.app.exact_json import plain
from stadimeter.config.driver_tables import CAMERA, DRIVER_KINDS
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import HEADER, TAKEN
from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.colour_aids import NOTHING_STANDS_OUT, colour_picture
from stadimeter.workbench.frame_source import SETTLING_WAIT_S, source_beside_run
from stadimeter.workbench.picture_metadata import better_exposure_s
from stadimeter.workbench.printing import svg_of
from stadimeter.workbench.saving import check_is_not_ours
from stadimeter.workbench.server import editing
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.setup import colour_step, trying
from stadimeter.workbench.setup.camera_step import CameraStep, HeldCamera, table_of, with_exposure
from stadimeter.workbench.setup.colour_step import ColourTrial
from stadimeter.workbench.setup.files import configuration_files, parts_of_answers
from stadimeter.workbench.setup.interview import ANSWERS, Interview, load_answers, was_left
from stadimeter.workbench.setup.question import CONFIGURATION, Accepted, Known, Question, SetupStep
from stadimeter.workbench.setup.recipe_steps import BlankStep, RecipeStep, recipe_steps
from stadimeter.workbench.setup.recipes import SCREEN, part_table
from stadimeter.workbench.setup.target import KindStep, TargetStep, kind_steps
from stadimeter.workbench.wiring import circuits_picture, find_outputs, header_labels


class SetupDesk:
    """An interview that may be left and taken up again; its answers are in the folder of the configuration.

    Attributes:
        trial: The range of colours that is tried.
        shown: The picture that was shown last, which clicks are about; None before the first.
    """

    def __init__(self, configuration: Path, run_socket: Path | None = None) -> None:
        self.folder = configuration.parent
        self.camera = HeldCamera(partial(source_beside_run, configuration=configuration, socket=run_socket))
        self.trial = ColourTrial()
        self.shown: Frame | None = None
        self._configuration = configuration
        self._interview: Interview | None = None
        self._offered: DriverChoice | None = None
        self._doubt: tuple[str, ...] = ()
        self._notes: dict[str, tuple[str, ...]] = {}
        self._trouble = ""

    @property
    def interview(self) -> Interview:
        """The interview; a `ConfigError` before it has begun."""
        if self._interview is None:
            raise ConfigError("the set-up has not begun; begin it first")
        return self._interview

    @property
    def known(self) -> Known:
        """The facts known so far; a `ConfigError` before the set-up has begun."""
        return self.interview.known

    def state(self) -> Mapping[str, Any]:
        """Return the answers so far and the next question, as JSON has them."""
        interview = self._interview
        question = self._next_question(interview) if interview else None
        answers = interview.known.answers if interview else self._saved()
        return {
            "begun": interview is not None,
            "left": interview is None and was_left(self._file, self._configuration),
            "folder": str(self.folder),
            "answers": [
                {"key": key, "answer": answer, "notes": list(self._notes.get(key, ()))}
                for key, answer in answers.items()
            ],
            "question": _as_json(interview, question) if interview and question else None,
            "room": self.camera.room.where() if self.camera.room else None,
            "doubt": {"notes": list(self._doubt)} if self._doubt else None,
            "trouble": self._trouble,
            "done": interview is not None and question is None,
        }

    def begin(self, *, anew: bool) -> None:
        """Begin, or go on where it was left.

        Args:
            anew: Whether to ask everything again, with the answers of the last time ready.
        """
        check_is_not_ours(self._configuration)
        self.leave()
        saved = self._saved()
        known = Known(folder=self.folder, opening=self.camera.hold, looks_ahead=False)
        if anew or not was_left(self._file, self._configuration):
            self._interview = Interview(self.folder, earlier=saved, known=known)
            return
        self._interview = Interview(self.folder, known=known)
        for key, accepted in self._interview.resume(saved):
            self._notes[key] = accepted.notes

    def answer(self, text: str, *, confirm: bool) -> Accepted:
        """Answer the question; see `Interview.answer`."""
        key = self.interview.next_key
        accepted = self.interview.answer(text, confirm=confirm)
        self._moved_on()
        self._doubt = accepted.notes if accepted.doubt else ()
        if not accepted.doubt:
            self._notes[key] = accepted.notes
        return accepted

    def back(self) -> bool:
        """Take back the last answer; return whether there was one."""
        self._moved_on()
        return self.interview.back()

    def leave(self) -> None:
        """Close the camera, and keep the answers."""
        self.camera.close()
        self._moved_on()
        self._interview, self.shown = None, None
        self._notes.clear()
        self.trial.forget()

    def offer(self, text: str) -> DriverChoice:
        """Look through a camera that is not chosen yet; what an answer names.

        Raises:
            StadimeterError: There is no such camera, or it gives no picture.
        """
        if self.interview.next_key != CameraStep.key:
            raise ConfigError("the camera is chosen already; go back to that question to choose another")
        choice = self.known.choose(CAMERA, ("camera",), table_of(text))
        with self.camera.hold(choice) as source:
            self.shown = source.capture.latest(SETTLING_WAIT_S)
        self._offered = choice
        return choice

    def newest(self) -> Frame:
        """Return the picture that the camera sees now, or one of a recording.

        Raises:
            ConfigError: No camera has been chosen.
            DriverError: It gives no picture.
        """
        choice = self._offered or self.known.camera
        if choice is None:
            raise ConfigError("no camera has been chosen yet")
        if self._offered is None and not self.known.is_live:
            self.shown = self.known.frame
            return self.shown
        with self.camera.hold(choice) as source:
            self.shown = source.capture.latest(SETTLING_WAIT_S)
        return self.shown

    def _moved_on(self) -> None:
        self._offered, self._doubt, self._trouble = None, (), ""

    def _next_question(self, interview: Interview) -> Question | None:
        """Return the next question; where an earlier answer is of no use any more, that one is asked again."""
        while interview.next_key:
            try:
                return interview.question()
            except StadimeterError as error:
                self._trouble = str(error)
                if not interview.back():
                    raise
        return None

    def _saved(self) -> Mapping[str, str]:
        return load_answers(self._file) if self._file.exists() else {}

    @property
    def _file(self) -> Path:
        return self.folder / ANSWERS


# Questions whose options leave others open, which one form asks together with them.
_OPENED_BY: Mapping[str, Callable[[Mapping[str, str]], Iterable[SetupStep]]] = {
    TargetStep.key: kind_steps,
    RecipeStep.key: recipe_steps,
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
            if isinstance(step, KindStep | BlankStep):
                asked = step.question(chosen)
                ready = kept.get(step.key, asked.ready)
                blanks.append({**plain(asked), "key": step.key, "text": step.blank.text, "ready": ready})
        options.append({**option._asdict(), "blanks": blanks})
    return {**plain(question), "found": list(question.found), "options": options}


def setup_of(desk: Desk) -> SetupDesk:
    """Return the set-up of a workbench process."""
    if "setup" not in desk.kept:
        desk.kept["setup"] = made = SetupDesk(desk.configuration, desk.run_socket)
        desk.at_rest.append(made.camera.close)
    found: SetupDesk = desk.kept["setup"]
    return found


@operation
def state(desk: Desk) -> Mapping[str, Any]:
    """Answer the answers so far, and the question that is next."""
    return setup_of(desk).state()


@operation
def begin(desk: Desk, *, anew: bool = False) -> Mapping[str, Any]:
    """Begin, or go on where it was left."""
    setup = setup_of(desk)
    setup.begin(anew=anew)
    return setup.state()


@operation
def answer(desk: Desk, answer: str, question: str | None = None, *, confirm: bool = True) -> dict[str, Any]:
    """Answer the question; a doubtful answer is asked again, once, unless ``confirm`` is false.

    With ``question``, its key, no other question is answered: another device may have gone on.
    """
    setup = setup_of(desk)
    if question is not None and question != setup.interview.next_key:
        raise ConfigError("another question is asked now: the set-up went on, on another device")
    accepted = setup.answer(answer, confirm=confirm)
    return {**setup.state(), "notes": list(accepted.notes)}


@operation
def back(desk: Desk) -> Mapping[str, Any]:
    """Take back the last answer."""
    setup = setup_of(desk)
    if not setup.back():
        raise ConfigError("this is the first question")
    return setup.state()


@operation
def leave(desk: Desk, *, camera_only: bool = False) -> Mapping[str, Any]:
    """Close the camera, and keep the answers. With ``camera_only`` the set-up stays at its question."""
    setup = setup_of(desk)
    if camera_only:
        setup.camera.close()
    else:
        setup.leave()
    return setup.state()


@operation
def picture(desk: Desk, draw: str = "target", width_px: int = 0) -> DeskReply:
    """Answer what the camera sees now: figures, and a JPEG that may be smaller than they are about."""
    setup = setup_of(desk)
    if draw not in trying.DRAWINGS:
        raise ConfigError(f"draw is one of {', '.join(trying.DRAWINGS)}")
    frame = setup.newest()
    if draw == "mask" and setup.trial.colour:
        seen = colour_step.view_range(frame, setup.trial.colour)
        values = {**trying.describe_picture(frame, seen.detection, None), "words": colour_step.describe_view(seen)}
        values["range"] = setup.trial.figures(frame, seen)
        image = colour_picture(frame.image, seen, setup.trial.colour)
        return DeskReply(data=values, attached=trying.encode_jpeg(image, width_px))
    target = None if draw == "plain" else trying.target_so_far(setup.known, setup.trial.colour)
    if target is None:
        return DeskReply(
            data=trying.describe_picture(frame, None, None), attached=trying.encode_jpeg(frame.image, width_px)
        )
    found, measured = trying.look_for_target(setup.known, frame, target)
    image = trying.draw_findings(frame, found, measured)
    return DeskReply(data=trying.describe_picture(frame, found, measured), attached=trying.encode_jpeg(image, width_px))


@operation
def camera(desk: Desk, camera: str, exposure: str = "") -> dict[str, Any]:
    """Look through a camera that is offered; with ``exposure``, lock that at a time such as ``10 ms``.

    The answer to give, with that, is in the reply; ``picture`` shows what it sees.
    """
    setup = setup_of(desk)
    wanted = with_exposure(camera, exposure) if exposure else camera
    choice = setup.offer(wanted)
    frame = setup.newest()
    with setup.camera.hold(choice) as source:
        settings = source.capture.remarks()
    told = {
        "answer": wanted,
        "settings": [f"{each[0].upper()}{each[1:]}." for each in settings],
        "has_exposure": hasattr(choice.options, "exposure"),
        "is_locked": getattr(choice.options, "exposure", None) is not None,
        "proposed_exposure_s": better_exposure_s(frame.image, frame.exposure_s),
    }
    return {**trying.describe_picture(frame, None, None), **told}


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
        trial.forget()
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
        "centre_px": list(seen.detection.centre_px) if is_found else None,
        "width_px": seen.detection.width_px if is_found else None,
        "others": [{"centre_px": list(each.centre_px), "size_px": each.size_px} for each in seen.others],
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
    text, others = _as_text(setup.known, setup.known.answers)
    checked = editing.check(desk, text, others, tests=True)
    return {
        "files": [{"name": name, "text": each} for name, each in {desk.configuration.name: text, **others}.items()],
        "findings": checked["problems"],
        "words": checked["words"],
        "tests": checked["tests"],
        "base_version": editing.version_of(editing.saved_text(desk)),
    }


def _as_text(known: Known, answers: Mapping[str, str]) -> tuple[str, dict[str, str]]:
    """Return the configuration that answers come to, and the files beside it by their names."""
    made = configuration_files(answers, known.lens, known.model_file)
    return made.pop(CONFIGURATION), made


def _chosen_parts(desk: Desk, proposed: str) -> tuple[DriverChoice, ...]:
    """Return the wired parts by the answers, the proposed output last."""
    known = setup_of(desk).known
    outputs = [each for each in parts_of_answers(known.answers, "output").values() if each != proposed]
    pressed = parts_of_answers(known.answers, "button").values()
    return tuple(
        known.choose(DRIVER_KINDS[section], (section, answer.split()[0]), part_table(answer))
        for section, answers in (("buttons", pressed), ("actuators", [*dict.fromkeys(outputs), proposed]))
        for answer in answers
        if answer and answer != SCREEN
    )
