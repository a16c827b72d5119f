"""Drivers by name: how a configuration's ``driver = "buzzer"`` becomes a driver.

Every driver, built in or not, is an entry point in one of the `GROUPS` and names a `Plugin`. Only the drivers that a
configuration names are loaded, so a driver whose library is missing costs nothing until then.
"""

from __future__ import annotations

import difflib
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, PackageNotFoundError, distribution, entry_points
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.clock import Clock
from stadimeter.core.frame import Image
from stadimeter.errors import DriverError, DriverNotFoundError, DriverUnavailableError

if TYPE_CHECKING:  # a run draws nothing
    from stadimeter.core.drawing import Drawing

OptionsT = TypeVar("OptionsT", bound=BaseModel)
SharedT = TypeVar("SharedT")

CAMERAS = "stadimeter.cameras"
DETECTORS = "stadimeter.detectors"
ACTUATORS = "stadimeter.actuators"
BASES = "stadimeter.bases"
BUTTONS = "stadimeter.buttons"
MESSENGERS = "stadimeter.messengers"
NOTIFIERS = "stadimeter.notifiers"
WORLDS = "stadimeter.worlds"
PORTS = "stadimeter.ports"
GROUPS = (CAMERAS, DETECTORS, ACTUATORS, BASES, BUTTONS, MESSENGERS, NOTIFIERS, WORLDS, PORTS)


class Options(BaseModel):
    """The options of a driver, as its table in the configuration holds them. Drivers derive their own from it.

    Unknown keys are errors, and numbers are finite. Fields that a person writes with a unit use the types of
    `stadimeter.config.units`; fields that name a pin or a serial port use `Pin` and `SerialPort`, so that two drivers
    on one of them are noticed.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


@dataclass(slots=True)
class Shared:
    """Objects that the drivers of one run share, such as the simulated world or one pin factory.

    Attributes:
        closers: What to call at the end of the run, last first.
    """

    parts: dict[str, Any] = field(default_factory=dict)
    closers: list[Callable[[], None]] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverContext:
    """The part of a run that a driver gets.

    Attributes:
        name: The part's name in the configuration, such as ``motor``; for error messages.
        camera_model: The lens that the configuration names; a simulated camera draws its pictures through it.
        shared: What the drivers of this run share.
    """

    name: str
    clock: Clock
    camera_model: CameraModel | None = None
    shared: Shared = field(default_factory=Shared)

    def share(self, key: str, make: Callable[[], SharedT]) -> SharedT:
        """Return the run's one object of that name; make it if this is the first to ask.

        Args:
            key: A name that the drivers agree on, such as ``pin factory``.
        """
        if key not in self.shared.parts:
            self.shared.parts[key] = make()
        found: SharedT = self.shared.parts[key]
        return found

    def at_end(self, close: Callable[[], None]) -> None:
        """Call ``close``, which releases something shared, when the run ends and every driver was closed."""
        self.shared.closers.append(close)

    def port_path(self, port: str) -> str:
        """Return the path of the serial port that a configuration means.

        Args:
            port: A path such as ``/dev/serial/by-id/…``, or the name of an entry point in ``stadimeter.ports``,
                which then makes the port, such as a firmware emulator behind a pseudo-terminal.

        Raises:
            DriverUnavailableError: The entry point cannot be loaded.
        """
        if port not in driver_names(PORTS):
            return port
        plugin = load_plugin(PORTS, port)
        path: str = plugin.build(plugin.options(), self)
        return path


@dataclass(frozen=True, slots=True, kw_only=True)
class Exercise:
    """A target that `bench` lets a detector find.

    Attributes:
        options: The detector's table, as a configuration would have it.
        patch: The target with its surroundings, as it looks in a picture that is 480 px high, to be put into pictures
            of the simulated room; None to look for the green ball of 20 cm that is in that room.
    """

    options: Mapping[str, Any]
    patch: Image | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialStop:
    """What stops a device on a serial port from outside, when the program that drove it is gone.

    Attributes:
        port: A path below ``/dev``.
        frame: At most 64 bytes, which stop it also after a command of which only a part was sent.
    """

    port: str
    baud: int
    frame: bytes


@dataclass(frozen=True, slots=True)
class Plugin(Generic[OptionsT]):
    """A driver, as its entry point names it.

    Attributes:
        options: The model of the driver's table in the configuration.
        build: Makes the driver from its checked options and the run's context, without touching hardware.
        is_simulated: Tells from its options whether the driver acts in a simulated world only. A recording that drives
            anything else is watched more closely.
        lacks: Names what the driver with these options would lack on this computer, such as a library or a file:
            sentences that `check` warns of. It touches no hardware and no network.
        not_for_motion: Of a camera, why nothing may move on its frames: for each option that would have to be written,
            a sentence that `check` warns of. See `stadimeter.cameras.protocol.Camera.not_for_motion`.
        latency: Of a camera, how old a frame is on arrival, in seconds, as its options state.
        attached: Of a camera, lists those that are on this computer, without taking pictures: a tuple of
            `stadimeter.cameras.protocol.AttachedCamera`.
        reach: Of a messenger, connects once and hangs up, and returns what is wrong or nothing, for `doctor`. A running
            instance keeps its connection.
        verb: Of an actuator, what it does when it acts, for descriptions: such as ``buzzes``.
        is_worn_by_switching: Of an actuator, whether each change of its level wears it out: `check` warns of patterns
            that never end.
        circuit: Of an actuator or a button on a pin, what hangs on it, for `wiring`: ``motor`` (or another coil on a
            supply of its own), ``buzzer``, ``led``, ``relay`` (a board with an input) or ``button``; empty for a signal
            of 3.3 V.
        stop_frame: Of an output on a serial port, what stops it when the program is gone; None if nothing can. Pins
            need none: they are driven to the level at which they are off.
        needs_world: Whether it shows, knows or moves what is in a simulated world, which there must be then.
        needs_pixels: Of a detector, whether it looks for its target in pictures: `check` warns where that is too small.
        exercise: Of a detector, makes what `bench` measures its speed on; None to leave it out.
        draw: Of a detector, draws its target at its true size with the white rim that it needs, for `print`.
        propose_colour: Of a detector that goes by colour, finds out the range of colours of its target in pictures: a
            `stadimeter.detectors.protocol.ProposesColour`.
        view_colour: Of such a detector, shows what a range of colours covers in a frame: a
            `stadimeter.detectors.protocol.ViewsColour`.
        widen_colour: Of such a detector, returns a range that covers more by so many steps, or less by negative ones.
    """

    options: type[OptionsT]
    build: Callable[[OptionsT, DriverContext], Any]
    is_simulated: Callable[[OptionsT], bool] = field(default=lambda _options: False)
    lacks: Callable[[OptionsT], tuple[str, ...]] = field(default=lambda _options: ())
    not_for_motion: Callable[[OptionsT], Mapping[str, str]] = field(default=lambda _options: {})
    latency: Callable[[OptionsT], float] = field(default=lambda _options: 0.0)
    attached: Callable[[], tuple[Any, ...]] = field(default=tuple, kw_only=True)
    reach: Callable[[OptionsT], str] | None = field(default=None, kw_only=True)
    verb: str = field(default="drives", kw_only=True)
    is_worn_by_switching: bool = field(default=False, kw_only=True)
    circuit: str = field(default="", kw_only=True)
    stop_frame: Callable[[OptionsT], SerialStop | None] = field(default=lambda _options: None, kw_only=True)
    needs_world: bool = field(default=False, kw_only=True)
    needs_pixels: bool = field(default=True, kw_only=True)
    exercise: Callable[[], Exercise] | None = field(default=None, kw_only=True)
    draw: Callable[[OptionsT], Drawing] | None = field(default=None, kw_only=True)
    propose_colour: Callable[..., Any] | None = field(default=None, kw_only=True)
    view_colour: Callable[..., Any] | None = field(default=None, kw_only=True)
    widen_colour: Callable[[str, int], str] | None = field(default=None, kw_only=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverChoice:
    """A driver that a configuration names.

    Attributes:
        name: The part's name in the configuration, such as ``motor``.
        driver: The driver's name, such as ``vibration-motor``.
    """

    name: str
    driver: str
    plugin: Plugin[Any]
    options: Options


def marked_options(options: BaseModel, mark: type) -> Iterator[tuple[tuple[str, ...], object]]:
    """Yield the options of a driver whose type bears a mark, such as `stadimeter.config.units.PinMark`: key and value.

    Tables in the options are looked through too; options without a value are left out.
    """
    for name, field_ in type(options).model_fields.items():
        value, key = getattr(options, name), field_.alias or name
        if isinstance(value, BaseModel):
            yield from (((key, *path), inner) for path, inner in marked_options(value, mark))
        elif value is not None and _bears(field_.metadata, field_.annotation, mark):
            yield (key,), value


def _bears(metadata: list[Any], annotation: Any, mark: type) -> bool:
    if any(isinstance(entry, mark) for entry in metadata):
        return True
    inner = typing.get_args(annotation)
    return any(isinstance(entry, mark) or _bears([], entry, mark) for entry in inner)


@cache
def _built_in() -> EntryPoints:
    """Return this package's own entry points: one file. Most configurations name no other driver."""
    try:
        return distribution("stadimeter").entry_points
    except PackageNotFoundError:
        return EntryPoints()


@cache
def _every_entry_point() -> Any:
    """Return the entry points of all groups. Looking for them reads a file of every installed package."""
    return entry_points()


@cache
def installed(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of one of the `GROUPS`."""
    return tuple(_every_entry_point().select(group=group))


def driver_names(group: str) -> tuple[str, ...]:
    """Return the names of the installed drivers of one of the `GROUPS`, in alphabetical order."""
    return tuple(sorted({entry.name for entry in installed(group)}))


def load_plugin(group: str, name: str) -> Plugin[Any]:
    """Load the driver of that name; of several packages that have one, the built-in one.

    Args:
        group: One of `GROUPS`.

    Raises:
        DriverNotFoundError: No driver has that name; the message lists those that exist and the likely one.
        DriverUnavailableError: A library that it needs is not installed.
        DriverError: The entry point names something that is not a driver.
    """
    matching = [*_built_in().select(group=group, name=name)]
    matching = matching or [entry for entry in installed(group) if entry.name == name]
    if not matching:
        raise DriverNotFoundError(_not_found(group, name))
    try:
        plugin = matching[0].load()
    except ImportError as error:
        raise DriverUnavailableError(
            f"the driver '{name}' needs a library that is not installed: {error}; install it and try again"
        ) from error
    except AttributeError as error:
        raise DriverError(f"the entry point '{name}' in {group} names something that is not there: {error}") from error
    if not isinstance(plugin, Plugin):
        raise DriverError(f"the entry point '{name}' in {group} names a {type(plugin).__name__}, not a Plugin")
    return plugin


def _not_found(group: str, name: str) -> str:
    names = driver_names(group)
    kind = group.removeprefix("stadimeter.").removesuffix("s")
    close = difflib.get_close_matches(name, names, n=1)
    guess = f"; did you mean '{close[0]}'?" if close else "."
    return f"no {kind} driver is called '{name}'{guess} There are: {', '.join(names) or 'none'}"
