"""The options that say what to look for."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from stadimeter.app.detectors import build_detectors
from stadimeter.cli.formatting import CENTIMETRE, FOOT, INCH, METRE
from stadimeter.cli.target_options import targets_from_options
from stadimeter.errors import ConfigError

HSV = "29,86,6:64,255,255"


def _wanted(config: Path | None = None, **given: object):
    flags = {"tag_id": "--id", "min_side": "--min-side"}
    return targets_from_options({flags.get(name, f"--{name}"): value for name, value in given.items()}, config)


def test_a_sheet_of_letter_paper() -> None:
    (choice,) = _wanted(target="sheet width=11in height=8.5in known_side=height").choices
    assert (choice.name, choice.driver) == ("sheet", "sheet")
    assert choice.options.width == pytest.approx(0.2794)
    assert choice.options.height == pytest.approx(0.2159)
    assert choice.options.known_side == "height"


def test_a_sheet_by_its_name() -> None:
    for name, sides_m, unit in [
        ("A4", (0.21, 0.297), CENTIMETRE),
        ("a5", (0.148, 0.21), CENTIMETRE),
        ("Letter", (0.2159, 0.2794), INCH),
        ("business-card", (0.085, 0.055), CENTIMETRE),
        ("Credit Card", (0.0856, 0.05398), CENTIMETRE),
    ]:
        wanted = _wanted(sheet=name)
        (choice,) = wanted.choices
        assert (choice.options.width, choice.options.height) == pytest.approx(sides_m)
        assert wanted.unit is unit


def test_the_smallest_side_that_is_accepted_is_an_option() -> None:
    assert _wanted(sheet="A4", min_side=8.0).choices[0].options.min_side_px == 8
    assert _wanted(tag="8cm", family="36h11", min_side=12.0).choices[0].options.min_side_px == 12
    assert _wanted(sheet="A4").choices[0].options.min_side_px == 8


def test_an_apriltag() -> None:
    wanted = _wanted(tag="8cm", family="36h11", tag_id=4)
    (choice,) = wanted.choices
    assert (choice.name, choice.driver) == ("tag", "tag")
    assert (choice.options.side, choice.options.family, choice.options.id) == (0.08, "apriltag-36h11", 4)
    assert wanted.unit is CENTIMETRE
    assert _wanted(tag="8cm", tag_id=4).choices == wanted.choices, "without a family it is of this one"


def test_distances_are_shown_in_the_unit_of_the_size() -> None:
    for sheet, unit in [
        ("11in,8.5in", INCH),
        ('11",8.5in', INCH),
        ("1ft,8in", FOOT),
        ("297 mm,21cm", CENTIMETRE),
        ("1e-1 m,1m", METRE),
    ]:
        assert _wanted(sheet=sheet).unit is unit


def test_what_is_wrong_is_said_in_one_line() -> None:
    for given, said in [
        ({}, "nothing says what to look for"),
        ({"sheet": "11in,8.5in", "ball": "6cm", "hsv": HSV}, "--sheet and --ball exclude each other"),
        ({"family": "36h11", "sheet": "11in,8in"}, "--family says nothing of a target of the kind sheet; leave it out"),
        ({"tag": "8cm", "family": "36h1"}, "--family: there is no family of tags '36h1'; did you mean"),
        ({"tag": "8cm", "family": "36h11", "tag_id": 587}, "--id: 587 is not in apriltag-36h11"),
        ({"hsv": HSV, "tag": "12 cm"}, "--hsv says nothing of a target of the kind tag"),
        (
            {"sheet": "leter"},
            "--sheet: 'leter' is no sheet with a name; did you mean 'letter'? Known names: A1, A2, A3, A4",
        ),
        ({"sheet": "1in,2in,3in"}, "'1in,2in,3in' is not a width and a height"),
        ({"sheet": "A4", "min_side": 3.0}, "--min-side: 3.0 is below 4"),
        ({"sheet": "11, 8.5"}, "--sheet: '11' has no unit"),
        ({"sheet": "11in,0in"}, "--sheet: '0in' is not a length above zero"),
        ({"sheet": "nanin,8in"}, "--sheet: 'nanin' is not a number with a unit"),
        ({"ball": "6cm", "hsv": "1,2,3"}, "--hsv: '1,2,3' has 1 limits, not 2"),
    ]:
        with pytest.raises(ConfigError, match=re.escape(said)) as caught:
            _wanted(**given)
        assert "\n" not in str(caught.value)


def test_a_tolerance_says_how_well_the_size_is_known() -> None:
    for given, share in [
        ({"ball": "10 cm", "hsv": "29,86,6:64,255,255"}, 0.01),
        ({"disc": "10 cm"}, 0.01),
        ({"tag": "10 cm", "family": "36h11"}, 0.01),
        ({"sheet": "20 cm,5 cm"}, 0.01),
    ]:
        (choice,) = _wanted(tolerance="1 mm", **given).choices
        (named,) = build_detectors([choice], None)
        assert named.detector.target_shape.relative_sigma == pytest.approx(share)


def test_any_kind_is_described_by_the_keys_of_its_table() -> None:
    wanted = _wanted(target="disc diameter=12cm shade=dark min_diameter_px=20")
    (choice,) = wanted.choices
    assert (choice.name, choice.options.diameter, choice.options.shade) == ("disc", pytest.approx(0.12), "dark")
    assert wanted.unit is CENTIMETRE
    (by_flags,) = _wanted(tag="8cm", family="36h11", tag_id=4).choices
    (by_keys,) = _wanted(target="tag side=8cm family=36h11 id=4").choices
    assert by_keys.options == by_flags.options


def test_what_is_wrong_with_a_target_is_said_with_its_option() -> None:
    for target, said in [
        ("disk diameter=12cm", "no detector driver is called 'disk'; did you mean 'disc'?"),
        ("disc diametre=12cm", "unknown key 'diametre' (did you mean 'diameter'?)"),
        ("disc", "'diameter' is missing"),
        ("disc 12cm", "'12cm' is not KEY=VALUE"),
        ("disc diameter=1cm diameter=2cm", "diameter is given twice"),
        ("", "'' is not a kind with keys"),
    ]:
        with pytest.raises(ConfigError, match=re.escape(said)) as caught:
            _wanted(target=target)
        assert str(caught.value).startswith("--target: ")


def test_with_a_configuration_the_tolerance_stands_in_the_table(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--tolerance"):
        _wanted(tolerance="1 mm", config=tmp_path / "any.toml")
