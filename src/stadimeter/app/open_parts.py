"""Opening the parts of a run, and closing them: what moves is stopped first, whatever goes wrong on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from stadimeter.app.bootstrap import Parts
from stadimeter.app.ending import SETTLE_S, Deadline, Steps, close_side_by_side
from stadimeter.app.guard import Guard, StallWatch
from stadimeter.errors import DriverError, DriverUnavailableError


class EndedWhileOpening(BaseException):
    """The end was asked for while a device was being opened. No driver catches it: it is no `Exception`."""


class _Openable(Protocol):
    def open(self) -> None: ...

    def close(self) -> None: ...


@runtime_checkable
class _OpenedLater(Protocol):
    def open_later(self, error: DriverError) -> bool: ...


@dataclass(slots=True)
class OpenParts:
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
        self._watch(guard.start, guard.stop)
        if parts.recording_drives:
            watch = StallWatch(parts.driven, parts.clock, guard=guard)
            self._watch(watch.start, watch.stop)
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
        yield "camera", parts.capture


def _is_opened_later(part: _Openable, error: DriverError) -> bool:
    """Have a device that is not there opened again and again; return whether that makes sense."""
    if isinstance(error, DriverUnavailableError):
        return False
    return isinstance(part, _OpenedLater) and part.open_later(error)
