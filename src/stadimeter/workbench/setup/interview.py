"""The interview: the next question, checking an answer, and the answers that are kept."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.errors import ConfigError, Problem, StadimeterError
from stadimeter.workbench.setup.answers import ANSWERS, relative_to_setup, save_answers
from stadimeter.workbench.setup.calibration_steps import CalibrationStep, ProofStep
from stadimeter.workbench.setup.camera_step import CameraStep
from stadimeter.workbench.setup.colour_step import ColourStep
from stadimeter.workbench.setup.question import Accepted, Known, Question, SetupStep
from stadimeter.workbench.setup.target import SizeStep, TagStep, TargetStep
from stadimeter.workbench.setup.wish_steps import (
    BaseStep,
    BrokerStep,
    SecondTargetStep,
    WheelsStep,
    WishOutputStep,
    WishStep,
    wish_steps,
)
from stadimeter.workbench.setup.wishes import WISHES

# After another answer to one of these, later answers of an earlier interview mean nothing.
_CHANGES_ALL = frozenset({CameraStep.key, TargetStep.key})


class Interview:
    """Asks one question after the other. Each answer is saved as soon as it is accepted.

    Args:
        folder: Where the files will be.
        earlier: Answers of an earlier interview, which are ready in this one.
        known: What it knows, with another way to open cameras; None for nothing yet.

    Raises:
        ConfigError: The folder cannot be made.
    """

    def __init__(self, folder: Path, earlier: Mapping[str, str] | None = None, known: Known | None = None) -> None:
        self.known = known or Known(folder=folder)
        self.known.make_folder()
        self._earlier = dict(earlier or {})
        self._first: tuple[SetupStep, ...] = (
            CameraStep(), TargetStep(), SizeStep(), TagStep(), ColourStep(), CalibrationStep(), ProofStep(), WishStep(),
        )  # fmt: skip
        self._doubted: dict[str, str] = {}

    @property
    def path(self) -> Path:
        """The file that keeps the answers."""
        return self.known.folder / ANSWERS

    @property
    def next_key(self) -> str:
        """The key of the next question; empty when everything is answered."""
        step = self._next()
        return step.key if step else ""

    def question(self) -> Question | None:
        """Return the next question; None when everything is answered.

        Raises:
            StadimeterError: An earlier answer is of no use any more.
        """
        step = self._next()
        if step is None:
            return None
        asked = step.question(self.known)
        ready = self._doubted.get(step.key) or self._earlier.get(step.key) or asked.ready
        return replace(asked, ready=ready, kind=step.kind)

    def answer(self, text: str, *, confirm: bool = True) -> Accepted:
        """Answer the next question.

        Args:
            confirm: Whether a doubtful answer is asked again, once, with its notes.

        Raises:
            StadimeterError: The answer cannot be used; the question stays.
        """
        accepted = self._accepted(text, confirm=confirm)
        if not accepted.doubt:
            try:
                save_answers(self.path, self.known.answers)
            except ConfigError:
                self.known.answers.popitem()
                raise
        return accepted

    def _accepted(self, text: str, *, confirm: bool) -> Accepted:
        step = self._next()
        if step is None:
            raise ConfigError("there is no question left")
        given = text.strip()
        if not given:
            raise ConfigError("nothing is chosen yet: choose an answer, or write one")
        accepted = step.accept(self.known, relative_to_setup(self.known.folder, given) if step.names_files else given)
        if confirm and accepted.doubt and self._doubted.get(step.key) != accepted.answer:
            self._doubted[step.key] = accepted.answer
            return accepted
        if step.key in _CHANGES_ALL and self._earlier.get(step.key) != accepted.answer:
            self._earlier.clear()  # the size of a ball is none of a sheet
        self.known.answers[step.key] = accepted.answer
        return replace(accepted, doubt=False)

    def resume(self, saved: Mapping[str, str]) -> Iterator[tuple[str, Accepted]]:
        """Give saved answers again, as far as they reach and are of use; yield each with what came of it.

        The file stays as it is: it has the later ones too, if this ends half way.
        """
        while (step := self._next()) is not None and step.key in saved:
            try:
                yield step.key, self._accepted(saved[step.key], confirm=False)
            except StadimeterError:
                self._earlier = {**self._earlier, **saved}
                return

    def back(self) -> bool:
        """Take back the last answer; return whether there was one."""
        if not self.known.answers:
            return False
        key, answer = self.known.answers.popitem()
        self._earlier[key] = answer
        self._doubted.pop(key, None)
        save_answers(self.path, self.known.answers)
        return True

    def _next(self) -> SetupStep | None:
        steps = (*self._first, *wish_steps(self.known.answers))
        return next((each for each in steps if each.key not in self.known.answers and each.is_asked(self.known)), None)


def answer_keys() -> tuple[str, ...]:
    """Return the key of every question that may be asked."""
    others = (CameraStep, TargetStep, SizeStep, TagStep, ColourStep, CalibrationStep, ProofStep, WishStep)
    more = (SecondTargetStep, BaseStep, WheelsStep, BrokerStep)
    blanks = (f"{wish.key}_{blank.key}" for wish in WISHES for blank in wish.blanks)
    outputs = (WishOutputStep(wish).key for wish in WISHES if wish.output not in {"base", "mqtt"})
    return (*(step.key for step in (*others, *more)), *blanks, *outputs)


def check_keys(answers: Mapping[str, str], file: str) -> None:
    """Raise a `ConfigError` for answers to questions that do not exist."""
    known = answer_keys()
    unknown = [key for key in answers if key not in known]
    if unknown:
        raise ConfigError(
            Problem("there is no such question", file, key=key, hint=did_you_mean_or_list(key, known))
            for key in unknown
        )


def all_answered(interview: Interview, given: Mapping[str, str], file: str) -> Iterator[tuple[str, Accepted]]:
    """Answer every question from a file, or with the ready answer; yield each with what came of it.

    Raises:
        ConfigError: A question has no answer, or one that cannot be used; it is named.
        StadimeterError: As the steps.
    """
    while key := interview.next_key:
        try:
            text, found = (given[key], ()) if given.get(key) else _ready(interview)
            accepted = interview.answer(text, confirm=False)
            yield key, replace(accepted, notes=(*found, *accepted.notes))
        except ConfigError as error:
            raise ConfigError(replace(each, file=file, key=key) for each in error.problems) from error
        except StadimeterError as error:
            raise ConfigError([Problem(str(error), file, key=key)]) from error


def _ready(interview: Interview) -> tuple[str, tuple[str, ...]]:
    """Return the ready answer to the next question, and what was found for it."""
    question = interview.question()
    if question is not None and question.unattended:
        return question.unattended, question.found
    if question is None or not question.ready:
        raise ConfigError(" ".join(("this needs an answer:", *(question.found if question else ()))))
    return question.ready, question.found
