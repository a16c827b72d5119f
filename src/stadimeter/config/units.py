"""Values as people write them: quantities with units (``"10 ft"``, ``"24in"``, ``"250 ms"``), pins, ports and paths.

A small table of our own: the smallest unit libraries cost 300 ms at start-up, and people use these few units.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping
from datetime import time
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, PlainValidator, ValidationInfo, WithJsonSchema

from stadimeter.core import bounds
from stadimeter.core.clock import DAY_S

# The 40-pin header of a Raspberry Pi (every board since the B+ of 2014), as its documentation has it ------------------

POWER_3V3, POWER_5V, GROUND = "3.3 V", "5 V", "ground"

# What each pin is, from pin 1 on: the BCM number of its GPIO, or its supply.
HEADER: tuple[str | int, ...] = (
    POWER_3V3, POWER_5V, 2, POWER_5V, 3, GROUND, 4, 14, GROUND, 15, 17, 18, 27, GROUND, 22, 23, POWER_3V3, 24, 10,
    GROUND, 9, 25, 11, 8, GROUND, 7, 0, 1, 5, GROUND, 6, 12, 13, GROUND, 19, 16, 26, 20, GROUND, 21,
)  # fmt: skip

# GPIOs that are free only where what else uses them is switched off, or never.
TAKEN = {
    0: "the identification of add-on boards (HATs)",
    1: "the identification of add-on boards (HATs)",
    2: "I2C, with a resistor on the board that pulls it up to 3.3 V",
    3: "I2C, with a resistor on the board that pulls it up to 3.3 V",
    14: "the serial console, which drives it high while the Pi boots",
    15: "the serial console, which listens there",
}

# GPIO 0 to 8 are weakly pulled up to 3.3 V from power-up until a program takes them, the others down to ground.
PULLED_UP_MAX = 8


def header_pin(gpio: int) -> int:
    """Return the number of the pin, 1 to 40, of a GPIO by its BCM number, 0 to 27."""
    return HEADER.index(gpio) + 1


# A distance by a length that spreads by more says nothing.
MAX_SPREAD_SHARE = 0.3

INCH_M = 0.0254
FOOT_M = 0.3048


class Units(dict[str, float]):
    """The units of a quantity, each with its size in the SI unit.

    Attributes:
        most: The largest value that is taken, in the SI unit.
    """

    def __init__(self, most: float, units: dict[str, float]) -> None:
        super().__init__(units)
        self.most = most

    @property
    def si_unit(self) -> str:
        """The unit in which values are known."""
        return next(name for name, size in self.items() if size == 1.0)


LENGTHS_M = Units(bounds.MAX_LENGTH_M, {
    "mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3,
    "in": INCH_M, "inch": INCH_M, "inches": INCH_M, '"': INCH_M,
    "ft": FOOT_M, "foot": FOOT_M, "feet": FOOT_M, "'": FOOT_M,
    "yd": 0.9144,
})  # fmt: skip
DURATIONS_S = Units(
    bounds.MAX_DURATION_S, {"us": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0, "min": 60, "h": 3600, "d": DAY_S}
)
SPEEDS_MPS = Units(bounds.MAX_SPEED_MPS, {
    "mm/s": 1e-3, "cm/s": 1e-2, "m/s": 1.0, "km/h": 1 / 3.6, "in/s": INCH_M, "ft/s": FOOT_M, "mph": 0.44704,
})  # fmt: skip
JERKS_MPS3 = Units(bounds.MAX_ACCELERATION_MPS2 * 10, {"m/s3": 1.0, "m/s^3": 1.0, "m/s³": 1.0, "cm/s3": 1e-2})
ACCELERATIONS_MPS2 = Units(
    bounds.MAX_ACCELERATION_MPS2, {"m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "cm/s2": 1e-2, "ft/s2": FOOT_M}
)
ANGLES_RAD = Units(bounds.MAX_ANGLE_RAD, {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180})
TURN_RATES_RADPS = Units(bounds.MAX_TURN_RATE_RADPS, {"rad/s": 1.0, "deg/s": math.pi / 180, "°/s": math.pi / 180})
TURN_ACCELERATIONS_RADPS2 = Units(
    bounds.MAX_TURN_ACCELERATION_RADPS2,
    {
        f"{turn}/{time}": size
        for turn, size in (("rad", 1.0), ("deg", math.pi / 180), ("°", math.pi / 180))
        for time in ("s2", "s^2", "s²")
    },
)
VOLTAGES_V = Units(bounds.MAX_VOLTAGE_V, {"V": 1.0, "mV": 1e-3})
FREQUENCIES_HZ = Units(bounds.MAX_FREQUENCY_HZ, {"Hz": 1.0, "hz": 1.0, "kHz": 1e3})
BYTES = Units(bounds.MAX_PLAIN, {"B": 1.0, "kB": 1e3, "MB": 1e6, "GB": 1e9, "MiB": 2.0**20, "GiB": 2.0**30})

# The quantities of thresholds. No unit is of two of them.
SIZES = Units(bounds.MAX_SIZE, {bounds.SIZE_UNIT: 1.0, "%": 0.01})
_OF_THRESHOLDS = (LENGTHS_M, DURATIONS_S, SPEEDS_MPS, ANGLES_RAD, VOLTAGES_V, SIZES)
_OF_ANY_THRESHOLD = Units(bounds.MAX_LENGTH_M, {unit: size for units in _OF_THRESHOLDS for unit, size in units.items()})

_OF_ALL = (
    *_OF_THRESHOLDS, JERKS_MPS3, ACCELERATIONS_MPS2, TURN_RATES_RADPS, TURN_ACCELERATIONS_RADPS2, FREQUENCIES_HZ,
    BYTES,
)  # fmt: skip

# A number whose comma some read as decimal, others as the one of thousands.
_TIME_OF_DAY = re.compile(r"\s*(\d{1,2}):(\d{2})(?::(\d{2}(?:\.\d+)?))?\s*")
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+(?:\.\d*|,\d+)?|[.,]\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
# What telephones and word processors type in place of what a keyboard has, and characters without width.
_TYPED = str.maketrans("″”′\u2019−\u2013º˚µμ\uff05", "\"\"''--°°uu%", "\u200b\u200e\u200f\u2060\ufeff\u00ad")
# Parts of units as people spell them, each with what stands for it here.
_SPELT = {
    r"[\s.]": "", "milli": "m", "centi": "c", "kilo": "k", "micro": "u", "met(er|re)s?": "m", "sec(ond)?s?": "s",
    "min(ute)?s?": "min", "(hou)?rs?$|hrs?": "h", "days?": "d", "deg(ree)?s?": "deg", "radians?": "rad", "volts?": "v",
    "hertz": "hz", "bytes?": "b", "percent": "%", "gra(d|d[es]*|dians?)$": "gon", "yards?|yds": "yd", "kmh|kph": "km/h",
    "mps": "m/s", "dps": "deg/s", r"m/s/s|m/s\*\*2": "m/s2",
}  # fmt: skip
# How ``±`` is typed.
_PLUS_OR_MINUS = re.compile(r"\+/?-")
_BETWEEN_QUANTITIES = re.compile(r"(?<!\d),|,(?!\d)")


def parse_quantity(text: object, units: Units, example: str) -> float:
    """Read a number with its unit. Its decimals come after a point or a comma, wherever a person may write it.

    Args:
        example: How such a quantity may look, for error messages.

    Raises:
        ValueError: It is not a number with one of the units, its comma may be one of thousands, or it is beyond the
            bounds of `core.bounds`.
    """
    if isinstance(text, int | float) and not isinstance(text, bool):
        raise ValueError(f"{text} has no unit; write it with one, such as {example!r}")
    if not isinstance(text, str):
        raise ValueError(f"{text!r} is not a quantity; write it as text, such as {example!r}")
    match = _quantity_in(text)
    if not match:
        raise ValueError(f"{text!r} is not a number with a unit; write it such as {example!r}")
    written, unit = match[1], match[2]
    if unit not in units:
        raise ValueError(_unit_trouble(text, unit, units, example))
    if _THOUSANDS.fullmatch(written):
        dot, none = written.replace(",", "."), written.replace(",", "")
        raise ValueError(f"{text!r} may mean {dot} or {none}; write it with a point, or without the comma")
    number = float(written.replace(",", "."))
    value = number * units[unit]
    if abs(value) > units.most:
        raise ValueError(f"{text!r} is too large a number; at most {units.most:g} {units.si_unit} are taken")
    if 0 < abs(value) < bounds.MIN_QUANTITY or (number and not value):
        raise ValueError(
            f"{text!r} is too small a number; write 0, or at least {bounds.MIN_QUANTITY:g} {units.si_unit}"
        )
    return value


class Stated(NamedTuple):
    """A quantity in its SI unit, and its standard deviation; None where that is not stated."""

    value: float
    sigma: float | None = None


def parse_known(text: object, parse: Callable[[object], float], parse_sigma: Callable[[object], float]) -> Stated:
    """Read a quantity that may say how well it is known, such as ``"30 cm ± 5 mm"``; ``+-`` and ``+/-`` are ``±``.

    Raises:
        ValueError: As both parsers do.
    """
    if not isinstance(text, str):
        return Stated(parse(text))
    value, sigma = split_spread(text)
    return Stated(parse(value), parse_sigma(sigma) if sigma else None)


def parse_any_quantity(text: str) -> tuple[float, str]:
    """Read a number with the unit of any threshold, such as ``"60 cm"``; return it in the SI unit, and that unit.

    Raises:
        ValueError: As `parse_quantity` does.
    """
    match = _quantity_in(text)
    units = next((each for each in _OF_THRESHOLDS if match is not None and match[2] in each), _OF_ANY_THRESHOLD)
    return parse_quantity(text, units, "60 cm"), units.si_unit


def si_unit_of(text: str) -> str:
    """Return the SI unit of a quantity as it is written, such as ``s`` of ``"2 min"``; empty if it is no quantity."""
    match = _quantity_in(text)
    return next((units.si_unit for units in _OF_ALL if match is not None and match[2] in units), "")


def _quantity_in(text: str) -> re.Match[str] | None:
    return _QUANTITY.fullmatch(text.translate(_TYPED))


def _unit_trouble(text: str, unit: str, units: Units, example: str) -> str:
    if not unit:
        return f"{text!r} has no unit; write it with one, such as {example!r}"
    if re.search(r"(^|[\s.,])\d", unit):
        return f"{text!r} has more than one number; write one with its unit, such as {example!r}"
    plain = unit.casefold()
    for spelt, short in _SPELT.items():
        plain = re.sub(spelt, short, plain)
    same = [each for each in units if each.casefold() == plain]
    close = same or difflib.get_close_matches(plain, units, n=1, cutoff=0.85)  # less alike: another size, as kB and B
    guess = f"; did you mean {close[0]!r}?" if close else "."
    return f"{text!r}: unknown unit {unit!r}{guess} Known units: {', '.join(units)}"


def split_quantities(text: str) -> list[str]:
    """Return the parts of a list such as ``"11in, 8,5in"``: a comma between two digits belongs to a number."""
    return [part.strip() for part in _BETWEEN_QUANTITIES.split(text)]


def parse_length(text: object) -> float:
    """Read a length such as ``"10 ft"`` and return it in metres; raises ValueError if it is none, or not above 0."""
    value = parse_quantity(text, LENGTHS_M, "35 cm")
    if value <= 0:
        raise ValueError(f"{text!r} is not a length above zero")
    return value


# In place of how well a size is known: not at all.
UNKNOWN = "unknown"


def split_spread(text: str) -> tuple[str, str]:
    """Return the parts before and behind the sign of ``A4 ± 3 mm``; ``+-`` and ``+/-`` are that sign as well."""
    before, _, behind = _PLUS_OR_MINUS.sub("±", text).partition("±")
    return before.strip(), behind.strip()


class SpreadLength(NamedTuple):
    """A length that things of a kind have on average, and its standard deviation among them."""

    length_m: float
    sigma_m: float


def parse_spread_length(text: object) -> SpreadLength:
    """Read a length with its spread, such as ``"1.72 m ± 7 cm"``; raises ValueError if it is none.

    Without a spread it is the same for all; with ``± unknown`` the length is no more than a guess.
    """
    length, spread = split_spread(text) if isinstance(text, str) else (text, "")
    length_m = parse_length(length)
    if spread == UNKNOWN:
        return SpreadLength(length_m, math.inf)
    sigma_m = parse_length_or_zero(spread) if spread else 0.0
    if sigma_m > MAX_SPREAD_SHARE * length_m:
        raise ValueError(
            f"{text!r} spreads by {sigma_m / length_m:.0%}, limit {MAX_SPREAD_SHARE:.0%}: it would tell no distance; "
            "the part behind ± is one standard deviation, such as '1.72 m ± 7 cm'"
        )
    return SpreadLength(length_m, sigma_m)


def parse_velocity(text: object) -> float:
    """Read a speed with a direction, such as ``"-0.4 m/s"``, and return it in m/s; raises ValueError if it is none."""
    return parse_quantity(text, SPEEDS_MPS, "0.4 m/s")


def parse_angle(text: object) -> float:
    """Read an angle such as ``"30 deg"`` and return it in radians; raises ValueError if it is none."""
    return parse_quantity(text, ANGLES_RAD, "30 deg")


def parse_time_of_day(text: object) -> float:
    """Read a time of day such as ``"22:30"``, return the seconds since midnight; raises ValueError if it is none.

    ``24:00`` is the end of the day, 86400.
    """
    match = _TIME_OF_DAY.fullmatch(str(text)) if isinstance(text, str | time) else None
    if match is None:
        raise ValueError(f"{text!r} is not a time of day; write it such as '22:30'")
    hours, minutes, seconds = int(match[1]), int(match[2]), float(match[3] or 0)
    second = 3600 * hours + 60 * minutes + seconds
    if minutes > 59 or seconds >= 60 or second > DAY_S:
        raise ValueError(f"{text!r} is no time that a clock shows; write it such as '22:30'")
    return second


def _not_negative(units: Units, example: str) -> Callable[[object], float]:
    """Return a parser of quantities in SI units; it raises ValueError for a text that is none, or is below zero."""

    def parse(text: object) -> float:
        value = parse_quantity(text, units, example)
        if value < 0:
            raise ValueError(f"{text!r} is below zero")
        return value

    return parse


def parse_coordinate(text: object) -> float:
    """Read a coordinate such as ``"-1.5 m"``, return it in metres; raises ValueError if it is not a length."""
    return parse_quantity(text, LENGTHS_M, "-1.5 m")


parse_length_or_zero = _not_negative(LENGTHS_M, "5 cm")
parse_duration = _not_negative(DURATIONS_S, "250 ms")
parse_speed = _not_negative(SPEEDS_MPS, "0.4 m/s")
parse_acceleration = _not_negative(ACCELERATIONS_MPS2, "0.5 m/s2")
parse_jerk = _not_negative(JERKS_MPS3, "5 m/s3")
parse_angle_or_zero = _not_negative(ANGLES_RAD, "1 deg")
parse_turn_rate = _not_negative(TURN_RATES_RADPS, "60 deg/s")
parse_turn_acceleration = _not_negative(TURN_ACCELERATIONS_RADPS2, "200 deg/s2")
parse_voltage = _not_negative(VOLTAGES_V, "11 V")
parse_frequency = _not_negative(FREQUENCIES_HZ, "100 Hz")
parse_bytes = _not_negative(BYTES, "500 MB")


class PinMark:
    """Marks an option that holds the BCM number of a GPIO pin, so that a pin used twice is noticed."""


class PortMark:
    """Marks an option that holds a serial port, so that a port used twice is noticed."""


def _parse_pin(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= 27:
        raise ValueError(f"{value!r} is not a pin; write the BCM number of a GPIO, 0 to 27")
    return value


def as_written(units: Units, example: str, *, is_signed: bool = False, is_known: bool = False) -> WithJsonSchema:
    """Say to editors how a quantity is written.

    Args:
        is_known: Whether it may have its standard deviation behind it.

    Returns:
        What to annotate its type with. ``x-unit`` is the SI unit, in which its default is known.
    """
    sign = "[+-]?" if is_signed else "[+]?"
    names = "|".join(re.escape(name) for name in units)
    number = rf"([0-9]+(\.[0-9]*|,[0-9]+)?|[.,][0-9]+)([eE][+-]?[0-9]+)?\s*({names})\s*"
    pattern = rf"^\s*{sign}{number}" + (rf"((±|\+/?-)\s*{number})?$" if is_known else "$")
    return WithJsonSchema({"type": "string", "pattern": pattern, "examples": [example], "x-unit": units.si_unit})


_WITH_SPREAD = {
    "type": "string",
    "pattern": r"^[^±]*[0-9][^±]*[a-z\"'](\s*(±|\+/?-)[^±]+)?$",
    "examples": ["1.72 m ± 7 cm"],
}

Length = Annotated[float, BeforeValidator(parse_length), as_written(LENGTHS_M, "35 cm")]
# How well a size is known, as one standard deviation; infinite for not at all.
Tolerance = Annotated[
    float,
    PlainValidator(lambda text: math.inf if text == UNKNOWN else parse_length(text)),
    WithJsonSchema({"type": "string", "examples": ["1 mm", UNKNOWN], "x-unit": "m"}),
]
LengthOrZero = Annotated[float, BeforeValidator(parse_length_or_zero), as_written(LENGTHS_M, "5 cm")]
LengthWithSpread = Annotated[SpreadLength, PlainValidator(parse_spread_length), WithJsonSchema(_WITH_SPREAD)]
Duration = Annotated[float, BeforeValidator(parse_duration), as_written(DURATIONS_S, "250 ms")]
Speed = Annotated[float, BeforeValidator(parse_speed), as_written(SPEEDS_MPS, "0.4 m/s")]
Velocity = Annotated[float, BeforeValidator(parse_velocity), as_written(SPEEDS_MPS, "-0.4 m/s", is_signed=True)]
Acceleration = Annotated[float, BeforeValidator(parse_acceleration), as_written(ACCELERATIONS_MPS2, "0.5 m/s2")]
Coordinate = Annotated[float, BeforeValidator(parse_coordinate), as_written(LENGTHS_M, "-1.5 m", is_signed=True)]
Jerk = Annotated[float, BeforeValidator(parse_jerk), as_written(JERKS_MPS3, "5 m/s3")]
Angle = Annotated[float, BeforeValidator(parse_angle), as_written(ANGLES_RAD, "30 deg", is_signed=True)]
AngleOrZero = Annotated[float, BeforeValidator(parse_angle_or_zero), as_written(ANGLES_RAD, "1 deg")]
StatedLengthOrZero = Annotated[
    Stated,
    PlainValidator(lambda text: parse_known(text, parse_length_or_zero, parse_length_or_zero)),
    as_written(LENGTHS_M, "30 cm ± 5 mm", is_known=True),
]
StatedAngle = Annotated[
    Stated,
    PlainValidator(lambda text: parse_known(text, parse_angle, parse_angle_or_zero)),
    as_written(ANGLES_RAD, "-12 deg ± 0.1 deg", is_signed=True, is_known=True),
]
TimeOfDay = Annotated[
    float,
    BeforeValidator(parse_time_of_day),
    WithJsonSchema({"type": "string", "pattern": r"^\s*[0-9]{1,2}:[0-9]{2}(:[0-9.]+)?\s*$", "examples": ["22:30"]}),
]
TurnRate = Annotated[float, BeforeValidator(parse_turn_rate), as_written(TURN_RATES_RADPS, "60 deg/s")]
TurnAcceleration = Annotated[
    float, BeforeValidator(parse_turn_acceleration), as_written(TURN_ACCELERATIONS_RADPS2, "200 deg/s2")
]
Voltage = Annotated[float, BeforeValidator(parse_voltage), as_written(VOLTAGES_V, "11 V")]
Frequency = Annotated[float, BeforeValidator(parse_frequency), as_written(FREQUENCIES_HZ, "100 Hz")]
Bytes = Annotated[float, BeforeValidator(parse_bytes), as_written(BYTES, "500 MB")]
Pin = Annotated[
    int, BeforeValidator(_parse_pin), WithJsonSchema({"type": "integer", "minimum": 0, "maximum": 27}), PinMark()
]
SerialPort = Annotated[str, PortMark()]

# The key of the validation context under which the loader names the configuration's folder.
FOLDER = "folder"


def validation_context(file: Path) -> dict[str, Any]:
    """Return the ``context`` for ``model_validate`` with which paths are relative to the folder of a file."""
    return {FOLDER: file.parent}


def path_from(folder: Path, written: str | Path) -> Path:
    """Return the path that stands in a file.

    Args:
        written: What stands there: relative to the folder, absolute, or below a home folder such as ``~``. Without
            such a home folder it is a name that only begins like one, as ``~$table.png`` does.

    Raises:
        ValueError: It cannot be a path.
    """
    if "\0" in str(written):
        raise ValueError("a path has no null character")
    try:
        return folder / Path(written).expanduser()
    except RuntimeError:
        return folder / written


def _resolve(value: object, info: ValidationInfo) -> Path:
    if not isinstance(value, str | Path) or not str(value):
        raise ValueError(f"{value!r} is not a path; write it as text, such as 'pictures/desk.png'")
    return path_from((info.context or {}).get(FOLDER, Path()), value)


# A path that is relative to the configuration's folder. Without a validation context it stays as it is written.
FilePath = Annotated[Path, BeforeValidator(_resolve)]


# Sheets and balls that have a name, such as ``A4`` or ``tennis ball``, as people write them for a size ----------------

# Width and height by name: ISO 216, ANSI/ASME Y14.1 and its relatives, and ISO/IEC 7810 ID-1.
PAPER = {
    "A1": ("594 mm", "841 mm"),
    "A2": ("420 mm", "594 mm"),
    "A3": ("297 mm", "420 mm"),
    "A4": ("210 mm", "297 mm"),
    "A5": ("148 mm", "210 mm"),
    "A6": ("105 mm", "148 mm"),
    "letter": ("8.5 in", "11 in"),
    "legal": ("8.5 in", "14 in"),
    "tabloid": ("11 in", "17 in"),
    "index card": ("5 in", "3 in"),
    "business card": ("85 mm", "55 mm"),
    "US business card": ("3.5 in", "2 in"),
    "credit card": ("85.6 mm", "53.98 mm"),
}

# The middle of what each sport's rules allow, which is about a hundredth of it to either side. A measured diameter is
# better: an old tennis ball may be 64 mm.
BALLS = {
    "table tennis ball": "40 mm",
    "golf ball": "42.7 mm",
    "pool ball": "57.2 mm",
    "tennis ball": "67 mm",
    "cricket ball": "72 mm",
    "baseball": "74 mm",
    "softball": "97 mm",
    "handball": "18.8 cm",
    "volleyball": "21 cm",
    "football": "22 cm",
    "basketball": "24.3 cm",
}

# What a person writes for a size that is not known, in lower case.
UNKNOWN_SIZE = frozenset({"unknown", "?", "i don't know", "don't know"})

# Other names of the same things.
_PAPER_ALIASES = {"us letter": "letter", "us legal": "legal", "bank card": "credit card"}
_BALL_ALIASES = {"ping pong ball": "table tennis ball", "soccer ball": "football", "billiard ball": "pool ball"}


def paper_sides(text: object) -> tuple[str, str]:
    """Return width and height of a sheet by its name, in any case; a ValueError for another one has all names."""
    return PAPER[_parse_paper(text)]


def parse_ball_diameter(text: object) -> float:
    """Read a diameter such as ``"6.4 cm"`` or ``"tennis ball"`` and return it in metres.

    Raises:
        ValueError: It is neither a length above zero nor the name of a ball.
    """
    if isinstance(text, str) and re.match(r"\s*[a-zA-Z]", text):
        text = BALLS[_find_name(text, BALLS, _BALL_ALIASES, "neither a length such as '6.4 cm' nor a ball with a name")]
    return parse_length(text)


def _parse_paper(text: object) -> str:
    return _find_name(text, PAPER, _PAPER_ALIASES, "no sheet with a name")


def _find_name(text: object, names: Mapping[str, object], aliases: dict[str, str], trouble: str) -> str:
    """Return one of the names, in whatever case and with whatever between its words it was written."""
    by_key = {name.casefold(): name for name in names} | aliases
    key = re.sub(r"[\s_-]+", " ", text).strip().casefold() if isinstance(text, str) else ""
    if key in by_key:
        return by_key[key]
    close = difflib.get_close_matches(key, by_key, n=1)
    guess = f"; did you mean {by_key[close[0]]!r}?" if close else "."
    raise ValueError(f"{text!r} is {trouble}{guess} Known names: {', '.join(names)}")


# The name of a sheet, as `PAPER` has it.
Paper = Annotated[
    str, BeforeValidator(_parse_paper), WithJsonSchema({"type": "string", "examples": [*PAPER], "title": "Paper"})
]

# A length, or the name of a ball, as `BALLS` has it.
BallDiameter = Annotated[
    float,
    BeforeValidator(parse_ball_diameter),
    WithJsonSchema({"type": "string", "examples": ["6.4 cm", *BALLS], "title": "Diameter of a ball", "x-unit": "m"}),
]
