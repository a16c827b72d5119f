"""What the set-up asks about balls. Their colour is found in pictures: `BallOptions.propose_colour`."""

from __future__ import annotations

from msgspec.structs import replace

from stadimeter.config.named_sizes import BALLS
from stadimeter.detectors.setup_kinds import SEVERAL, SetupKind, SetupQuestion, count_of, size_question


def ball_kinds() -> tuple[SetupKind, ...]:
    """Return one ball, and several."""
    form = f"its diameter, such as 6.4 cm, or a name: {', '.join(BALLS)}"
    size = size_question(lambda size: {"diameter": size}, "tennis ball", form, thing="the ball", names=tuple(BALLS))
    number = SetupQuestion(
        key="number",
        text="How many balls are there at most?",
        keys=count_of,
        ready="4",
        form="a number, such as 4",
        after="colour",  # several are known by their colour
    )
    ball = SetupKind(name="ball", meaning="a ball of one colour", questions=(size,), rank=1, learns_size=True)
    several = (replace(size, text=size.text.replace("the ball", "each ball")), number)
    return (
        ball,
        SetupKind(
            name="balls",
            meaning="several balls of one colour and size, each with a distance of its own",
            questions=several,
            thing="ball",
            group=SEVERAL,
            rank=30,
        ),
    )
