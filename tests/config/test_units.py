"""Quantities are read in SI units, and what is none is refused in plain words."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config import units
from stadimeter.config.loader import load_configuration
from stadimeter.core.alarms.machine import thresholds_of
from stadimeter.errors import ConfigError
from support.simulated_run import SIMULATED_BALL

SEVERAL = "'{}' has more than one number; write one with its unit, such as '35 cm'"


QUANTITIES = [
    (units.parse_length, "10 ft", 3.048),
    (units.parse_length, "24in", 0.6096),
    (units.parse_length, '24"', 0.6096),
    (units.parse_length, " 35 cm ", 0.35),
    (units.parse_length, "1e1 mm", 0.01),
    (units.parse_length_or_zero, "0 m", 0.0),
    (units.parse_duration, "250 ms", 0.25),
    (units.parse_speed, "3.6 km/h", 1.0),
    (units.parse_acceleration, "50 cm/s2", 0.5),
    (units.parse_angle, "-180°", -math.pi),
    (units.parse_turn_rate, "90 deg/s", math.pi / 2),
    (units.parse_turn_acceleration, "180 deg/s2", math.pi),
    (units.parse_turn_acceleration, "2 rad/s²", 2.0),
    (units.parse_frequency, "1 kHz", 1000.0),
    (units.parse_length, "1,5 m", 1.5),
    (units.parse_length, "6,4cm", 0.064),
    (units.parse_angle, "-22,5 deg", -math.pi / 8),
]


def test_a_quantity_is_read_in_si_units(subtests: pytest.Subtests) -> None:
    for parse, text, value in QUANTITIES:
        with subtests.test(parse=parse, text=text):
            assert parse(text) == pytest.approx(value)


REFUSED = [
    (units.parse_length, "0 cm", "'0 cm' is not a length above zero"),
    (units.parse_length, "-1 m", "'-1 m' is not a length above zero"),
    (units.parse_length_or_zero, "-1 m", "'-1 m' is below zero"),
    (units.parse_length, "nan m", "'nan m' is not a number with a unit; write it such as '35 cm'"),
    (units.parse_length, "1e999 m", "'1e999 m' is too large a number; at most 1e+09 m are taken"),
    (units.parse_length, "35", "'35' has no unit; write it with one, such as '35 cm'"),
    (units.parse_length, 35, "35 has no unit; write it with one, such as '35 cm'"),
    (units.parse_length, "1,500 m", "'1,500 m' may mean 1.500 or 1500; write it with a point, or without the comma"),
    (units.parse_length, "1,500,000 m", SEVERAL.format("1,500,000 m")),
    (units.parse_length, "1 ft 2 in", SEVERAL.format("1 ft 2 in")),
    (units.parse_length, True, "True is not a quantity; write it as text, such as '35 cm'"),
    (units.parse_length, "", "'' is not a number with a unit; write it such as '35 cm'"),
    (units.parse_length, "10 feets", "'10 feets': unknown unit 'feets'; did you mean 'feet'? Known units: mm, cm,"),
    (units.parse_length, "20 centimetres", "'20 centimetres': unknown unit 'centimetres'; did you mean 'cm'?"),
    (units.parse_length, "2 min", "'2 min': unknown unit 'min'. Known units: mm, cm,"),
    (units.parse_duration, "2 hours", "'2 hours': unknown unit 'hours'; did you mean 'h'?"),
    (units.parse_speed, "5 kph", "'5 kph': unknown unit 'kph'; did you mean 'km/h'?"),
    (units.parse_bytes, "5 TB", "'5 TB': unknown unit 'TB'. Known units: B, kB,"),
    (units.parse_duration, "-1 s", "'-1 s' is below zero"),
    (units.parse_turn_acceleration, "-1 deg/s2", "'-1 deg/s2' is below zero"),
]


def test_what_is_no_quantity_is_refused(subtests: pytest.Subtests) -> None:
    for parse, value, message in REFUSED:
        with subtests.test(parse=parse, value=value), pytest.raises(ValueError, match=f"^{re.escape(message)}"):
            parse(value)


@given(st.one_of(st.text(), st.from_regex(r"[-+]?[0-9.eE]{1,8} ?(m|cm|ft|x)", fullmatch=True)))
def test_any_text_is_a_length_above_zero_or_refused_with_its_value(text: str) -> None:
    try:
        value = units.parse_length(text)
    except ValueError as refused:
        message = str(refused)
    else:
        message = repr(text)
        assert 0 < value < math.inf
    assert repr(text) in message


LISTS = [
    ("11in,8.5in", ["11in", "8.5in"]),
    ("29,7 cm, 21,0 cm", ["29,7 cm", "21,0 cm"]),
    ("29,7cm,21cm", ["29,7cm", "21cm"]),
    ("A4", ["A4"]),
]


def test_a_comma_between_digits_is_no_separator(subtests: pytest.Subtests) -> None:
    for text, parts in LISTS:
        with subtests.test(text=text, parts=parts):
            assert units.split_quantities(text) == parts


@given(st.integers(0, 999), st.integers(0, 99))
def test_a_decimal_comma_reads_as_a_point_does_in_text_and_schema(whole: int, part: int) -> None:
    comma, point = f"{whole},{part} m", f"{whole}.{part} m"
    pattern = units.as_written(units.LENGTHS_M, "1 m").json_schema["pattern"]
    assert units.parse_length_or_zero(comma) == units.parse_length_or_zero(point)
    assert re.match(pattern, comma)
    assert re.match(pattern, point)


@pytest.mark.parametrize(
    ("text", "length_m", "sigma_m"),
    [
        ("1.72 m ± 7 cm", 1.72, 0.07),
        ("1,72m +- 7cm", 1.72, 0.07),
        ("63 mm +/- 3.5 mm", 0.063, 0.0035),
        ("6 ft", 1.8288, 0.0),
    ],
)
def test_a_length_is_read_with_its_spread(text: str, length_m: float, sigma_m: float) -> None:
    assert units.parse_spread_length(text) == pytest.approx((length_m, sigma_m))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1.72", "has no unit"),
        ("1.72 m ± 7", "has no unit"),
        ("0 m ± 1 cm", "is not a length above zero"),
        ("1.72 m ± -1 cm", "is below zero"),
        ("1.72 m ± 70 cm", "spreads by 41%, limit 30%"),
        (1.72, "has no unit"),
    ],
)
def test_a_spread_that_is_none_is_refused(text: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        units.parse_spread_length(text)


# What an operator may set a threshold to is what the configuration takes there, and nothing else.


# A condition with a gap for the value, the name of its threshold, its unit, and a value that is taken.
FORMS = [
    ('{{ below = "{} m" }}', "below", 0.5),
    ('{{ above = "{} m", deadband = "20 cm" }}', "above", 0.5),
    ('{{ between = ["{} m", "2 m"] }}', "between.near", 0.5),
    ('{{ between = ["1 m", "{} m"] }}', "between.far", 2.0),
    ('{{ above = "{} m", below = "2 m" }}', "between.near", 0.5),
    ('{{ bearing = {{ above = "{} rad" }} }}', "bearing.above", 0.1),
    ('{{ elevation = {{ between = ["-0.1 rad", "{} rad"] }} }}', "elevation.between.high", 0.5),
    ('{{ closing_speed = {{ above = "{} m/s" }} }}', "closing_speed.above", 0.5),
    ('{{ closing_speed = {{ between = ["{} m/s", "2 m/s"] }} }}', "closing_speed.between.low", 0.5),
    ('{{ time_to_contact = {{ below = "{} s" }} }}', "time_to_contact.below", 0.5),
    ('{{ lost = "{} s" }}', "lost", 3.0),
    ('{{ seen = "{} s" }}', "seen", 3.0),
]
EDGES = [0.0, -0.0, 0.2, 1.0, 2.0, 1e-13, 1e-12, 1e9, 1e10, 3.2e9, 1e6, 1e4, -1e4, 2e4, math.pi]
values = st.sampled_from([*EDGES, *(math.nextafter(each, math.inf) for each in EDGES)]) | st.floats(-2e10, 2e10)


def load(folder, when):
    file = folder / "door.toml"
    file.write_text(f"{SIMULATED_BALL}\n[rules.near]\nwhen = {when}\n[world]\n")
    return load_configuration(file)


def load_or_refuse(folder, when):
    try:
        return load(folder, when).plan.rules[0]
    except ConfigError:
        return None


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("bounds")


@pytest.mark.long
@given(form=st.sampled_from(FORMS), value=values | st.floats(0.05, 3.0))
def test_an_operator_may_set_what_the_configuration_takes_and_nothing_else(folder, form, value):
    when, key, sound = form
    (rule,) = load(folder, when.format(sound)).plan.rules
    is_taken = thresholds_of(rule)[key].takes(value)
    if key in {"lost", "seen"} and value == 0:  # another condition: without a time
        assert not is_taken
        return
    written = load_or_refuse(folder, when.format(f"{value:.17g}"))
    assert (written is not None) is is_taken
    if written is not None:
        assert thresholds_of(written)[key].value == value
