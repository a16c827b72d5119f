"""Drivers by name: how a configuration's ``driver = "buzzer"`` becomes a driver.

Every driver, built in or not, is an entry point in one of the `GROUPS` and names a class of `DriverOptions`. Only the
drivers that a configuration names are loaded, so a driver whose library is missing costs nothing until then.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, PackageNotFoundError, distribution, entry_points
from typing import Annotated, Any, ClassVar, Protocol, TypeVar, runtime_checkable

from msgspec import Struct, field
from pydantic import BaseModel, ConfigDict, Field

from stadimeter.config.findings import did_you_mean
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.clock import Clock
from stadimeter.errors import DriverError, DriverNotFoundError, DriverUnavailableError

SharedT = TypeVar("SharedT")

CAMERAS = "stadimeter.cameras"
DETECTORS = "stadimeter.detectors"
ACTUATORS = "stadimeter.actuators"
BASES = "stadimeter.bases"
SENSORS = "stadimeter.sensors"
BUTTONS = "stadimeter.buttons"
MESSENGERS = "stadimeter.messengers"
NOTIFIERS = "stadimeter.notifiers"
WORLDS = "stadimeter.worlds"
PORTS = "stadimeter.ports"
GROUPS = (CAMERAS, DETECTORS, ACTUATORS, BASES, SENSORS, BUTTONS, MESSENGERS, NOTIFIERS, WORLDS, PORTS)


# Each member costs as much as a single target: 64 balls take 10 ms a frame on a desktop computer.
MAX_SEVERAL = 64
Count = Annotated[int, Field(ge=1, le=MAX_SEVERAL)]


def numbered(count: int | None) -> tuple[str, ...]:
    """Return the numbers from 1 on, as texts; none without a count."""
    return tuple(str(number) for number in range(1, (count or 0) + 1))


class OptionsTable(BaseModel):
    """A table within the options of a driver. Unknown keys are errors, and numbers are finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


class DriverOptions(OptionsTable):
    """A driver as its entry point names it: the options of its table in the configuration, which build the driver.

    Fields that a person writes with a unit use the types of `stadimeter.config.units`; fields that name a pin or a
    serial port use `Pin` and `SerialPort`, so that two drivers on one of them are noticed.

    What else a driver can do, its options say by a method of one of the small protocols: those below, and those beside
    the interface of its kind, such as `stadimeter.detectors.protocol.ProposesColour`. They are asked by ``check`` and
    ``init`` on any computer, so they touch no hardware and do without the vendor's library.

    Attributes:
        needs_world: Whether it shows, knows or moves what is in a simulated world, which there must be then.
        needs_pixels: Of a detector, whether it looks for its target in pictures: ``check`` warns where that is small.
        only_turns: Of a base, whether it drives nowhere, such as a camera on a servo.
        emulator: Of a base, the port that emulates what it drives, where that is not ``emulated-`` and its name.
        title: Of a base or a detector, what it is, for `init` and the page.
        verb: Of an actuator, what it does when it acts, for descriptions.
        circuit: Of an output or a button, what hangs on its pin, for ``wiring``: ``motor`` (or another coil with its
            own supply), ``buzzer``, ``led``, ``relay`` (a board with an input), ``motor-driver`` or ``button``; empty
            for a 3.3 V signal.
    """

    written_elsewhere: ClassVar[dict[str, str]] = {}
    """Keys that people try here, and what to write in their place."""

    needs_world: ClassVar[bool] = False
    needs_pixels: ClassVar[bool] = True
    only_turns: ClassVar[bool] = False
    emulator: ClassVar[str] = ""
    title: ClassVar[str] = ""
    verb: ClassVar[str] = "drives"
    circuit: ClassVar[str] = ""

    @property
    def members(self) -> tuple[str, ...]:
        """The endings that tell apart several targets of one detector table: the targets are ``NAME-1`` and so on.

        Its detector is a `stadimeter.detectors.protocol.TracksSeveral`. Empty for one target.
        """
        return ()

    def build(self, context: DriverContext) -> Any:
        """Return the driver, without touching hardware."""
        raise NotImplementedError(f"{type(self).__name__} has no method `build`")


class Shared(Struct):
    """Objects that the drivers of one run share, such as the simulated world or one pin factory.

    Attributes:
        closers: What to call at the end of the run, last first.
    """

    parts: dict[str, Any] = field(default_factory=dict)
    closers: list[Callable[[], None]] = field(default_factory=list)


class DriverContext(Struct, frozen=True, kw_only=True):
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
        path: str = load_driver(PORTS, port)().build(self)
        return path


class SerialStop(Struct, frozen=True, kw_only=True):
    """A message that stops a device on a serial port from outside, when the program that drove it is gone.

    Attributes:
        port: A path below ``/dev``.
        frame: At most 64 bytes, which stop it also after a command of which only a part was sent.
    """

    port: str
    baud: int
    frame: bytes


class I2cStop(Struct, frozen=True, kw_only=True):
    """A write that stops a device on an I2C bus from outside, when the program that drove it is gone.

    Attributes:
        bus: The number N of ``/dev/i2c-N``.
        address: Of the device, 7 bits.
        writes: What to write, one transfer each, in this order: at most 16 of at most 32 bytes.
    """

    bus: int
    address: int
    writes: tuple[bytes, ...]


@runtime_checkable
class MaySimulate(Protocol):
    """A driver that may act in a simulated world only. A recording that drives anything else is watched closely."""

    def is_simulated(self) -> bool:
        """Check whether it does with these options."""
        ...


@runtime_checkable
class ReportsLacks(Protocol):
    """A driver that needs something of this computer, such as a library, a file or a device."""

    def lacks(self) -> tuple[str, ...]:
        """Return a sentence on each thing that is missing, which ``check`` warns of; touches no network."""
        ...


@runtime_checkable
class RefusesMotion(Protocol):
    """A camera whose frames nothing may move on with some options; see `Camera.not_for_motion`."""

    def refuse_motion(self) -> Mapping[str, str]:
        """Return the reason for each option that would have to be written."""
        ...


@runtime_checkable
class StatesLatency(Protocol):
    """A camera that knows from its options how old its frames are."""

    def frame_latency_s(self) -> float:
        """Return the age of a frame when it arrives, in seconds."""
        ...


@runtime_checkable
class StopsByBytes(Protocol):
    """An output on a serial port that bytes from outside stop. Pins need none: they are driven to their off level."""

    def serial_stop(self) -> SerialStop | None:
        """Return the message to send; None where nothing is there to be stopped."""
        ...


@runtime_checkable
class StopsByI2c(Protocol):
    """An output on an I2C bus that writes from outside stop."""

    def i2c_stop(self) -> I2cStop | None:
        """Return the message to write; None where nothing is there to be stopped."""
        ...


@runtime_checkable
class StopsByItself(Protocol):
    """A base that says whether it stops when this computer is gone."""

    @property
    def auto_stop_advice(self) -> str:
        """Advice on what makes that sooner, or what to do where nothing does, for ``check``."""
        ...

    def stops_by_itself_after_s(self) -> float:
        """Return the time it drives on when nothing comes any more, in seconds; infinity if for ever."""
        ...


class DriverChoice(Struct, frozen=True, kw_only=True):
    """A driver that a configuration names.

    Attributes:
        name: The part's name in the configuration, such as ``motor``.
        driver: The driver's name, such as ``vibration-motor``.
    """

    name: str
    driver: str
    options: DriverOptions

    @property
    def members(self) -> tuple[str, ...]:
        """The names of the targets that it stands for: its own, or of several of one kind ``balls-1`` and so on."""
        return tuple(f"{self.name}-{member}" for member in self.options.members) or (self.name,)

    @property
    def is_simulated(self) -> bool:
        """True if it acts in a simulated world only."""
        return isinstance(self.options, MaySimulate) and self.options.is_simulated()


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


def load_driver(group: str, name: str) -> type[DriverOptions]:
    """Load the driver of that name; of several packages that have one, the built-in one.

    Args:
        group: One of `GROUPS`.

    Raises:
        DriverNotFoundError: No driver has that name; the message lists those that exist and the likely one.
        DriverUnavailableError: A library that it needs is not installed, or its file has moved since the set-up.
        DriverError: The entry point names something that is not a driver.
    """
    matching = [*_built_in().select(group=group, name=name)]
    matching = matching or [entry for entry in installed(group) if entry.name == name]
    if not matching:
        raise DriverNotFoundError(_not_found(group, name))
    try:
        driver = matching[0].load()
    except ImportError as error:
        raise DriverUnavailableError(
            f"the driver '{name}' needs a library that is not installed: {error}; install it and try again"
        ) from error
    except AttributeError as error:
        raise DriverError(f"the entry point '{name}' in {group} names something that is not there: {error}") from error
    if not (isinstance(driver, type) and issubclass(driver, DriverOptions)):
        raise DriverError(f"the entry point '{name}' in {group} names {driver!r}, which is no class of DriverOptions")
    return driver


def _not_found(group: str, name: str) -> str:
    names = driver_names(group)
    kind = group.removeprefix("stadimeter.").removesuffix("s")
    guess = did_you_mean(name, names)
    return (
        f"no {kind} driver is called '{name}'{f'; {guess}' if guess else '.'} There are: {', '.join(names) or 'none'}"
    )
