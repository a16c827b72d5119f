"""From answers to files: the wishes of ``wishes.toml``, and the configuration that they come to. Pure functions."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct

from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.driver_tables import TARGET
from stadimeter.config.toml_source import as_toml, key_and_value
from stadimeter.config.units import (
    ANGLES_RAD,
    DURATIONS_S,
    LENGTHS_M,
    SPEEDS_MPS,
    parse_length,
    parse_quantity,
    parse_time_of_day,
    split_quantities,
)
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.clock import DAY_S
from stadimeter.core.words import time_of_day
from stadimeter.errors import ConfigError
from stadimeter.workbench.setup.camera_step import SIMULATED, table_of
from stadimeter.workbench.setup.question import CAMERA_FILE, CONFIGURATION
from stadimeter.workbench.setup.target import IN_ROOM, members_of, target_table

# An output that only the views show.
SCREEN = "screen"

# No output: the rule reports and drives nothing.
NOTHING = "nothing"

# Ready distances are within this share of how far away the target is found reliably: hysteresis needs the rest.
WITHIN_REACH = 0.8

# The answer for a button that is not wired yet, and the family of tags that people have.
NO_BUTTON = "none"
USUAL_FAMILY = "36h11"

_UNITS = {"m": LENGTHS_M, "s": DURATIONS_S, "m/s": SPEEDS_MPS, "rad": ANGLES_RAD}

_MEMBER = re.compile(r".*\{member\}.*")
_BLANK = re.compile(r"\{(\w+)(?::([+-]?[\d.]+)(/s)?)?\}")

# A count is of at least two, since one is what the rule that is counted does; a rule counts up to a thousand.
MIN_COUNT, MAX_COUNT = 2, 999

# How long a visit takes in the tests of the wishes that count them, with the time before it, and some more.
VISIT_S = 3.1


class Blank(Struct, frozen=True, kw_only=True):
    """A part that a wish leaves open; its units are those of the ready answer.

    Attributes:
        kind: A ``quantity``, ``count``, ``time`` of day, ``tag``, ``button``, ``place``, ``setting`` (what
            stands in a table as it is written), ``metres`` (a length, which stands there as a number), ``camera`` or
            ``landmarks``.
        beyond: The blank before it that it must be above; empty if it may be anything.
        within: The blank before it that it must be below.
        holds: The blank before it that says how many visits it must be long enough for.
    """

    key: str
    text: str
    ready: str
    kind: str = "quantity"
    beyond: str = ""
    within: str = ""
    holds: str = ""

    @property
    def unit(self) -> str:
        """Its SI unit: m, s, m/s or rad; empty of what is no quantity."""
        return _si_unit(self.ready) if self.kind == "quantity" else ""

    @property
    def is_length(self) -> bool:
        """True if it is a distance."""
        return self.unit == "m"


class Wish(Struct, frozen=True, kw_only=True):
    """Something that people want to happen, or that is so; ``wishes.toml`` says what its parts mean.

    Attributes:
        brings_lens: Whether a file that it names has the lens, so that the camera has no `model`.
    """

    key: str
    group: str
    title: str
    sentence: str
    blanks: tuple[Blank, ...]
    output: str = ""
    rules: str = ""
    camera: str = ""
    target: str = ""
    lens: str = ""
    brings_lens: bool = False
    needs_several: bool = False

    def fill(self, answers: Mapping[str, str]) -> dict[str, str]:
        """Return the text that stands for each blank in its texts; the ready answer where there is none yet."""
        texts = {each: " ".join(answers.get(f"{self.key}_{each.key}", each.ready).split()) for each in self.blanks}
        return {blank.key: _WRITTEN.get(blank.kind, str)(text) for blank, text in texts.items()}

    @property
    def needs_output(self) -> bool:
        """True if it is nothing without something that it drives: a level alone reports nothing."""
        return "}ramp" in self.rules


def _wish(key: str, table: dict[str, Any]) -> Wish:
    blanks = tuple(Blank(key=name, **blank) for name, blank in table.pop("blanks").items())
    return Wish(key=key, blanks=blanks, **table)


_FILE = Path(__file__).with_name("wishes.toml")

WISHES = tuple(_wish(key, table) for key, table in tomllib.loads(_FILE.read_text(encoding="utf-8")).items())

_BY_KEY = {wish.key: wish for wish in WISHES}


def find_wishes(answers: Mapping[str, str]) -> tuple[Wish, ...]:
    """Return the wishes of the answers."""
    return tuple(_BY_KEY[key] for key in answers.get("wish", "").split())


def blank_answers(answers: Mapping[str, str], kind: str) -> dict[str, str]:
    """Return the answers to the blanks of one kind that were given, by their keys."""
    keys = (f"{wish.key}_{blank.key}" for wish in find_wishes(answers) for blank in wish.blanks if blank.kind == kind)
    return {key: answers[key] for key in keys if key in answers}


def fill_blanks(template: str, answers: Mapping[str, str]) -> str:
    """Return a template with an answer in place of each blank."""

    def answer(blank: re.Match[str]) -> str:
        text = answers[blank[1]]
        if not blank[2]:
            return text
        if text.isdecimal():
            return f"{int(text) + int(blank[2])}"
        if ":" in text:
            return time_of_day((parse_time_of_day(text) + float(blank[2])) % DAY_S)
        unit = _si_unit(text)
        return f"{float(blank[2]) * parse_quantity(text, _UNITS[unit], ''):.4g} {unit}{blank[3] or ''}"

    return _BLANK.sub(answer, template)


def figure_si(text: str, blank: Blank) -> float:
    """Return a figure in SI units; a ConfigError unless it is above zero, in units like those of the ready answer."""
    if blank.kind == "count":
        if text.isdecimal() and MIN_COUNT <= int(text) <= MAX_COUNT:
            return int(text)
        raise ConfigError(f"{text!r} is no number from {MIN_COUNT} to {MAX_COUNT}; write it such as {blank.ready!r}")
    try:
        if blank.kind == "time":
            return parse_time_of_day(text)
        value = parse_quantity(text, _UNITS[blank.unit], blank.ready)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if value <= 0:
        raise ConfigError(f"{text!r} is not above zero; write it such as {blank.ready!r}")
    return value


def ready_answers(wish: Wish, seen_up_to_m: float, whole_from_m: float = 0.0) -> dict[str, str]:
    """Return the ready answers to the blanks, nearer or farther where the camera would not see the target there."""
    lengths = [parse_length(blank.ready) for blank in wish.blanks if blank.is_length]
    nearer = min(1.0, WITHIN_REACH * seen_up_to_m / max(lengths, default=1.0))
    scale = max(nearer, whole_from_m / min(lengths, default=1.0))
    return {
        blank.key: f"{scale * parse_length(blank.ready):.2g} m" if scale != 1 and blank.is_length else blank.ready
        for blank in wish.blanks
    }


def _si_unit(figure: str) -> str:
    unit = figure.lstrip("+-.,0123456789eE ")  # no unit begins with an e
    return next(si for si, units in _UNITS.items() if unit in units)


def actuator_table(text: str) -> dict[str, Any]:
    """Return the table of an output such as ``buzzer 23``."""
    driver, *pin = text.split() or [""]
    if driver == SCREEN:
        return {"driver": "simulated"}
    return {"driver": driver, **({"pin": int(pin[0]) if pin[0].isdecimal() else pin[0]} if pin else {})}


def tag_table(text: str) -> dict[str, Any]:
    """Return the table of a second target such as ``36h11 7, 8 cm``."""
    tag, _, side = text.partition(",")
    return target_table({"target": "tag", "tag": tag, "size": side.strip()})


def tag_name(text: str) -> str:
    """Name a second target, such as ``tag-7``."""
    family, _, number = text.partition(",")[0].strip().partition(" ")
    return f"tag-{number.strip()}" if family == USUAL_FAMILY else f"tag-{family}-{number.strip()}"


def button_table(text: str) -> dict[str, Any]:
    """Return the table of a button on a pin such as ``22``; one that is simulated for ``none``."""
    if text == NO_BUTTON:
        return {"driver": "simulated"}
    return {"driver": "gpio", "pin": int(text) if text.isdecimal() else text}


def place_table(text: str) -> dict[str, float]:
    """Return the table of a place such as ``52.52, 13.40``; a ConfigError unless it is one on the earth."""
    try:
        latitude, longitude = (float(part) for part in text.split(","))
    except ValueError:
        latitude, longitude = math.nan, math.nan
    if not (abs(latitude) <= 90 and abs(longitude) <= 180):
        raise ConfigError(f"{text!r} is no latitude and longitude in degrees; write them such as '52.52, 13.40'")
    return {"latitude": latitude, "longitude": longitude}


def placed_tags(text: str) -> list[dict[str, Any]]:
    """Return the tags of a text such as ``3: 0 m, 2 m, 50 cm, 0 deg; 5: …``: number, x, y, z, and where it faces."""
    tags = []
    for number, _, place in (each.partition(":") for each in text.split(";")):
        *at, facing = split_quantities(place)
        tags.append({"id": int(number) if number.strip().isdecimal() else number, "at": at, "facing": facing})
    return tags


def base_table(answers: Mapping[str, str]) -> dict[str, Any]:
    """Return the table ``[base]``: its driver, the options of the answers ``base_…``, and the limits of every base."""
    speed = next((answers[key] for key in answers if key.endswith("_speed") and not key.startswith("base_")), "0.5 m/s")
    limits = {"max_speed": speed, "max_turn_rate": "60 deg/s"}
    if answers["base"] == SCREEN:
        return {"driver": "simulated", **limits}
    own = {key.removeprefix("base_"): _option(text) for key, text in answers.items() if key.startswith("base_")}
    return {"driver": answers["base"], **own, **limits}


def _option(text: str) -> Any:
    """Return an option as TOML would have it, such as ``1440`` or ``{ forward = 17 }``; else the text."""
    return key_and_value(f"value = {text}")[1]


def messenger_table(broker: str) -> dict[str, Any]:
    """Return the table ``[messenger]``."""
    host, _, port = broker.partition(":")
    return {"driver": "mqtt", "host": host, **({"port": int(port) if port.isdecimal() else port} if port else {})}


_TITLE = """\
# Written by `stadimeter init`. Change what you like:
#
#   stadimeter check stadimeter.toml     says in words what the rules below do
#   stadimeter test stadimeter.toml      tries the tests at the end; nothing moves
#   stadimeter run stadimeter.toml --watch

"""

_SCREEN_NAMES = {"vibration-motor": "motor", "led": "light", "relay": "light"}


def configuration_files(answers: Mapping[str, str], camera_model: CameraModel, model_file: str = "") -> dict[str, str]:
    """Return the text of each file by its name: the configuration, and the camera file unless there is one.

    Args:
        model_file: The camera file that is there already; empty to write one.
    """
    if any(wish.brings_lens for wish in find_wishes(answers)):
        return {CONFIGURATION: _configuration(answers, {})}
    files = {CONFIGURATION: _configuration(answers, {"model": model_file or CAMERA_FILE})}
    lens = f"{_lines(_settings('lens', answers))}\n\n{camera_file_text(camera_model)}".lstrip()
    return files if model_file else {CAMERA_FILE: lens, **files}


def _settings(part: str, answers: Mapping[str, str]) -> dict[str, Any]:
    """Return the keys that the wishes add to a table: ``camera``, ``target`` or ``lens``."""
    texts = [fill_blanks(getattr(wish, part), wish.fill(answers)) for wish in find_wishes(answers)]
    return tomllib.loads("\n".join(texts))


def rule_names(answers: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the rules that the answers lead to."""
    return tuple(
        re.findall(r"^\[rules\.([\w-]+)\]$", "".join(wish.rules for wish in find_wishes(answers)), re.MULTILINE)
    )


def _configuration(answers: Mapping[str, str], lens: Mapping[str, str]) -> str:
    outputs = _outputs(answers)
    camera = {**table_of(answers["camera"]), **lens, **_settings("camera", answers)}
    target = {**target_table(answers), **_settings("target", answers)}
    tables: list[tuple[str, Mapping[str, Any]]] = [("camera", camera), (f"targets.{answers['target']}", target)]
    tables += [(f"targets.{tag_name(tag)}", tag_table(tag)) for tag in blank_answers(answers, "tag").values()]
    tables += [(f"actuators.{name}", actuator_table(answer)) for name, answer in outputs.values() if name]
    if "base" in answers:
        tables.append(("base", base_table(answers)))
    tables += _world(answers)
    if "broker" in answers:
        tables.append(("messenger", messenger_table(answers["broker"])))
    written: dict[str, str] = {}
    for name, table in tables:
        written[name] = f"[{name}]\n{_lines(table)}\n"
    rules = [_rules(wish, answers, outputs.get(wish.key, ("", ""))[0]) for wish in find_wishes(answers)]
    return _TITLE + "\n".join([*written.values(), *rules])


def _world(answers: Mapping[str, str]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the world for a camera or a base that is not there."""
    if answers["camera"] == SIMULATED:
        target = target_table(answers)
        return [("world", {"ball_diameter": target["diameter"]} if target[TARGET.key] == IN_ROOM else {})]
    return [("world", {})] if answers.get("base") == SCREEN else []


def _outputs(answers: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return for each wish that drives an actuator its name and the answer; wishes with one answer share it."""
    named: dict[str, str] = {}
    outputs = {}
    for wish in find_wishes(answers):
        answer = answers.get(f"{wish.key}_output", NOTHING)
        if answer == NOTHING:
            continue
        driver = wish.output.split()[0] if answer == SCREEN else answer.split()[0]
        name = _SCREEN_NAMES.get(driver, driver)
        key = f"{answer} {name}" if answer == SCREEN else answer
        if key not in named:
            taken = sum(other == name or other.startswith(f"{name}-") for other in named.values())
            named[key] = f"{name}-{taken + 1}" if taken else name
        outputs[wish.key] = (named[key], answer)
    return outputs


def _lines(table: Mapping[str, Any]) -> str:
    return "\n".join(f"{key} = {as_toml(value)}" for key, value in table.items())


# What stands in the rules for an answer, where that is not the answer itself.
_WRITTEN: Mapping[str, Callable[[str], str]] = {
    "tag": tag_name,
    "button": lambda text: _lines(button_table(text)),
    "place": lambda text: _lines(place_table(text)),
    "setting": as_toml,
    "camera": lambda text: _lines(table_of(text)),
    "metres": lambda text: as_toml(parse_length(text)),
    "landmarks": lambda text: "\n\n".join(f"[[landmarks.tags]]\n{_lines(each)}" for each in placed_tags(text)),
}


def _rules(wish: Wish, answers: Mapping[str, str], output: str) -> str:
    figures = {**wish.fill(answers), "group": answers["target"]}
    if wish.key == "parking":
        nearest, farthest = (parse_length(answers[f"parking_{key}"]) for key in ("stop", "slow"))
        figures["middle"] = f"{(nearest + farthest) / 2:.4g} m"
    members, name = members_of(answers), answers["target"]
    target = name if members == (name,) else f"{name}-nearest"
    drives = (f'actuator = "{output}"\n' if output else "") + f'target = "{target}"\n'
    rules, begins, tests = wish.rules.replace("{drives}", drives).partition("[[tests]]")
    tests = _MEMBER.sub(lambda line: "\n".join(line[0].replace("{member}", each) for each in members), tests)
    parts = ((rules, target), (begins + tests, members[0]))
    return "".join(fill_blanks(part, {**figures, "target": about, "output": output}) for part, about in parts)
