"""The questions of the set-up about balls. Their colour is found in pictures: `BallOptions.propose_colour`."""

from __future__ import annotations

from stadimeter.config.units import BALLS
from stadimeter.detectors.protocol import SEVERAL, SetupKind, SetupQuestion, count_of, size_question


def ball_kinds() -> tuple[SetupKind, ...]:
    """Return one ball, and several."""
    names = tuple(BALLS)
    form = f"its diameter, such as 6.4 cm, or a name: {', '.join(names)}"
    size = size_question("ball", lambda size: {"diameter": size}, "tennis ball", form, names)
    number = SetupQuestion("number", "How many are there at most?", count_of, "4", "a number, such as 4")
    several = "several balls of one colour and size, each with a distance of its own"
    return (
        SetupKind("ball", "a ball of one colour", (size,), rank=1, has_colour=True),
        SetupKind("balls", several, (size, number), thing="ball", group=SEVERAL, rank=30, has_colour=True),
    )
