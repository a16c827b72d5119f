"""Balls by name."""

from __future__ import annotations

import pytest

from stadimeter.config.ball_sizes import BALLS, parse_ball_diameter
from stadimeter.config.plugins import DETECTORS, load_driver
from stadimeter.config.units import parse_length


@pytest.mark.parametrize(
    ("written", "diameter_m"),
    [("tennis ball", 0.067), ("Tennis-Ball", 0.067), ("ping pong ball", 0.04), ("6.4 cm", 0.064), ("24in", 0.6096)],
)
def test_a_diameter_is_a_length_or_the_name_of_a_ball(written: str, diameter_m: float) -> None:
    assert parse_ball_diameter(written) == pytest.approx(diameter_m)
    options = load_driver(DETECTORS, "ball").model_validate({"diameter": written, "hsv": "29,86,6:64,255,255"})
    assert options.diameter == pytest.approx(diameter_m)


@pytest.mark.parametrize(
    ("written", "words"),
    [("tenis ball", "did you mean 'tennis ball'"), ("moon", "Known names: table tennis ball"), (6.4, "has no unit")],
)
def test_what_is_neither_is_refused_with_a_suggestion(written: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_ball_diameter(written)


def test_every_named_ball_is_between_a_marble_and_a_beach_ball() -> None:
    assert all(0.03 < parse_length(size) < 0.4 for size in BALLS.values())
