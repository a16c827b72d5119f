"""What the set-up asks about a kind of target: its detector says it, so that of another package is offered as well.

`AsksInSetup` is part of a detector's `DriverOptions`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

from msgspec import Struct

from stadimeter.config.units import split_spread

# What the kinds are listed below.
BY_NETWORK, SEVERAL = "Found by a neural network", "Several of one kind"


class SetupQuestion(Struct, frozen=True):
    """A question about a target.

    Attributes:
        key: The name of its answer; kinds share keys such as ``size``.
        keys: Returns the keys of the target's table that follow from an answer.
        ready: The answer that is taken if none is given; empty if there is none.
        form: How an answer may look.
        names: Sizes that have a name.
        sides: How many lengths a size has: 2 for width and height.
        tries: Answers that are tried on the picture. The first with which the target is found is ready, and behind it
            the number that the target bears.
        files: Of an answer that names a file, what such files are called, such as ``*.onnx``.
    """

    key: str
    text: str
    keys: Callable[[str], Mapping[str, Any]]
    ready: str
    form: str
    names: tuple[str, ...] = ()
    sides: int = 1
    tries: tuple[str, ...] = ()
    files: str = ""


class SetupKind(Struct, frozen=True):
    """A kind of target that people look for in a list.

    Attributes:
        name: What the answer, and the target in the configuration, are called.
        meaning: What it is, in some words.
        questions: What else is asked, in this order.
        thing: One of it, for sentences; empty for the name.
        group: What it is listed below; empty for nothing.
        rank: Where it stands in the list.
        learns_size: Whether the set-up can learn its size, by steps of the camera, where that is not known.
        has_colour: Whether a range of colours is asked for behind the questions: `ProposesColour` finds it.
        driver: The detector; the set-up fills it in.
    """

    name: str
    meaning: str
    questions: tuple[SetupQuestion, ...]
    thing: str = ""
    group: str = ""
    rank: int = 50
    learns_size: bool = False
    has_colour: bool = False
    driver: str = ""

    @property
    def one(self) -> str:
        """One of it, for sentences."""
        return self.thing or self.name


@runtime_checkable
class AsksInSetup(Protocol):
    """A detector whose targets the set-up offers."""

    @staticmethod
    def setup_kinds() -> tuple[SetupKind, ...]:
        """Return the kinds of target that it finds."""


def size_question(
    thing: str, keys: Callable[[str], Mapping[str, Any]], ready: str, form: str, names: tuple[str, ...] = ()
) -> SetupQuestion:
    """Return the question for a size, whose answer may say behind ± how well that is known."""

    def with_tolerance(text: str) -> Mapping[str, Any]:
        size, tolerance = split_spread(text)
        return {**keys(size), **({"tolerance": tolerance} if tolerance else {})}

    text = f"How large is the {thing}? The distances are as right as this is: measure it."
    return SetupQuestion("size", text, with_tolerance, ready, form, names)


def count_of(text: str) -> Mapping[str, Any]:
    """Return the key for how many there are at most."""
    return {"count": int(text) if text.isdecimal() else text}
