"""No word of pydantic's reaches a person."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, Field, ValidationError, field_validator, model_validator

from stadimeter.config.findings import did_you_mean, findings_of, format_value, hints, known_keys
from stadimeter.config.plugins import DriverOptions
from stadimeter.config.rules.conditions import WhenTable
from stadimeter.config.units import Duration, Length, Pin


class Colour(StrEnum):
    RED = "red"
    GREEN = "green"


class Inner(DriverOptions):
    size: Length
    often: int = Field(default=1, alias="count", ge=1, le=5)


class Zoo(DriverOptions):
    """One field of each kind that drivers use."""

    number: float = 1.0
    whole: int = 1
    flag: bool = False
    text: str = "x"
    share: Annotated[float, Field(ge=0, le=1)] = 0.5
    wait: Duration = Field(default=1.0, le=60.0)
    pin: Pin = 1
    colour: Colour = Colour.RED
    mode: Literal["auto", "on"] = "auto"
    device: int | str = 0
    inner: Inner | None = None
    many: tuple[Inner, ...] = ()
    pair: Annotated[list[Length], Field(min_length=2, max_length=2)] | None = None
    code: Annotated[str, Field(pattern=r"^[A-Z]{4}$")] = "MJPG"
    name: str = "x"

    @field_validator("name")
    @classmethod
    def _short(cls, name: str) -> str:
        if len(name) > 5:
            raise ValueError(f"{name!r} is longer than five letters")
        return name

    @model_validator(mode="after")
    def _together(self) -> Zoo:
        if self.flag and self.whole == 13:
            raise ValueError("flag and thirteen do not go together")
        return self


def told(table: dict[str, Any], model: type[BaseModel] = Zoo) -> list[str]:
    with pytest.raises(ValidationError) as caught:
        model.model_validate(table)
    return [
        f"{'.'.join(map(str, each.path))}: {each.message}" + (f" ({each.hint})" if each.hint else "")
        for each in findings_of(caught.value, model, table, ("zoo",), ["driver"])
    ]


WRONG = [
    ({"number": "many"}, "zoo.number: 'many' is not a number"),
    ({"number": float("nan")}, "zoo.number: nan is not a finite number"),
    ({"whole": 2.5}, "zoo.whole: 2.5 is not a whole number"),
    ({"flag": 7}, "zoo.flag: 7 is neither true nor false"),
    ({"share": 1.5}, "zoo.share: 1.5 is above 1"),
    ({"wait": "2 min"}, "zoo.wait: '2 min' is above 60 s"),
    ({"colour": "gren"}, "zoo.colour: 'gren' is not one of: red, green (did you mean 'green'?)"),
    ({"mode": "atuo"}, "zoo.mode: 'atuo' is not one of: auto, on (did you mean 'auto'?)"),
    ({"device": [1]}, "zoo.device: [1] is not a whole number and not text; put it in quotes"),
    ({"inner": 5}, "zoo.inner: 5 is not a table; write it as { … }"),
    ({"inner": {"size": "1 m", "cuont": 2}}, "zoo.inner.cuont: unknown key 'cuont' (did you mean 'count'?)"),
    ({"many": [{"size": "1 m"}, {"size": "0 m"}]}, "zoo.many.1.size: '0 m' is not a length above zero"),
    ({"pair": ["1 m"]}, "zoo.pair: ['1 m'] is a list of fewer than 2 entries"),
    ({"code": "mjpg"}, "zoo.code: 'mjpg' is not of the form ^[A-Z]{4}$"),
    ({"name": "Archibald"}, "zoo.name: 'Archibald' is longer than five letters"),
    ({"flag": True, "whole": 13}, "zoo: flag and thirteen do not go together"),
    ({"drivr": "x"}, "zoo.drivr: unknown key 'drivr' (did you mean 'driver'?)"),
]


def test_what_is_wrong_is_said_with_the_value_and_the_remedy(subtests: pytest.Subtests) -> None:
    for table, line in WRONG:
        with subtests.test(table=table, line=line):
            assert told(table) == [line]


def test_an_unknown_key_like_no_other_is_answered_with_all_that_are_known() -> None:
    assert told({"inner": {"size": "1 m", "zzzz": 2}}) == [
        "zoo.inner.zzzz: unknown key 'zzzz' (known are: count, size)"
    ]


CONDITION = [*known_keys(WhenTable)]
OTHER_WORDS = [
    ("belwo", CONDITION, "below"),
    ("closer", CONDITION, "below"),
    ("lt", CONDITION, "below"),
    ("max", CONDITION, "below"),
    ("not_seen", CONDITION, "lost"),
    ("stationary", CONDITION, "still"),
    ("below_cm", CONDITION, "below"),
    ("inside", CONDITION, ""),
    ("duration", CONDITION, ""),
    ("gpio", ["driver", "lease", "pin"], "pin"),
    ("color", ["count", "hsv", "on_floor"], "hsv"),
    ("radius", ["diameter", "min_radius_px"], "diameter"),
    ("width_cm", ["known_side", "width"], "width"),
    ("rotate", ["device", "rate"], ""),
    ("weights", ["height", "model"], "model"),
    ("hostname", ["base_topic", "host"], "host"),
    ("pass", ["base_topic", "password_file"], "password_file"),
    ("Webcam", ["opencv", "picamera2"], "opencv"),
    ("camera", ["opencv", "picamera2"], ""),
    ("image", ["images", "opencv"], "images"),
    ("servo", ["buzzer", "led", "relay"], ""),
    ("MQTT", ["mqtt", "simulated"], "mqtt"),
    ("page", ["place", "web"], "web"),
    ("invert", ["invert_left", "invert_right"], ""),
]


@pytest.mark.parametrize(("word", "known", "meant"), OTHER_WORDS)
def test_another_programs_word_is_answered_with_ours_or_not_at_all(word: str, known: list[str], meant: str) -> None:
    assert did_you_mean(word, known) == (f"did you mean '{meant}'?" if meant else "")


def test_every_hint_for_a_line_can_be_filled_in() -> None:
    for pattern, remedy in (*hints()["lines"], *hints()["characters"]):
        assert remedy.format(*"abc")
        assert re.compile(pattern)


def test_every_error_of_a_table_is_reported() -> None:
    assert len(told({"number": "x", "whole": "y", "inner": {"count": 0}, "zzz": 1})) == 5


def test_a_long_value_is_shortened() -> None:
    assert format_value("x" * 1000) == f"'{'x' * 59}…"
    assert format_value({"a": 1}) == "a table"
    assert format_value([True, 1.5]) == "[true, 1.5]"


VALUES = st.recursive(
    st.one_of(st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.sampled_from(["size", "count", "x"]), inner, max_size=3)
    ),
    max_leaves=4,
)


@given(st.dictionaries(st.sampled_from([*known_keys(Zoo), "zzz"]), VALUES, max_size=4))
def test_no_jargon_whatever_was_written(table: dict[str, Any]) -> None:
    try:
        Zoo.model_validate(table)
    except ValidationError as error:
        found = list(findings_of(error, Zoo, table, ("zoo",)))
        assert found
        for finding in found:
            text = finding.message + finding.hint
            assert "\n" not in text
            assert not any(jargon in text for jargon in ("Input", "should", "_error", "_type", "valid ", "None"))
