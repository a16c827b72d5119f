"""A question of the setup, and what becomes of an answer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from stadimeter.workbench.setup.known import Known


class Option(NamedTuple):
    """An answer that is suggested, and what it means. In place of the answer, its number may be given."""

    answer: str
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What is asked next.

    Attributes:
        key: The name of the answer in a file of answers.
        found: What was found out before it was asked, a sentence each.
        ready: The answer that is taken if none is given; empty if there is none.
        form: How an answer may look, for people who want another one.
        unattended: The answer that is taken where no person is there to put the target somewhere; empty for `ready`.
        kind: What it asks for, for faces that show more than text: ``camera``, ``target``, ``size``, ``tag``,
            ``colour``, ``calibration``, ``proof``, ``wish``, ``blank``, ``output``, ``base`` or ``broker``.
        names: Sizes that have a name, of a `size`.
        sentence: The wish that a blank is of, with each of its blanks in braces.
        blanks: The blanks of that sentence: ``key``, ``text`` and the ``ready`` answer.
    """

    key: str
    text: str
    found: tuple[str, ...] = ()
    options: tuple[Option, ...] = ()
    ready: str = ""
    form: str = ""
    unattended: str = ""
    kind: str = ""
    names: tuple[str, ...] = ()
    sentence: str = ""
    blanks: tuple[Mapping[str, str], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Accepted:
    """An answer that can be used.

    Attributes:
        answer: The answer as it is kept; answered again later, it means the same.
        notes: What follows from it, a sentence each.
        doubt: Whether a person should see the notes and answer once more, with this as the ready answer.
    """

    answer: str
    notes: tuple[str, ...] = ()
    doubt: bool = False


class Step(ABC):
    """One question, which depends on earlier answers.

    Attributes:
        key: The name of the answer.
        names_files: Whether answers may name files.
    """

    key: str
    names_files = False

    @property
    def kind(self) -> str:
        """What it asks for; see `Question.kind`."""
        return self.key

    def is_asked(self, known: Known) -> bool:  # noqa: ARG002 - most are
        """Return whether earlier answers leave this open."""
        return True

    @abstractmethod
    def question(self, known: Known) -> Question:
        """Find out what can be found out, and return what to ask.

        Raises:
            StadimeterError: An earlier answer is of no use any more, such as a camera that was unplugged.
        """

    @abstractmethod
    def accept(self, known: Known, text: str) -> Accepted:
        """Check an answer, and remember what follows from it.

        Raises:
            StadimeterError: It cannot be used; nothing has changed.
        """
