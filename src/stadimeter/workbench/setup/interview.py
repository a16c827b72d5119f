"""The interview: the next question, checking an answer, the answers that are kept, and the files that it writes."""

from __future__ import annotations

import glob
import os
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path

from msgspec.structs import replace

import stadimeter
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, write_atomically
from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.config.toml_source import as_toml, read_toml
from stadimeter.errors import ConfigError, Problem, StadimeterError, reason_of
from stadimeter.workbench.saving import save_files
from stadimeter.workbench.setup.calibration_steps import CalibrationStep
from stadimeter.workbench.setup.camera_step import CameraStep
from stadimeter.workbench.setup.colour_step import ColourStep
from stadimeter.workbench.setup.question import Accepted, Known, Question, SetupStep, words_of
from stadimeter.workbench.setup.recipe_steps import RecipeStep, base_drivers, recipe_steps
from stadimeter.workbench.setup.recipes import load_recipes
from stadimeter.workbench.setup.target import TargetStep, kind_steps, offered_kinds

# The questions that come first, whatever the answers; behind the first two stand those of the kind of target.
FIRST_STEPS: tuple[SetupStep, ...] = (
    CameraStep(), TargetStep(), ColourStep(), CalibrationStep(), RecipeStep(),
)  # fmt: skip

# After another answer to one of these, later answers of an earlier interview mean nothing.
_CHANGES_ALL = frozenset({CameraStep.key, TargetStep.key})


class Interview:
    """Asks one question after the other. Each answer is saved as soon as it is accepted.

    Attributes:
        known: What it knows.
        earlier: Answers of an earlier interview, or that were taken back; they are ready in this one.

    Args:
        folder: Where the files will be.
        known: What it knows, with another way to open cameras; None for nothing yet.

    Raises:
        ConfigError: The folder cannot be made.
    """

    def __init__(self, folder: Path, earlier: Mapping[str, str] | None = None, known: Known | None = None) -> None:
        self.known = known or Known(folder=folder)
        self.known.make_folder()
        self.earlier = dict(earlier or {})
        self._doubted: dict[str, str] = {}
        self._asked: dict[str, Question] = {}

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
        if step.key not in self._asked:  # finding out what to ask may take seconds
            self._asked = {step.key: step.question(self.known)}
        asked = self._asked[step.key]
        ready = self._doubted.get(step.key) or self.earlier.get(step.key) or asked.ready
        is_sure = asked.is_sure and step.key not in {*self._doubted, *self.earlier}
        return replace(asked, key=step.key, ready=ready, kind=step.kind or step.key, is_sure=is_sure)

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
        if step.key in _CHANGES_ALL and self.earlier.get(step.key) != accepted.answer:
            self.earlier.clear()  # the size of a ball is none of a sheet
        self.known.answers[step.key] = accepted.answer
        self._asked.clear()
        return replace(accepted, doubt=False)

    def resume(self, saved: Mapping[str, str]) -> Iterator[tuple[str, Accepted]]:
        """Give saved answers again, as far as they reach and are of use; yield each with what came of it.

        The file stays as it is: it has the later ones too, if this ends half way.
        """
        while (step := self._next()) is not None and step.key in saved:
            try:
                yield step.key, self._accepted(saved[step.key], confirm=False)
            except StadimeterError:
                self.earlier = {**self.earlier, **saved}
                return

    def back(self) -> bool:
        """Take back the last answer; return whether there was one."""
        if not self.known.answers:
            return False
        key, answer = self.known.answers.popitem()
        self.earlier[key] = answer
        self._doubted.pop(key, None)
        self._asked.clear()
        save_answers(self.path, self.known.answers)
        return True

    def _next(self) -> SetupStep | None:
        answers = self.known.answers
        steps = (*FIRST_STEPS[:2], *kind_steps(answers), *FIRST_STEPS[2:], *recipe_steps(answers))
        return next((each for each in steps if each.key not in self.known.answers and each.is_asked(self.known)), None)


def answer_keys() -> tuple[str, ...]:
    """Return the key of every question that may be asked."""
    recipes = " ".join(load_recipes())
    steps = [step for base in base_drivers() for step in recipe_steps({"recipe": recipes, "base": base})]
    of_kinds = [step for kind in offered_kinds() for step in kind_steps({"target": kind})]
    return tuple(dict.fromkeys(step.key for step in (*FIRST_STEPS, *of_kinds, *steps)))


def check_keys(answers: Mapping[str, str], file: str) -> None:
    """Raise a `ConfigError` for answers to questions that do not exist."""
    known = answer_keys()
    unknown = [key for key in answers if key not in known]
    if unknown:
        raise ConfigError(
            Problem("there is no such question", file, key=key, hint=did_you_mean_or_list(key, known))
            for key in unknown
        )


def answer_all(interview: Interview, given: Mapping[str, str], file: str) -> Iterator[tuple[str, Accepted]]:
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
    question = interview.question() or Question(text="")
    if answer := question.unattended or question.ready:
        return answer, question.found
    raise ConfigError(" ".join(("this needs an answer:", *question.found)))


# The file in the folder in which answers are kept.
ANSWERS = "init-answers.toml"

_ANSWERS_TITLE = "# Answers to the questions of `stadimeter init`. `stadimeter init --answers FILE` gives them again.\n"


def save_answers(path: Path, answers: Mapping[str, str]) -> None:
    """Write the answers, or leave what was there.

    Raises:
        ConfigError: They cannot be written there.
    """
    lines = "".join(f"{key} = {as_toml(answer)}\n" for key, answer in answers.items())
    try:
        write_atomically(path, (_ANSWERS_TITLE + lines).encode())
    except OSError as error:
        raise ConfigError([Problem(f"the answers cannot be written: {reason_of(error)}", str(path))]) from error


def load_answers(path: Path) -> dict[str, str]:
    """Read answers. A number counts as text, and a list as one answer that holds several things.

    Raises:
        ConfigError: It is no TOML file, or a value is something else; with the line.
    """
    source = read_toml(path, CONFIGURATION_MAX_BYTES)
    answers = {key: _answer(value) for key, value in source.table.items()}
    wrong = [key for key, answer in answers.items() if answer is None]
    if wrong:
        hint = 'write it such as size = "6.4 cm"'
        raise ConfigError(
            Problem("an answer is text, a number, or a list of these", str(path), source.spans[(key,)].line, key, hint)
            for key in wrong
        )
    return {key: answer for key, answer in answers.items() if answer is not None}


def _answer(value: object) -> str | None:
    if isinstance(value, list):
        parts = [_answer(each) for each in value]
        return None if None in parts else shlex.join(part for part in parts if part is not None)
    return str(value) if isinstance(value, str | int | float) and not isinstance(value, bool) else None


def relative_to_setup(folder: Path, text: str) -> str:
    """Return an answer in which files of the current folder are named as the folder of the setup sees them.

    Files are looked for in the folder of the setup first. What is no file in either stays as it is.

    Raises:
        ConfigError: A quotation mark is missing.
    """
    words = words_of(text)
    moved = [_relative_word(folder, word) for word in words]
    return text if moved == words else shlex.join(moved)


def _relative_word(folder: Path, word: str) -> str:
    name, at, rest = word.partition("@")  # what follows is a place or a distance
    is_here_only = bool(glob.glob(name)) and not glob.glob(str(folder / name))  # noqa: PTH207 - Path's are relative
    if not is_here_only:
        return word
    return os.path.relpath(name, folder) + at + rest


def write_files(folder: Path, files: Mapping[str, str]) -> Iterator[str]:
    """Write files; yield a sentence for each. One that would stay the same is left alone.

    Raises:
        ConfigError: A file cannot be written there; then none is.
    """
    written, kept = save_files(folder, files)
    for name in files:
        path = folder / name
        if name not in written:
            path.touch()  # newer than the answers, as `was_left` wants it
            yield f"{path} is as it was"
        else:
            was_there = kept is not None and (kept / name).exists()
            yield f"wrote {path}{f'; the one that was there is {kept / name} now' if kept and was_there else ''}"


def was_left(answers: Path, configuration: Path) -> bool:
    """Check whether an interview was left before its end: its answers are newer than what came of the last one."""
    answered_ns, written_ns = (each.stat().st_mtime_ns if each.exists() else 0 for each in (answers, configuration))
    return answered_ns > written_ns


def load_example(name: str) -> str:
    """Return an example configuration that comes with the program.

    Raises:
        ConfigError: There is none of that name; it lists them.
    """
    folder = Path(stadimeter.__file__).parent / "configurations"
    texts = {path.stem: path for path in sorted(folder.glob("*.toml"))}
    if name not in texts:
        raise ConfigError([Problem(f"there is no example {name!r}, only {', '.join(texts)}", key="--example")])
    return texts[name].read_text(encoding="utf-8")
