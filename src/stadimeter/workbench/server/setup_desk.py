"""The set-up of one workbench process: the interview, and the camera that stays open beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.frame_source import SETTLING_WAIT_S
from stadimeter.workbench.setup.answers import ANSWERS, load_answers
from stadimeter.workbench.setup.held_camera import HeldCamera
from stadimeter.workbench.setup.interview import Interview
from stadimeter.workbench.setup.known import Known
from stadimeter.workbench.setup.preview import DRAWINGS, drawn, jpeg_of, looked_at, target_so_far, values_of
from stadimeter.workbench.setup.question import Accepted, Question
from stadimeter.workbench.setup.writing import was_left


class SetupDesk:
    """An interview that may be left and taken up again; its answers are in the folder of the configuration."""

    def __init__(self, configuration: Path) -> None:
        self._configuration = configuration
        self._camera = HeldCamera()
        self._interview: Interview | None = None
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

    def state(self) -> Mapping[str, Any]:
        """Return the answers so far and the next question, as JSON has them."""
        answers_file = self._folder / ANSWERS
        interview = self._interview
        if interview is None:
            saved = load_answers(answers_file) if answers_file.exists() else {}
            answers, question = saved, None
        else:
            question = self._asked(interview)
            answers = interview.known.answers
        return {
            "begun": interview is not None,
            "left": interview is None and was_left(answers_file, self._configuration),
            "folder": str(self._folder),
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
        self.leave()
        file = self._folder / ANSWERS
        saved = load_answers(file) if file.exists() else {}
        known = Known(folder=self._folder, opening=self._camera.opened, is_each_tried=False)
        if anew or not was_left(file, self._configuration):
            self._interview = Interview(self._folder, earlier=saved, known=known)
            return
        self._interview = Interview(self._folder, known=known)
        for key, accepted in self._interview.resume(saved):
            self._notes[key] = accepted.notes

    def answer(self, text: str, *, confirm: bool) -> list[str]:
        """Answer the question, and return what follows from it, a sentence each."""
        key = self.interview.next_key
        accepted: Accepted = self.interview.answer(text, confirm=confirm)
        self._question, self._trouble = None, ""
        self._doubt = accepted.notes if accepted.doubt else ()
        if not accepted.doubt:
            self._notes[key] = accepted.notes
        return list(accepted.notes)

    def back(self) -> bool:
        """Take back the last answer; return whether there was one."""
        self._question, self._doubt, self._trouble = None, (), ""
        return self.interview.back()

    def leave(self) -> None:
        """Close the camera, and keep the answers."""
        self.close_camera()
        self._interview, self._question, self._doubt, self._trouble = None, None, (), ""
        self._notes.clear()

    def close_camera(self) -> None:
        """Let the camera go; the next look opens it again."""
        self._camera.close()

    def picture(self, draw: str, width_px: int) -> tuple[Mapping[str, Any], bytes]:
        """Return what the camera sees now: figures, and a JPEG of it.

        Raises:
            ConfigError: No camera has been chosen.
            DriverError: It gives no picture.
        """
        if draw not in DRAWINGS:
            raise ConfigError(f"draw is one of {', '.join(DRAWINGS)}")
        known, frame = self.interview.known, self._newest()
        target = None if draw == "plain" else target_so_far(known)
        if target is None:
            return values_of(frame, None, None), jpeg_of(frame.image, width_px)
        seen, measured = looked_at(known, frame, target)
        image = drawn(frame, seen, measured, with_candidates=draw == "candidates")
        return values_of(frame, seen, measured), jpeg_of(image, width_px)

    def _newest(self) -> Frame:
        known = self.interview.known
        if known.camera is None:
            raise ConfigError("no camera has been chosen yet")
        if not known.is_live:
            return known.frame
        with self._camera.opened(known.camera) as source:
            return source.capture.latest(SETTLING_WAIT_S)

    def _asked(self, interview: Interview) -> Question | None:
        """Return the next question; where an earlier answer is of no use any more, that one is asked again."""
        while self._question is None and interview.next_key:
            try:
                self._question = interview.question()
            except StadimeterError as error:
                self._trouble = str(error)
                if not interview.back():
                    raise
        return self._question

    @property
    def _folder(self) -> Path:
        return self._configuration.parent


def _as_json(question: Question) -> dict[str, Any]:
    options = [each._asdict() for each in question.options]
    return {**asdict(question), "found": list(question.found), "options": options}
