"""The setup's knowledge so far, and the protocol of its questions: from an answer to what is accepted."""

from __future__ import annotations

import shlex
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, cast

from msgspec import Struct, field

from stadimeter.config.driver_tables import DriverKind, read_driver_table
from stadimeter.config.findings import Finding
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import path_from, validation_context
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError, Problem, reason_of
from stadimeter.workbench.frame_source import Opening, open_camera

# The folder for the pictures that show what was found.
CONFIGURATION = "stadimeter.toml"
CAMERA_FILE = "camera.toml"
PICTURES = "init"


class Known(Struct, kw_only=True):
    """The facts known so far.

    Attributes:
        folder: Where the files will be; relative paths in answers are relative to it.
        answers: The answers by key, in the order in which they were given.
        camera: The camera that was chosen.
        is_live: Whether it shows what is before it now, rather than a recording.
        frames: Pictures of it: one of a live camera, a few from all over a recording. The first is shown to people.
        camera_model: The lens; None before the calibration.
        reach_m: From where on to where the target is seen through the lens, see `reach_m`; None for not known.
        model_file: The camera file that was there already; empty where one has to be written.
        opening: Opens the camera for a look through it.
        looks_ahead: Whether a question finds out by itself what takes seconds to find: what each camera sees, and what
            stands out in the picture. A face with pictures asks for that when it is wanted.
    """

    folder: Path
    answers: dict[str, str] = field(default_factory=dict)
    camera: DriverChoice | None = None
    is_live: bool = False
    frames: tuple[Frame, ...] = ()
    camera_model: CameraModel | None = None
    reach_m: tuple[float, float] | None = None
    model_file: str = ""
    opening: Opening = open_camera
    looks_ahead: bool = True

    @property
    def frame(self) -> Frame:
        """The picture that is shown to people."""
        return self.frames[0]

    @property
    def lens(self) -> CameraModel:
        """The lens; a `ConfigError` before the calibration."""
        if self.camera_model is None:
            raise ConfigError("the camera is not calibrated yet")
        return self.camera_model

    def shown_in(self, name: str) -> str:
        """Return the sentence that names a picture of what was found; empty for a face that shows it anyway."""
        return f" {name} shows it." if self.looks_ahead else ""

    @property
    def file(self) -> Path:
        """The configuration that will be written."""
        return self.folder / CONFIGURATION

    def path(self, name: str) -> Path:
        """Return the path of a file that an answer names."""
        return path_from(self.folder, name)

    def relative(self, file: str | Path) -> str:
        """Return the name that answers have for a file: its path from the folder, if it is in it."""
        path = Path(file)
        return str(path.relative_to(self.folder) if path.is_relative_to(self.folder) else path)

    def make_folder(self) -> None:
        """Make the folder, and the one for pictures in it; a `ConfigError` says why that cannot be."""
        try:
            (self.folder / PICTURES).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                [Problem(f"the folder cannot be made: {reason_of(error)}", str(self.folder / PICTURES))]
            ) from error

    def choose(self, kind: DriverKind, at: tuple[str, ...], table: dict[str, Any]) -> DriverChoice:
        """Return the driver of a table as the configuration will hold it.

        Raises:
            ConfigError: It says everything that is wrong; where it stands is nothing that a person has written.
        """
        return cast(DriverChoice, self.check(kind, at, table))

    def check(
        self, kind: DriverKind, at: tuple[str, ...], table: dict[str, Any], keys: Iterable[str] | None = None
    ) -> DriverChoice | None:
        """Return the driver of a table that may not be complete; None if it is not.

        Args:
            keys: Of these what is wrong counts; None for all that is wrong.

        Raises:
            ConfigError: As `choose`.
        """
        findings: list[Finding] = []
        choice, _ = read_driver_table(kind, at, table, validation_context(self.file), findings)
        wrong = [each for each in findings if keys is None or {*each.path[len(at) :]} & {*keys}]
        if wrong:
            raise ConfigError(Problem(each.message, hint=each.hint) for each in wrong)
        return None if findings else choice


def words_of(text: str) -> list[str]:
    """Return the words of an answer; what has a space stands in quotation marks.

    Raises:
        ConfigError: A quotation mark is missing.
    """
    try:
        return shlex.split(text)
    except ValueError as error:
        raise ConfigError(f"{text!r} lacks a quotation mark") from error


class Option(NamedTuple):
    """An answer that is suggested, and what it means. In place of the answer, its number may be given.

    Attributes:
        group: What it is listed below; empty for nothing.
        picture: A drawing of it, see `Recipe`; empty for none.
    """

    answer: str
    meaning: str
    group: str = ""
    picture: str = ""


class Question(Struct, frozen=True, kw_only=True):
    """The next question.

    Attributes:
        key: The name of the answer in a file of answers; `Interview` fills it in, and the kind.
        found: What was found out before it was asked, a sentence each.
        ready: The answer that is taken if none is given; empty if there is none.
        form: How an answer may look, for people who want another one.
        is_sure: Whether the ready answer was found and nothing else can be meant: it is shown, and asked only once it
            is taken back.
        unattended: The answer that is taken where no person is there to put the target somewhere; empty for `ready`.
        kind: What it asks for, for faces that show more than text: ``camera``, ``target``, ``size``, ``thing`` (what
            else a kind of target needs), ``colour``, ``calibration``, ``recipe``, ``blank``,
            ``output``, ``base`` or ``broker``.
        names: Sizes that have a name, of a `size`.
    """

    text: str
    key: str = ""
    found: tuple[str, ...] = ()
    options: tuple[Option, ...] = ()
    ready: str = ""
    form: str = ""
    is_sure: bool = False
    unattended: str = ""
    kind: str = ""
    names: tuple[str, ...] = ()


class Accepted(Struct, frozen=True, kw_only=True):
    """An answer that can be used.

    Attributes:
        answer: The answer as it is kept; answered again later, it means the same.
        notes: What follows from it, a sentence each.
        doubt: Whether a person should see the notes and answer once more, with this as the ready answer.
    """

    answer: str
    notes: tuple[str, ...] = ()
    doubt: bool = False


class SetupStep(ABC):
    """One question, which depends on earlier answers.

    Attributes:
        key: The name of the answer.
        kind: What it asks for, see `Question.kind`; empty for the key.
        names_files: Whether answers may name files.
        asked: The question, where it depends on nothing.
    """

    key: str
    kind = ""
    names_files = False
    asked: Question

    def is_asked(self, known: Known) -> bool:  # noqa: ARG002 - most are
        """Check whether earlier answers leave this open."""
        return True

    def question(self, known: Known) -> Question:  # noqa: ARG002 - most look at earlier answers
        """Find out what can be found out, and return what to ask.

        Raises:
            StadimeterError: An earlier answer is of no use any more, such as a camera that was unplugged.
        """
        return self.asked

    @abstractmethod
    def accept(self, known: Known, text: str) -> Accepted:
        """Check an answer, and remember what follows from it.

        Raises:
            StadimeterError: It cannot be used; nothing has changed.
        """
