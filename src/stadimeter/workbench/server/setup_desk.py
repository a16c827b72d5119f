"""The set-up of one workbench process: the interview, and the camera that stays open beside it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from stadimeter.app.exact_json import plain
from stadimeter.config.driver_tables import CAMERA
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.frame_source import SETTLING_WAIT_S, source_beside_run
from stadimeter.workbench.saving import check_is_not_ours
from stadimeter.workbench.setup.camera_step import CameraStep, HeldCamera, table_of
from stadimeter.workbench.setup.colour_step import ColourTrial
from stadimeter.workbench.setup.interview import ANSWERS, Interview, load_answers, was_left
from stadimeter.workbench.setup.question import Accepted, Known, Question


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
        self._question: Question | None = None
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
            "question": _as_json(question) if question else None,
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
        self._question, self._offered, self._doubt, self._trouble = None, None, (), ""

    def _next_question(self, interview: Interview) -> Question | None:
        """Return the next question; where an earlier answer is of no use any more, that one is asked again."""
        while self._question is None and interview.next_key:
            try:
                self._question = interview.question()
            except StadimeterError as error:
                self._trouble = str(error)
                if not interview.back():
                    raise
        return self._question

    def _saved(self) -> Mapping[str, str]:
        return load_answers(self._file) if self._file.exists() else {}

    @property
    def _file(self) -> Path:
        return self.folder / ANSWERS


def _as_json(question: Question) -> dict[str, Any]:
    options = [each._asdict() for each in question.options]
    return {**plain(question), "found": list(question.found), "options": options}
