"""The parts of a run: built from a checked configuration (the only place that builds drivers), opened, and closed.

What moves is stopped first, whatever goes wrong on the way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Protocol

from msgspec import Struct, field

from stadimeter.app.capture import Capture, SecondCapture, capture_for
from stadimeter.app.clock import MonotonicClock, SteppedClock
from stadimeter.app.cycle import Cycle
from stadimeter.app.ending import SETTLE_S, Deadline, Steps, close_side_by_side
from stadimeter.app.guard import Guard, LeasedOutput, StallWatch
from stadimeter.app.panel import PushButton, StatusLed
from stadimeter.app.range_reader import RangeReader
from stadimeter.cameras.protocol import Camera, ShowsOwnMotion
from stadimeter.config.loader import DEMONSTRATION, Configuration, DriverChoice, load_configuration
from stadimeter.config.plugins import DriverContext, Shared
from stadimeter.core.clock import Clock
from stadimeter.core.outputs import safe_command
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import ConfigError, DriverError, DriverUnavailableError, Problem
from stadimeter.messaging.protocol import Messenger, Notifier
from stadimeter.perception.picture_flow import FlowMeter

if TYPE_CHECKING:  # most runs have no tags of known places, and one camera
    from stadimeter.core.camera_model import CameraModel
    from stadimeter.perception.prediction import CameraLocator


class StagedWorld(Protocol):
    """A world in which things can be made to go wrong, and which says what happens."""

    def narration(self) -> str:
        """Return in a sentence what happens now; an empty string if there is nothing to say."""
        ...

    def state(self) -> Mapping[str, Any]:
        """Return where things are, and what goes wrong, for a view from above.

        Returns:
            ``targets`` and ``camera`` with ``x_m`` to the east and ``y_m`` to the north, the camera with its
            ``heading_rad`` counter-clockwise from east; ``faults``: by kind, whether it is there now.
        """
        ...

    def goes_wrong(self, fault: str) -> bool:
        """Check whether a fault is there now.

        Args:
            fault: Its kind, as in the schedule of a configuration: such as ``hide-target``.
        """
        ...

    def toggle(self, fault: str) -> None:
        """Make something go wrong, or put it right again; `ValueError` if there is no such fault."""
        ...

    def place_target(self, x_m: float, y_m: float) -> None:
        """Have the target go there and stay. Many places a second draw a path."""
        ...

    def in_world_m(self, bearing_rad: float, distance_m: float) -> tuple[float, float]:
        """Return where a target is that the camera would see there now.

        Args:
            bearing_rad: Positive to the right.
            distance_m: From the camera to the target's centre.
        """
        ...

    def let_go(self) -> None:
        """Have the target go on along its path."""
        ...


class Parts(Struct, kw_only=True):
    """The parts of a run, built and not yet opened.

    Attributes:
        configuration: What they were built from.
        capture: Where frames come from.
        outputs: The outputs, in the order of the plan.
        messenger: Sends messages to other programs; None for none.
        notifiers: Notify people, by name.
        cycle: One cycle of the loop.
        shared: What the drivers share; its closers are called at the end.
        is_live: Whether the camera delivers frames at its own pace, on the computer's clock.
        recording_drives: The names of real outputs that a recording or a simulation drives; none for a live camera.
        world: The simulated world; None for none.
        status_led: Shows how the run is doing; None for nothing.
        buttons: The push buttons, by name.
    """

    configuration: Configuration
    clock: Clock
    capture: Capture
    outputs: tuple[LeasedOutput, ...]
    messenger: Messenger | None
    cycle: Cycle
    shared: Shared = field(default_factory=Shared)
    recording_drives: tuple[str, ...] = ()
    is_live: bool = False
    notifiers: Mapping[str, Notifier] = field(default_factory=dict)
    world: StagedWorld | None = None
    status_led: StatusLed | None = None
    buttons: Mapping[str, PushButton] = field(default_factory=dict)

    @property
    def driven(self) -> tuple[LeasedOutput, ...]:
        """Everything that must be stopped: the outputs of the plan, and the status LED."""
        return (*self.outputs, self.status_led) if self.status_led is not None else self.outputs


def build(configuration: Configuration, speed: float | None = 1.0, *, clock: Clock | None = None) -> Parts:
    """Build the parts of a run. Touches no hardware.

    A camera that delivers frames at its own pace runs on the computer's clock. Recordings and simulations run on a
    stepped clock, on which each run is the same.

    Args:
        speed: How fast recordings and simulations run: 1 is real time, None as fast as the computer can.
        clock: The stepped clock of recordings and simulations; None for one of that speed.

    Raises:
        ConfigError: The configuration lacks a camera model.
        DriverError: A driver cannot be built.
    """
    if configuration.camera_model is None:
        raise ConfigError([_no_camera_model(configuration)])
    clock = clock or SteppedClock(speed=speed)
    builder = _Builder(configuration, clock)
    camera: Camera = builder.build(configuration.camera)
    if camera.is_live:
        clock = MonotonicClock()
        builder = _Builder(configuration, clock)
        camera = builder.build(configuration.camera)
    outputs = builder.outputs()
    capture = capture_for(camera, clock)
    detectors = builder.detectors(configuration.camera_model)
    range_readers = builder.range_readers()
    messenger: Messenger | None = builder.build(configuration.messenger) if configuration.messenger else None
    notifiers: dict[str, Notifier] = {each.name: builder.build(each) for each in configuration.notifiers}
    cycle = Cycle(
        clock=clock,
        capture=capture,
        camera_model=configuration.camera_model,
        detectors=detectors,
        outputs=outputs,
        max_frame_age_s=configuration.plan.safety.max_frame_age_s,
        range_readers=range_readers,
        footings=configuration.footings,
        flow_meter=FlowMeter() if _is_liveness_judged(configuration, camera) else None,
        locator=locator_of(configuration),
        **_second_camera(configuration, builder),
    )
    return Parts(
        configuration=configuration,
        clock=clock,
        capture=capture,
        outputs=outputs,
        messenger=messenger,
        notifiers=notifiers,
        cycle=cycle,
        shared=builder.shared,
        is_live=camera.is_live,
        recording_drives=()
        if camera.is_live
        else tuple(each.name for each in _driven(configuration) if not each.is_simulated),
        world=builder.world,
        status_led=builder.status_led(),
        buttons=builder.buttons(),
    )


def locator_of(configuration: Configuration) -> CameraLocator | None:
    """Build what finds where the camera is; None for a configuration without tags of known places."""
    if configuration.landmarks is None:
        return None
    from stadimeter.perception.prediction import CameraLocator  # noqa: PLC0415 - most runs have no such tags

    choice = configuration.drivers["landmarks",]
    context = DriverContext(name=choice.name, clock=SteppedClock(), camera_model=configuration.camera_model)
    return CameraLocator(configuration.landmarks, choice.options.build(context), configuration.plan.viewpoint)


def _second_camera(configuration: Configuration, builder: _Builder) -> dict[str, Any]:
    """Return the things a cycle needs of a second camera, by its attributes; nothing where there is none."""
    choice, rig = configuration.second_camera, configuration.rig
    if choice is None or rig is None:
        return {}
    from stadimeter.perception.second_camera import SecondView  # noqa: PLC0415 - most runs have one camera

    second = SecondCapture(capture_for(builder.build(choice, rig.right), builder.clock), builder.clock)
    return {"second": second, "second_view": SecondView(rig, builder.detectors(rig.right))}


def _is_liveness_judged(configuration: Configuration, camera: Camera) -> bool:
    """Check whether the picture must show that the base drives."""
    if configuration.base is None or not configuration.plan.safety.liveness:
        return False
    return camera.is_live or (isinstance(camera, ShowsOwnMotion) and camera.shows_own_motion)


def _driven(configuration: Configuration) -> list[DriverChoice]:
    return [*configuration.actuators, *([configuration.base] if configuration.base is not None else [])]


class _Builder:
    """Builds drivers that share one clock and one world."""

    def __init__(self, configuration: Configuration, clock: Clock) -> None:
        self.shared = Shared()
        self._configuration = configuration
        self.clock = clock
        self.world: StagedWorld | None = self.build(configuration.world) if configuration.world is not None else None

    def build(self, choice: DriverChoice, lens: CameraModel | None = None) -> Any:
        context = DriverContext(
            name=choice.name,
            clock=self.clock,
            camera_model=lens or self._configuration.camera_model,
            shared=self.shared,
        )
        return choice.options.build(context)

    def detectors(self, lens: CameraModel) -> dict[str, Detector]:
        """Build the detector of each target; several of one kind share one."""
        made: dict[str, Detector] = {}
        for target in self._configuration.targets:
            made |= dict.fromkeys(target.members, self.build(target, lens))
        return made

    def outputs(self) -> tuple[LeasedOutput, ...]:
        choices = {choice.name: choice for choice in _driven(self._configuration)}
        return tuple(
            LeasedOutput(
                self.build(choices[output.name]),
                safe_command(output),
                self._configuration.leases_s[output.name],
                self.clock,
                stays_off=output.name in self._configuration.stays_off,
            )
            for output in self._configuration.plan.outputs
        )

    def status_led(self) -> StatusLed | None:
        choice = self._configuration.status_led
        if choice is None:
            return None
        return StatusLed(self.build(choice), choice.name, self.clock)

    def range_readers(self) -> tuple[RangeReader, ...]:
        tables = self._configuration.sensor_tables
        return tuple(
            RangeReader(choice.name, self.build(choice), tables[choice.name], self.clock)
            for choice in self._configuration.sensors
        )

    def buttons(self) -> dict[str, PushButton]:
        tables = self._configuration.button_tables
        return {
            choice.name: PushButton(self.build(choice), choice.name, tables[choice.name], self.clock)
            for choice in self._configuration.buttons
        }


def _no_camera_model(configuration: Configuration) -> Problem:
    return Problem(
        "there is no camera model, so no distance can be measured",
        file=str(configuration.path),
        key="camera.model",
        hint="make one with `stadimeter calibrate distance PICTURE@DISTANCE … -o camera.toml` and name it here",
        code="camera-model-missing",
    )


def demo_configuration() -> Configuration:
    """Load the configuration of the demonstration."""
    return load_configuration(DEMONSTRATION)


class EndedWhileOpening(BaseException):
    """The end was asked for while a device was being opened. No driver catches it: it is no `Exception`."""


class _Openable(Protocol):
    def open(self) -> None: ...

    def close(self) -> None: ...


class OpenParts(Struct):
    """The parts of a run, from when they are opened until they are closed.

    Attributes:
        is_over: Returns whether the end of the run was asked for.
        messenger_opened: Called when there is one and it is open, while the other parts are still to be opened.
    """

    parts: Parts
    is_over: Callable[[], bool]
    messenger_opened: Callable[[], None] = lambda: None
    _is_opening: bool = False
    _lanes: dict[str, Steps] = field(default_factory=dict)

    def open(self, *, in_service: bool) -> Guard:
        """Open everything; what is open is closed again by `close`, even if a later part cannot be opened.

        Args:
            in_service: Whether a device that is not there is opened again and again, where that makes sense.

        Raises:
            DriverError: A device could not be opened; the message names every one that could not.
            EndedWhileOpening: The end was asked for.
        """
        parts = self.parts
        failures: list[str] = []
        for name, part in self._openable():
            lane = "outputs" if part in parts.driven else name
            self._lanes.setdefault(lane, []).append((name, part.close))
            try:
                self._is_opening = True
                if self.is_over():  # the end was asked for before, or between two parts
                    raise EndedWhileOpening
                part.open()
                if part is parts.messenger:
                    self.messenger_opened()
            except DriverError as error:
                if not (in_service and _is_opened_later(part, error)):
                    failures.append(f"{name}: {error}")
            finally:
                self._is_opening = False
        if failures:
            raise DriverError("\n".join(failures))
        return self._guarded()

    def break_off(self) -> None:
        """Break off the opening that is under way, if one is: raises `EndedWhileOpening` in the thread that opens."""
        if self._is_opening:
            self._is_opening = False
            raise EndedWhileOpening

    def close(self, deadline: Deadline) -> list[str]:
        """Close what was opened, side by side; return what went wrong, in words."""
        return close_side_by_side(self._lanes, deadline, keep_s=0.45)

    def close_shared(self, deadline: Deadline) -> list[str]:
        """Close what the parts share, after all of them; return what went wrong, in words."""
        shared: Steps = [("shared part", close) for close in self.parts.shared.closers]
        return close_side_by_side({"shared": shared}, deadline, keep_s=0.2)

    def _guarded(self) -> Guard:
        parts = self.parts
        guard = Guard(parts.driven, parts.clock)
        self._watch(guard.start, guard.end_watching)
        if parts.recording_drives:
            watch = StallWatch(parts.driven, parts.clock, guard=guard)
            self._watch(watch.start, watch.end_watching)
        self._lanes.setdefault("outputs", []).append(("guard", self._settle))
        return guard

    def _watch(self, start: Callable[[], None], stop: Callable[[], None]) -> None:
        start()
        self._lanes.setdefault("outputs", []).append(("guard", stop))

    def _settle(self) -> None:
        self.parts.clock.sleep_until_s(self.parts.clock.now_s() + SETTLE_S)

    def _openable(self) -> Iterator[tuple[str, _Openable]]:
        """Yield what must be opened, by name: the camera last, so that everything is ready for its first frame."""
        parts = self.parts
        if parts.messenger is not None:
            yield "messenger", parts.messenger
        yield from parts.notifiers.items()
        for output in parts.driven:
            yield output.name, output
        yield from ((f"button {name}", button) for name, button in parts.buttons.items())
        yield from ((f"sensor {reader.name}", reader) for reader in parts.cycle.range_readers)
        if (second := parts.cycle.second) is not None:
            yield "second camera", second
        yield "camera", parts.capture


def _is_opened_later(part: _Openable, error: DriverError) -> bool:
    """Have a device that is not there opened again and again; return whether that makes sense."""
    open_later: Callable[[DriverError], bool] | None = getattr(part, "open_later", None)
    return open_later is not None and not isinstance(error, DriverUnavailableError) and open_later(error)
