"""Durations in words, and templates: what a gap may hold, and what it becomes."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.units import parse_duration
from stadimeter.core import templates
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Event, EventKind, Notice, Severity
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.rule import AlarmRule, Template
from stadimeter.core.templates import FIELDS, FLAG_FIELDS, NUMBER_FIELDS, TEXT_FIELDS, TemplateError
from stadimeter.core.words import duration, figure_in_words, length, rounded_duration, short_figure, uncertain_figure
from stadimeter.perception.mounting import ViewMotion
from support.each_case import each_case

# Durations in words.


@each_case(
    ("seconds", "words"),
    [(0.0, "0 s"), (0.25, "0.25 s"), (59.0, "59 s"), (60.0, "1 min"), (90.0, "90 s"), (91.0, "91 s"),
     (3600.0, "1 h"), (8 * 3600.0, "8 h"), (5400.0, "90 min"), (6000.0, "100 min")],
)  # fmt: skip
def test_a_configured_duration_is_written_in_the_largest_unit_that_leaves_it_whole(seconds, words):
    assert duration(seconds) == words


@given(st.integers(0, 10_000_000).map(lambda quarters: quarters / 4))
def test_a_written_duration_is_read_as_the_same_one(seconds):
    assert parse_duration(duration(seconds)) == pytest.approx(seconds, rel=1e-5)


@each_case(
    ("seconds", "words"),
    [(-0.3, "0.0 s"), (0.24, "0.2 s"), (119.9, "119.9 s"), (120.0, "2 min"), (754.0, "12.6 min"), (7200.0, "2 h"),
     (10_000.0, "2.78 h"), (25_920_000.0, "7200 h"),
     (math.inf, "ever")],
)  # fmt: skip
def test_a_measured_duration_is_rounded_to_three_digits(seconds, words):
    assert rounded_duration(seconds) == words


@each_case(
    ("value", "unit", "words"),
    [(2.434, "m", "2.43 m"), (0.0421, "m", "42.1 mm"), (0.004, "m/s", "4 mm/s"), (0.0023, "s", "2.3 ms"),
     (0.0, "m", "0.00 m"), (-0.0421, "m", "-42.1 mm"), (math.radians(12.34), "rad", "12.3°"),
     (math.radians(0.0421), "rad", "0.0421°"),
     (14.0, "times", "14 times"), (14 + 2 / 3, "times", "14.7 times"), (0.0012, "m/s²", "0.0012 m/s²")],
)  # fmt: skip
def test_a_figure_has_three_significant_digits_and_a_unit_of_its_size(value, unit, words):
    assert short_figure(value, unit) == words


def test_no_small_figure_is_written_as_nothing():
    assert length(0.004) == "4 mm (0.157 in)"
    assert uncertain_figure("sideways speed", 0.31, 0.0012, "m/s") == "sideways speed 0.31 m/s ± 0.0012"
    assert uncertain_figure("sideways speed", 0.031, 0.0012, "m/s") == "sideways speed 31 mm/s ± 1.2"


@each_case(("seconds", "words"), [(44 / 3, "14.7 s"), (10.25, "10.25 s"), (1234.5, "1234.5 s")])
def test_seconds_are_as_they_were_written_or_rounded(seconds, words):
    assert figure_in_words(seconds, "s") == words


def test_no_standard_deviation_is_written_as_nothing():
    motion = ViewMotion(pan_rad=0.01, tilt_rad=0.0, roll_rad=0.0, zoom=0.0, sigmas=(2e-5, 0.0, 1e-3, 2e-5), inliers=90)
    assert motion.in_words() == (
        "pan +0.57° ± 0.0011°, tilt +0.00° ± 0.00°, roll +0.00° ± 0.06°, zoom +0.00% ± 0.002% (90 features agree)"
    )


# Templates: what a gap may hold, and what it becomes.

RULE = AlarmRule(name="near", target="ball", condition=DistanceCondition(below=0.5))
EVENT = Event(
    kind=EventKind.RAISED,
    source="near",
    at_s=7.0,
    severity=Severity.ALARM,
    reason="0.41 m is below 0.50 m",
    sequence=12,
)
TIME = "2026-06-01T22:14:03+02:00"
BALL = Track(
    target="ball", status=TrackStatus.TRACKING, distance_m=0.4064, sigma_m=0.0052, depth_m=0.4, closing_mps=1.0,
    bearing_rad=math.radians(20), elevation_rad=math.radians(-5),
)  # fmt: skip
LOST = Track(target="ball", status=TrackStatus.LOST, distance_m=0.4064, sigma_m=0.0052)


def noticed(event):
    return Notice(rule="near", step=0, event=event, count=3)


def filled(text, track=BALL, event=EVENT):
    template = Template(text=text)
    templates.check(template)
    return templates.render(template, templates.fields(RULE, noticed(event), track, TIME, "door"))


def filled_json(value, track=BALL):
    template = Template(text=json.dumps(value), is_json=True)
    templates.check(template)
    return json.loads(templates.render(template, templates.fields(RULE, noticed(EVENT), track, TIME)))


def test_gaps_are_filled_with_what_happened():
    assert filled("{rule} ({severity}): {target} {event} at {time_of_day}, {distance_m} m") == (
        "near (alarm): ball raised at 22:14:03, 0.41 m"
    )


@each_case(
    ("text", "expected"),
    [
        ("{distance_m}", "0.41"),
        ("{distance_m:.3f}", "0.406"),
        ("{distance_cm}", "41"),
        ("{distance_mm}", "406"),
        ("{distance_in}", "16.0"),
        ("{distance_ft:.2f}", "1.33"),
        ("{sigma_cm}", "0.5"),
        ("{depth_m}", "0.40"),
        ("{closing_kmh}", "3.6"),
        ("{closing_mph}", "2.2"),
        ("{bearing_deg:+.0f}", "+20"),
        ("{elevation_deg}", "-5"),
        ("{sequence}", "12"),
        ("{first_out}", "no"),
        ("{group}", "door"),
        ("{time}", TIME),
        ("{distance_m:8.2f}|", "    0.41|"),
        ("{rule:>8}|{rule:<8}|{rule:.2}", "    near|near    |ne"),
        ("{{rule}} stays, {rule} goes", "{rule} stays, near goes"),
    ],
)
def test_each_field_has_its_unit_and_may_be_written_otherwise(text, expected):
    assert filled(text) == expected


def test_a_number_that_is_not_known_says_so_and_the_figures_of_a_lost_target_are_not_known():
    assert filled("{distance_m:.2f} m, {bearing_deg:+.0f}°", LOST) == "unknown m, unknown°"
    assert filled("{distance_m}", None) == "unknown"


def test_in_json_a_number_alone_stays_a_number_and_what_is_not_known_is_null():
    template = {
        "distance": "{distance_m}",
        "feet": "{distance_ft:.1f}",
        "first": "{first_out}",
        "count": "{sequence}",
        "text": "{distance_m} m",
        "list": ["{rule}", 1, True, None, {"{rule}": "{{}}"}],
    }
    assert filled_json(template) == {
        "distance": 0.406,
        "feet": 1.3,
        "first": False,
        "count": 12,
        "text": "0.41 m",
        "list": ["near", 1, True, None, {"{rule}": "{}"}],
    }
    lost = filled_json(template, LOST)
    assert lost["distance"] is lost["feet"] is None
    assert lost["text"] == "unknown m"


@each_case(
    ("text", "words"),
    [
        ("{distence_m}", "there is no field 'distence_m'"),
        ("{}", "names no field"),
        ("{rule.__class__}", "the name of a field and nothing else; write {rule}"),
        ("{rule[0]}", "write {rule}"),
        ("{__class__}", "there is no field '__class__'"),
        ("{rule!r}", "cannot convert; write {rule}"),
        ("{rule:>1000000000}", "cannot be written so"),
        ("{distance_m:1000000000.2f}", "cannot be written so"),
        ("{distance_m:.999f}", "cannot be written so"),
        ("{distance_m:{rule}}", "cannot be written so"),
        ("{distance_m:x}", "such as {distance_m:.1f}"),
        ("{rule:d}", "such as {rule:>20}"),
        ("{rule", "write {{ and }} for braces"),
        ("rule}", "write {{ and }} for braces"),
        ("x" * 5000, "has 5000 characters"),
    ],
)
def test_whatever_else_a_gap_holds_is_refused(text, words):
    with pytest.raises(TemplateError) as raised:
        templates.check(Template(text=text))
    assert words in str(raised.value)
    assert len(str(raised.value)) < 250


anything = st.none() | st.floats(allow_nan=True, allow_infinity=True)
forms = st.from_regex(r"[<>^=+\- 0-9,.feg%sdxrc!_zn#]{0,6}", fullmatch=True)


@given(st.sampled_from(FIELDS), forms, anything, anything, st.text(max_size=20), st.sampled_from(TrackStatus))
def test_what_was_checked_can_always_be_filled_and_stays_short(field, form, distance_m, closing_mps, said, status):
    text = f"{{{field}:{form}}}"
    try:
        templates.check(Template(text=text))
    except TemplateError:
        return
    track = Track(target="ball", status=status, distance_m=distance_m, closing_mps=closing_mps, sigma_m=closing_mps)
    event = Event(kind=EventKind.ACKNOWLEDGED, source="near", at_s=0.0, severity=Severity.INFO, reason=said, by=said)
    values = templates.fields(RULE, noticed(event), track, TIME)
    assert len(templates.render(Template(text=text), values)) <= 1000
    packed = templates.render(Template(text=json.dumps([text]), is_json=True), values)
    json.loads(packed, parse_constant=pytest.fail)
    assert "\n" not in packed


@given(st.text(max_size=60))
def test_no_text_whatever_ends_in_anything_but_a_template_error(text):
    try:
        templates.check(Template(text=text))
    except TemplateError:
        return
    filled(text)


@given(st.text(max_size=40), st.text(max_size=40))
def test_what_people_say_cannot_become_a_gap_or_break_out_of_json(said, name):
    event = Event(kind=EventKind.RESET, source="near", at_s=0.0, severity=Severity.INFO, reason=said, by=name)
    values = templates.fields(RULE, noticed(event), BALL, TIME)
    packed = templates.render(Template(text='{"a": "{reason}|{by}", "b": "{by}"}', is_json=True), values)
    assert json.loads(packed) == {"a": f"{said}|{name}", "b": name}


def test_every_field_has_a_value():
    assert set(templates.fields(RULE, noticed(EVENT), BALL, TIME)) == set(FIELDS)
    assert len(FIELDS) == len(TEXT_FIELDS) + len(NUMBER_FIELDS) + len(FLAG_FIELDS)
