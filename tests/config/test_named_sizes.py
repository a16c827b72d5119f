"""Sheets and balls by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import DETECTORS, load_driver
from stadimeter.config.units import BALLS, PAPER, paper_sides, parse_ball_diameter, parse_length
from stadimeter.errors import ConfigError
from support.each_case import each_case

CONFIGURATION = """
[camera]
driver = "opencv"
device = 0
model = {{ width_px = 640, height_px = 480, fx_px = 600.0, fy_px = 600.0, cx_px = 319.5, cy_px = 239.5 }}

[targets.paper]
detector = "sheet"
{size}
"""


def configured(tmp_path: Path, size: str) -> Path:
    file = tmp_path / "stadimeter.toml"
    file.write_text(CONFIGURATION.format(size=size))
    return file


@each_case("name", [*PAPER, "a4", " Us Letter", "BUSINESS_CARD"])
def test_a_name_in_any_case_gives_both_sides(name: str) -> None:
    width_m, height_m = map(parse_length, paper_sides(name))
    assert 0.03 < min(width_m, height_m) < max(width_m, height_m) < 1


def test_a_configuration_may_name_the_size(tmp_path: Path) -> None:
    (target,) = load_configuration(configured(tmp_path, 'size = "A4"')).targets
    assert (target.options.width, target.options.height) == pytest.approx((0.21, 0.297))


@pytest.mark.parametrize(
    ("size", "said"),
    [
        ('size = "A44"', "'A44' is no sheet with a name; did you mean 'A4'"),
        ("size = 4", "4 is no sheet with a name"),
        ('size = "A4"\nwidth = "3 cm"', "size = 'A4' gives both sides; leave out width and height"),
        ('width = "3 cm"', "'height' is missing"),
    ],
)
def test_a_wrong_size_is_one_error_that_says_what_to_write(tmp_path: Path, size: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_configuration(configured(tmp_path, size))
    (problem,) = caught.value.problems
    assert said in problem.message


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
