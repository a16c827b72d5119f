"""The options by which `measure` and `calibrate` are told what to look for."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from stadimeter.cli.formatting import CENTIMETRE, FOOT, INCH, METRE, LengthUnit
from stadimeter.config import plain_words
from stadimeter.config.plugins import DETECTORS, DriverChoice, load_plugin
from stadimeter.config.units import LENGTHS_M, parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import ConfigError, Problem

SheetOption = Annotated[
    str | None,
    typer.Option("--sheet", metavar="WIDTH,HEIGHT", help="Look for a sheet of this size, such as 11in,8.5in."),
]
KnownSideOption = Annotated[
    str,
    typer.Option(
        "--known-side",
        metavar="auto|width|height",
        help="Which side of the sheet to measure by: auto takes the one that is turned away the least.",
    ),
]
BallOption = Annotated[
    str | None, typer.Option("--ball", metavar="DIAMETER", help="Look for a ball of this size, such as 6.4cm.")
]
HsvOption = Annotated[
    str | None,
    typer.Option(
        "--hsv",
        metavar="H,S,V:H,S,V",
        help="The ball's colours, lower and upper limit, as OpenCV has them: hue 0 to 179, saturation and value 0 to "
        '255. Such as "29,86,6:64,255,255", a green. A lower hue above the upper one wraps through red.',
    ),
]
TagOption = Annotated[
    str | None,
    typer.Option("--tag", metavar="SIDE", help="Look for a tag whose black square has this side, such as 8cm."),
]
FamilyOption = Annotated[
    str | None,
    typer.Option("--family", metavar="FAMILY", help="The tag's family, such as 36h11 (an AprilTag) or 4x4-50 (ArUco)."),
]
TagIdOption = Annotated[
    int | None,
    typer.Option("--id", metavar="N", help="Which tag of the family; without it, the largest one in the picture."),
]
DiscOption = Annotated[
    str | None,
    typer.Option("--disc", metavar="DIAMETER", help="Look for a flat disc of this size, such as 12cm."),
]
ToleranceOption = Annotated[
    str | None,
    typer.Option(
        "--tolerance",
        metavar="LENGTH",
        help="How well the target's size is known, one standard deviation, such as 1mm; it widens the ±.",
    ),
]
ConfigOption = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Look for the targets of this configuration, through its camera."),
]

_NUMBER = re.compile(r"[\s0-9.eE+-]*")
_UNITS = {
    "in": INCH, "inch": INCH, "inches": INCH, '"': INCH, "ft": FOOT, "foot": FOOT, "feet": FOOT, "'": FOOT, "yd": FOOT,
    "mm": CENTIMETRE, "cm": CENTIMETRE,
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class WantedTargets:
    """What to look for.

    Attributes:
        choices: The detector of each target with its checked options.
        camera_model: The lens that the configuration names, if any.
        unit: The unit that the person thinks in.
    """

    choices: tuple[DriverChoice, ...]
    camera_model: CameraModel | None = None
    unit: LengthUnit = METRE


def wanted_targets(
    *,
    sheet: str | None,
    known_side: str,
    ball: str | None,
    hsv: str | None,
    config: Path | None = None,
    tag: str | None = None,
    family: str | None = None,
    tag_id: int | None = None,
    disc: str | None = None,
    tolerance: str | None = None,
) -> WantedTargets:
    """Make sense of the options.

    Args:
        sheet: ``--sheet``.
        known_side: ``--known-side``.
        ball: ``--ball``.
        hsv: ``--hsv``.
        config: ``--config``.
        tag: ``--tag``.
        family: ``--family``.
        tag_id: ``--id``.
        disc: ``--disc``.
        tolerance: ``--tolerance``.

    Returns:
        What to look for.

    Raises:
        ConfigError: They contradict each other, or one of them is wrong.
    """
    kinds = (("--sheet", sheet), ("--ball", ball), ("--tag", tag), ("--disc", disc), ("--config", config))
    given = [name for name, value in kinds if value is not None]
    if len(given) != 1:
        said = f"{' and '.join(given)} exclude each other" if given else "nothing says what to look for"
        raise ConfigError(
            f'{said}; give one of --sheet 11in,8.5in, --ball 6.4cm --hsv "…", --tag 8cm --family 36h11, '
            "--disc 12cm, or --config FILE"
        )
    _check_companions(sheet, known_side, ball, hsv)
    _check_tag_companions(tag, family, tag_id)
    if tolerance is not None and config is not None:
        raise ConfigError("--tolerance says how well a size is known; with --config it stands in the target's table")
    if sheet is not None:
        return _sheet(sheet, known_side).wanted(tolerance)
    if ball is not None:
        return _ball(ball, hsv).wanted(tolerance)
    if tag is not None:
        return _tag(tag, family, tag_id).wanted(tolerance)
    if disc is not None:
        return _Described("disc", {"diameter": disc}, {"diameter": "--disc"}, disc).wanted(tolerance)
    assert config is not None  # noqa: S101 - one of them is given
    from stadimeter.config.loader import load_configuration  # noqa: PLC0415 - most of a start, and rarely asked for

    loaded = load_configuration(config)
    return WantedTargets(choices=loaded.targets, camera_model=loaded.camera_model)


def _check_companions(sheet: str | None, known_side: str, ball: str | None, hsv: str | None) -> None:
    if hsv is not None and ball is None:
        raise ConfigError("--hsv says which colours the ball has; give --ball DIAMETER with it")
    if ball is not None and hsv is None:
        raise ConfigError('--ball needs the ball\'s colours; add --hsv, such as --hsv "29,86,6:64,255,255"')
    if known_side != "auto" and sheet is None:
        raise ConfigError("--known-side names a side of the sheet; give --sheet WIDTH,HEIGHT with it")


def _check_tag_companions(tag: str | None, family: str | None, tag_id: int | None) -> None:
    if tag is None and family is not None:
        raise ConfigError("--family says what kind of tag it is; give --tag SIDE with it")
    if tag is None and tag_id is not None:
        raise ConfigError("--id says which tag it is; give --tag SIDE with it")
    if tag is not None and family is None:
        raise ConfigError("--tag needs the tag's family; add --family, such as --family 36h11")


@dataclass(frozen=True, slots=True)
class _Described:
    """A target as the options describe it: its detector's table, the option of each key, and a size as written."""

    driver: str
    table: dict[str, Any]
    options: dict[str, str]
    size: str

    def wanted(self, tolerance: str | None) -> WantedTargets:
        """Return it with how well its size is known."""
        table, options = {**self.table, "tolerance": tolerance}, {**self.options, "tolerance": "--tolerance"}
        return WantedTargets(choices=(_choice(self.driver, table, options),), unit=_unit_of(self.size))


def _sheet(text: str, known_side: str) -> _Described:
    sizes = text.split(",")
    if len(sizes) != 2:
        raise ConfigError(f"--sheet: {text!r} is not a width and a height; write it such as 11in,8.5in")
    table = {"width": sizes[0], "height": sizes[1], "known_side": known_side}
    options = {"width": "--sheet", "height": "--sheet", "known_side": "--known-side"}
    return _Described("sheet", table, options, sizes[0])


def _ball(text: str, hsv: str | None) -> _Described:
    return _Described("ball", {"diameter": text, "hsv": hsv}, {"diameter": "--ball", "hsv": "--hsv"}, text)


def _tag(text: str, family: str | None, tag_id: int | None) -> _Described:
    table = {"side": text, "family": family, "id": tag_id}
    return _Described("tag", table, {"side": "--tag", "family": "--family", "id": "--id"}, text)


def _choice(driver: str, table: dict[str, Any], keys: dict[str, str]) -> DriverChoice:
    plugin = load_plugin(DETECTORS, driver)
    try:
        options = plugin.options.model_validate(table)
    except ValidationError as error:
        found = plain_words.findings(error, plugin.options, table, ())
        told = [Problem(each.message, key=keys.get(str(each.path[-1]), ""), hint=each.hint) for each in found]
        first_of_each_option = {problem.key: problem for problem in reversed(told)}
        raise ConfigError(reversed(first_of_each_option.values())) from error
    return DriverChoice(name=driver, driver=driver, plugin=plugin, options=options)


def parse_known_length(text: str, option: str) -> float:
    """Read a length of the command line.

    Args:
        text: What was written.
        option: The option or argument, for the message.

    Returns:
        The length in metres.

    Raises:
        ConfigError: It is no length above zero with a unit.
    """
    try:
        return parse_length(text)
    except ValueError as error:
        raise ConfigError([Problem(str(error), key=option)]) from error


def _unit_of(text: str) -> LengthUnit:
    """Return the unit to show distances in to somebody who has written a length in another."""
    unit = _NUMBER.sub("", text, count=1).strip()
    return _UNITS.get(unit, METRE) if unit in LENGTHS_M else METRE
