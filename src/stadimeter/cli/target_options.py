"""From options to a target and pictures of it: `measure`, `colour`, `calibrate` and `site` share this way."""

from __future__ import annotations

import functools
import inspect
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeVar, cast, get_origin

import typer
from msgspec import Struct, json
from msgspec.structs import replace
from pydantic import ValidationError

from stadimeter.app.exact_json import plain
from stadimeter.cli.exits import NOT_FOUND, read_option, say_note
from stadimeter.cli.formatting import CENTIMETRE, FOOT, INCH, METRE, LengthUnit
from stadimeter.config.files import is_file
from stadimeter.config.findings import findings_of
from stadimeter.config.plugins import CAMERAS, DETECTORS, DriverChoice, load_driver
from stadimeter.config.toml_source import camera_table, key_and_value
from stadimeter.config.units import LENGTHS_M, paper_sides, parse_length, split_quantities
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Footing, Mount
from stadimeter.errors import CalibrationError, ConfigError, DriverNotFoundError, Problem
from stadimeter.workbench.picture_metadata import check_lens_settings, profile_notes

if TYPE_CHECKING:
    from stadimeter.workbench.frame_source import Source

_NUMBER = re.compile(r"[\s0-9.eE+-]*")
_UNITS = {
    "in": INCH, "inch": INCH, "inches": INCH, '"': INCH, "ft": FOOT, "foot": FOOT, "feet": FOOT, "'": FOOT, "yd": FOOT,
    "mm": CENTIMETRE, "cm": CENTIMETRE,
}  # fmt: skip


class Option(Struct, frozen=True):
    """An option of the command line.

    Attributes:
        metavar: What stands for its value in the help; empty for a switch.
        key: The name in the detector's table of an option that describes a target; empty for one that names it.
        kind: The type of the value of an option that describes a target.
        flags: Its flags; empty for the name of the argument.
        limits: The least and the most that a number may be.
        completes: Completes its value in a shell.
    """

    metavar: str
    help: str
    key: str = ""
    kind: Any = str | None
    flags: str = ""
    limits: tuple[float, float] | None = None
    completes: Callable[..., list[str]] | None = None

    def annotate(self, kind: Any, flags: str) -> Any:
        """Return the type of an argument that has this option, for typer."""
        least, most = self.limits or (None, None)
        names = (self.flags or flags).split()
        how: dict[str, Any] = {"help": self.help, "min": least, "max": most, "autocompletion": self.completes}
        return Annotated[kind, typer.Option(*names, metavar=self.metavar or None, **how)]


# The options that describe a target, in the order of the help.
_OPTIONS = {
    "--sheet": Option(
        "WIDTH,HEIGHT|NAME", "Look for a sheet of this size, such as 11in,8.5in, A4, letter or 'business card'."
    ),
    "--ball": Option("DIAMETER", "Look for a ball of this size, such as 6.4cm or 'tennis ball'."),
    "--hsv": Option(
        "H,S,V:H,S,V",
        "The ball's or the sheet's colours, if they help to find it: lower and upper limit, as OpenCV has them, "
        "of hue 0 to 179, saturation and value 0 to 255. Such as 29,86,6:64,255,255, a green. A lower hue above the "
        "upper one wraps through red.",
        "hsv",
    ),
    "--tag": Option("SIDE", "Look for a tag whose black square has this side, such as 8cm."),
    "--family": Option(
        "FAMILY", "The tag's family: 36h11, an AprilTag, unless you say another one, such as 4x4-50 (ArUco).", "family"
    ),
    "--id": Option("N", "Which tag of the family; without it, the largest one in the picture.", "id", int | None),
    "--disc": Option("DIAMETER", "Look for a flat disc of this size, such as 12cm."),
    "--min-side": Option(
        "PIXELS",
        "Accept sheets and tags whose shorter side is at least this long in the picture; 8 and 10 pixels unless "
        "you say so. Smaller ones are less certain, which the ± tells.",
        "min_side_px",
        float | None,
    ),
    "--target": Option(
        "'KIND KEY=VALUE …'",
        "Look for a target of any installed kind, with the keys that its table in a configuration has, such as "
        "'disc diameter=12cm shade=dark'. In quotes. `measure` takes two, and prints how far they are apart.",
        kind=list[str] | None,
    ),
    "--tolerance": Option(
        "LENGTH",
        "How well the target's size is known, one standard deviation, such as 1mm; it widens the ±.",
        "tolerance",
    ),
}

# The short options for built-in kinds of targets, and the keys of the size. Every kind can be named with ``--target``.
_SHORTHANDS = {"--sheet": ("width", "height"), "--ball": ("diameter",), "--tag": ("side",), "--disc": ("diameter",)}

# The values of the options that describe a target, by option, such as ``{"--disc": "12cm"}``.
GivenTarget = Mapping[str, Any]


class WantedTargets(Struct, frozen=True, kw_only=True):
    """Targets to look for, with their checked options, the configuration's lens if any, and the person's unit.

    Attributes:
        footings: What is known of those that are on the floor, by name.
        mount: Where the configuration's camera sits on a robot; None for on none.
    """

    choices: tuple[DriverChoice, ...]
    camera_model: CameraModel | None = None
    footings: Mapping[str, Footing] = {}
    mount: Mount | None = None
    unit: LengthUnit = METRE


# The options that several commands share, by the names of their arguments.
_SHARED = {
    "as_json": Option("", "Print one JSON object a line.", flags="--json"),
    "camera": Option("FILE", "The camera file, made by `stadimeter calibrate distance`."),
    "output": Option("FILE", "The file to write.", flags="--output -o"),
    "square": Option("LENGTH", "Side of a square, such as 25mm."),
    "chessboard": Option("COLUMNSxROWS", "A chessboard, by its inner corners, such as 9x6.", flags="--board"),
    "charuco": Option("COLUMNSxROWS", "A ChArUco board, by its squares, such as 5x7."),
    "marker": Option("LENGTH", "Side of a marker of the ChArUco board."),
    "dictionary": Option("NAME", "Its markers' dictionary, such as 4X4_50."),
    "distance_error": Option(
        "PERCENT", "How well you know the distances: one standard deviation, in per cent of each.", limits=(0.0, 50.0)
    ),
}


def takes_options(**own: Option) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give the arguments of a command their options: its own, those that are shared, and for ``target`` its many.

    The argument ``target`` holds the values by option, for `targets_from_options`.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        options, parameters = {**_SHARED, **own}, list[inspect.Parameter]()
        for each in inspect.signature(command, eval_str=True).parameters.values():
            if each.name == "target":
                parameters += [_parameter(flag, option) for flag, option in _OPTIONS.items()]
            elif each.name in options and get_origin(each.annotation) is not Annotated:
                kind = options[each.name].annotate(each.annotation, f"--{each.name.replace('_', '-')}")
                parameters.append(each.replace(annotation=kind))
            else:
                parameters.append(each)
        flags = {_parameter(flag, option).name: flag for flag, option in _OPTIONS.items()}

        @functools.wraps(command)
        def with_options(**values: Any) -> None:
            given = {flags[name]: values.pop(name) for name in [*values] if name in flags}
            command(**({"target": given} if given else {}), **values)

        with_options.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        with_options.__annotations__ = {each.name: each.annotation for each in parameters}
        return with_options

    return decorate


def _parameter(flag: str, option: Option) -> inspect.Parameter:
    name, kind = f"target_{flag.removeprefix('--').replace('-', '_')}", option.annotate(option.kind, flag)
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)


def targets_from_options(given: GivenTarget, config: Path | None = None, *, several: bool = False) -> WantedTargets:
    """Return the targets the options describe, or those of ``--config``; `ConfigError` if they contradict each other.

    Args:
        several: Whether ``--target`` may be given more than once.
    """
    said = {flag: value for flag, value in given.items() if value not in (None, [])}
    describing = [flag for flag in (*_SHORTHANDS, "--target") if flag in said]
    names = [*describing, *(["--config"] if config is not None else [])]
    if len(names) != 1:
        trouble = f"{' and '.join(names)} exclude each other" if names else "nothing says what to look for"
        raise ConfigError(
            f'{trouble}; give one of --sheet 11in,8.5in, --ball 6.4cm --hsv "…", --tag 8cm --family 36h11, '
            "--disc 12cm, --target 'KIND KEY=VALUE …', or --config FILE"
        )
    (name,) = names
    if config is not None:
        if said:
            raise ConfigError(
                f"{next(iter(said))} is a key of the target's table where there is --config; leave it out"
            )
        loaded = _loader().load_configuration(config)
        return WantedTargets(
            choices=loaded.targets, camera_model=loaded.camera_model, footings=loaded.footings, mount=loaded.mount
        )
    if name == "--target" and len(texts := _texts(said[name])) > 1:
        return _several_targets(texts, said, is_allowed=several)
    kind, table, flags = _named_target(*texts) if name == "--target" else _short_target(name, said[name])
    units = [unit for value in table.values() if (unit := _unit_of(value)) is not None]
    for flag, value in said.items():
        if key := _OPTIONS[flag].key:
            table[key], flags[key] = value, flag
    return WantedTargets(choices=(_choice(kind, table, flags),), unit=units[0] if units else METRE)


def _texts(value: str | list[str]) -> list[str]:
    return [value] if isinstance(value, str) else value


def _several_targets(texts: list[str], said: GivenTarget, *, is_allowed: bool) -> WantedTargets:
    """Return the targets of several ``--target``, numbered where their kinds are the same."""
    if not is_allowed:
        raise ConfigError("--target is given more than once; this command takes one target")
    if others := [flag for flag in said if flag != "--target"]:
        raise ConfigError(f"{others[0]} is that of one target; write it into each --target, such as tolerance=1mm")
    each = [targets_from_options({"--target": text}) for text in texts]
    kinds = [wanted.choices[0].name for wanted in each]
    numbers = [kinds[: place + 1].count(kind) for place, kind in enumerate(kinds)]
    names = [
        kind if kinds.count(kind) == 1 else f"{kind} {number}" for kind, number in zip(kinds, numbers, strict=True)
    ]
    choices = (replace(wanted.choices[0], name=name) for wanted, name in zip(each, names, strict=True))
    return WantedTargets(choices=tuple(choices), unit=each[0].unit)


def _loader() -> Any:
    from stadimeter.config import loader  # noqa: PLC0415 - most of a start, and rarely needed

    return loader


# A target as the options describe it: its kind, its detector's table, and the option that each key comes from.
_Described = tuple[str, dict[str, Any], dict[str, str]]


def _short_target(flag: str, text: str) -> _Described:
    keys = _SHORTHANDS[flag]
    sizes = _sides(flag, text) if len(keys) > 1 else [text]
    return flag.removeprefix("--"), dict(zip(keys, sizes, strict=True)), dict.fromkeys(keys, flag)


def _sides(flag: str, text: str) -> list[str]:
    """Return width and height, which may be given by the name of a paper."""
    sizes = split_quantities(text)
    if len(sizes) == 2:
        return sizes
    if len(sizes) > 2 or text[:1].isdigit():
        raise ConfigError(f"{flag}: {text!r} is not a width and a height; write it such as 11in,8.5in or A4")
    try:
        return [*paper_sides(text)]
    except ValueError as error:
        raise ConfigError([Problem(f"{error}; or write it such as 11in,8.5in", key=flag)]) from error


def _named_target(text: str) -> _Described:
    """Return the target of ``--target 'KIND KEY=VALUE …'``."""
    try:
        kind, *pairs = shlex.split(text)
    except ValueError as error:  # nothing at all, or a quote without its end
        raise ConfigError(
            f"--target: {text!r} is not a kind with keys; write it such as 'disc diameter=12cm'"
        ) from error
    table: dict[str, Any] = {}
    for pair in pairs:
        key, value = key_and_value(pair)
        if "=" not in pair or not key:
            raise ConfigError(f"--target: {pair!r} is not KEY=VALUE; write it such as diameter=12cm")
        if key in table:
            raise ConfigError(f"--target: {key} is given twice")
        table[key] = value
    return kind, table, {}


def _choice(driver: str, table: dict[str, Any], keys: Mapping[str, str]) -> DriverChoice:
    try:
        model = load_driver(DETECTORS, driver)
    except DriverNotFoundError as error:
        raise ConfigError([Problem(str(error), key="--target")]) from error
    if foreign := [flag for key, flag in keys.items() if key not in model.model_fields]:
        raise ConfigError(f"{foreign[0]} says nothing of a target of the kind {driver}; leave it out")
    try:
        options = model.model_validate(table)
    except ValidationError as error:
        found = findings_of(error, model, table, ())
        wrong = [_problem(str(each.path[-1]) if each.path else "", each.message, each.hint, keys) for each in found]
        of_each_option = {each.key if each.key != "--target" else each.message: each for each in reversed(wrong)}
        raise ConfigError(reversed(of_each_option.values())) from error
    return DriverChoice(name=driver, driver=driver, options=options)


def _problem(key: str, message: str, hint: str, keys: Mapping[str, str]) -> Problem:
    if key in keys:
        return Problem(message, key=keys[key], hint=hint)
    return Problem(message if key in message else f"{key}: {message}", key="--target", hint=hint)


def parse_known_length(text: str, option: str) -> float:
    """Read a length above zero, in metres; the `ConfigError` names the option."""
    return read_option(parse_length, text, option)


def _unit_of(value: object) -> LengthUnit | None:
    """Return the unit to show distances in to a person who has written a length in another; None for no length."""
    unit = _NUMBER.sub("", value, count=1).strip() if isinstance(value, str) else ""
    return _UNITS.get(unit, METRE) if unit in LENGTHS_M else None


LiveOption = Annotated[
    str | None,
    typer.Option(
        "--live",
        metavar="CONFIG|DEVICE|DRIVER",
        help="Take what a camera sees: that of a configuration; a device such as 0 or one that `stadimeter cameras` "
        "lists; or a driver with its options, such as opencv,device=0,exposure=10ms.",
    ),
]


def camera_choice(live: str) -> DriverChoice:
    """Return the camera of a configuration, a device, or a camera driver with its options, such as ``opencv,device=0``.

    Raises:
        ConfigError: There is no such configuration, or an option is wrong.
        DriverError: There is no such driver.
    """
    if Path(live).suffix.lower() == ".toml" or is_file(Path(live)):
        configured: DriverChoice = _loader().load_camera_choice(Path(live))
        return configured
    table = camera_table(live)
    driver = table.pop("driver")
    model = load_driver(CAMERAS, driver)
    try:
        return DriverChoice(name="camera", driver=driver, options=model.model_validate(table))
    except ValidationError as error:
        found = findings_of(error, model, table, ())
        hint = f"write it such as --live {driver},KEY=VALUE, or write a configuration and give that"
        raise ConfigError([Problem(f"{driver}: {each.message}", key="--live", hint=hint) for each in found]) from error


# Pictures, from files or from a camera before a person ----------------------------------------------------------------

_T = TypeVar("_T")


def check_one_source(pictures: object, live: str | None, what: str) -> None:
    """Raise a `ConfigError` for pictures and a camera at once, and for neither."""
    if bool(pictures) == bool(live):
        raise ConfigError(f"give {what}, or --live for a camera, one of the two")


def split_pictures(
    texts: Sequence[str], read: Callable[[str, str], _T], what: str, such_as: str, first: _T | None = None
) -> list[tuple[Path, _T]]:
    """Read ``PATH@VALUE`` pictures, and note what is to be known of how they were taken.

    Args:
        read: Reads a value; it also gets the picture's name, for messages.
        what: The meaning of the value, for the message where it is missing.
        first: The value of the first picture where it has none; None where it must have one.

    Raises:
        ConfigError: A value is missing or wrong, or a picture is given twice.
    """
    taken: dict[Path, _T] = {}
    for text in texts:
        path, at, value = text.rpartition("@")
        if not (at and path) and (taken or first is None):
            raise ConfigError(f"{text!r} does not say {what}; write it such as {text}@{such_as}")
        name = Path(path or text)
        if name in taken:
            raise ConfigError(f"{name} is given twice; a picture says the same each time, so give each of them once")
        taken[name] = read(value, path) if path else cast("_T", first)
    check_lens_settings([*taken])
    for note in profile_notes([*taken]):
        say_note(note)
    return [*taken.items()]


@contextmanager
def live_camera(live: str) -> Iterator[Source]:
    """Give the camera of ``--live``, open and settled, and note its remarks; close it afterwards."""
    from stadimeter.workbench.frame_source import open_camera  # noqa: PLC0415 - loads the rules; pictures need none

    choice = camera_choice(live)
    typer.echo("opening the camera …", err=True)
    with open_camera(choice) as source:
        for words in source.capture.remarks():
            say_note(words)
        yield source


def ask_until(ask: Callable[[], str], stop: Callable[[str], NoReturn], take: Callable[[str], _T]) -> _T:
    """Ask a person for something before the camera, until it is taken: after an error again.

    Args:
        ask: Says what to do, and returns the question.
        stop: Ends the command where there is no answer, or Ctrl-C is pressed; it gets why.
        take: Takes what is there by the answer, which may be empty.
    """
    while True:
        try:
            return take(input(ask()).strip())
        except EOFError:
            stop("there is no answer")
        except KeyboardInterrupt:
            stop("stopped")
        except (ConfigError, CalibrationError) as error:
            typer.echo(f"error: {error}", err=True)


def give_up(why: str) -> NoReturn:
    """End a command that found too little: exit code 1."""
    typer.echo(f"error: {why}", err=True)
    raise typer.Exit(NOT_FOUND)


def print_answer(lines: Iterable[str], figures: Mapping[str, object], *, as_json: bool) -> None:
    """Print an answer as lines, or as one JSON object with null for NaN; notes among the lines are said."""
    for line in lines:
        if not as_json:
            typer.echo(line)
    if as_json:
        typer.echo(json.encode(plain(figures)).decode())


def tell_written(
    path: Path, write: Callable[[Path], None], lines: Iterable[str], figures: Mapping[str, object], *, as_json: bool
) -> None:
    """Write a file, and print the answer that it comes from, and whether it took the place of another."""
    replaced = path.exists()
    write(path)
    said = f"{'replaced' if replaced else 'wrote'} {path}"
    print_answer(chain(lines, (said,)), {"file": str(path), "replaced": replaced, **figures}, as_json=as_json)
