"""The guard: watches over the outputs apart from the control loop.

It calls every output every 20 ms, so that a command whose frame has grown too old ends, even while the control loop
hangs in a camera or a detector. On a real clock each output has a thread of its own: one driver that hangs keeps no
other from stopping.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Protocol

from stadimeter.app.clock import MonotonicClock
from stadimeter.core.clock import Clock, TaskEndedError
from stadimeter.core.command import BaseReport, Command
from stadimeter.core.measurement import Track
from stadimeter.errors import DriverError

# One output of a run: its driver, the lease of its newest command, and whether it is in order -------------------------
#
# Every command carries the capture time of the frame that justifies it. When that frame is older than the lease,
# the output goes to its safe value, whatever the control loop is doing.
#
# An output is stopped in three ways: `check`, which the guard calls, ends a command whose frame is too old;
# `make_safe` puts it at its safe value until the next command; `retire` stops it for good, at the end of a run.
#
# A driver that failed is stopped. After a wait that grows with each failure it is closed and opened anew, as at the
# start of a run: whatever answers is identified, and stands. Then it keeps its safe value for `REST_S` more, with
# its fault changed to say so, for it may have been plugged in by someone whose hands are near its wheels. It takes
# commands again when that time has passed and the control loop has seen that fault. Opening may take seconds, so it
# runs beside everything else.

# A stop waits this long for a driver that is busy in another thread.
BUSY_WAIT_S = 0.2

# Closing waits this long.
CLOSE_WAIT_S = 1.0

# Before a driver that failed is opened again: the first wait, doubled each time, up to the longest.
FIRST_WAIT_S = 0.5
MAX_WAIT_S = 8.0

# A driver that was opened again stays at its safe value for this long.
REST_S = 3.0

# While its frame is fresh a command is sent again: some boards stand 100 ms after the last one, and a slow detector
# must not let their wheels stutter.
RESENT_EVERY_S = 0.05

RESTING = f"it answers again, and stays at its safe value for {REST_S:g} s before it may act"


class OutputDriver(Protocol):
    """The common part of an actuator and a base. `apply` takes and returns the kind of command that it understands."""

    def open(self) -> None:
        """Acquire the device, switched off or standing."""
        ...

    def apply(self, command: Any) -> Command:
        """Act as commanded and return what was really applied."""
        ...

    def tick(self, now_s: float) -> None:
        """Move patterns on, read what the device sent."""
        ...

    def stop(self) -> None:
        """Switch off or stand still at once."""
        ...

    def close(self) -> None:
        """Stop, then release the device."""
        ...


class LeasedOutput:
    """One actuator or base of a run. Its methods may be called from any thread.

    Args:
        lease_s: How old the frame behind a command may grow.
        stays_off: Whether a driver that failed stays off for the rest of the run.
    """

    def __init__(
        self, driver: OutputDriver, safe: Command, lease_s: float, clock: Clock, *, stays_off: bool = False
    ) -> None:
        self.name = safe.output
        self.safe = safe
        self.fault = ""
        # It stays at its safe value, whatever is commanded: while nothing would make it safe if this process died.
        self.is_held = False
        # Called when it was put at its safe value; from any thread, and must not wait.
        self.at_rest: Callable[[], None] = lambda: None
        self._driver = driver
        self._lease_s = lease_s
        self._clock = clock
        self._command = safe
        self._sent_s = -math.inf
        self._retired = False
        self._times_made_safe = 0
        self._was_opened = False
        self._stays_off = stays_off
        self._observed_fault = ""
        self._may_still_act = False
        self._wait_s = FIRST_WAIT_S
        self._in_order_since_s = -math.inf
        self._retry_at_s = 0.0
        self._rest_until_s: float | None = None
        self._end_opening: Callable[[], None] | None = None
        self._defect: BaseException | None = None
        # A signal may arrive while the control thread is in here, and its handler must get in as well.
        self._lock = threading.RLock()

    def open(self) -> None:
        """Acquire the device and put it at its safe value; `DriverError` if it cannot be acquired."""
        with self._lock:
            self._driver.open()
            self._driver.apply(self.safe)
            self._was_opened = True

    def open_later(self, error: DriverError) -> bool:
        """Go on after `open` has raised: the driver is opened again like one that failed while it ran.

        Returns whether it is: a driver that failed may have to stay off.
        """
        if self._stays_off:
            return False
        with self._lock:
            self._fail(error)
        return True

    def observed_fault(self) -> str:
        """Return why the driver is out of order, for the control loop: no fault ends before the loop has seen it."""
        self._observed_fault = fault = self.fault
        return fault

    def acts_since_s(self) -> float | None:
        """Return when the frame behind what it does now was captured; None at its safe value.

        Of a driver that failed and could not even be stopped, it is now: as long as this is asked, stopping it is tried
        again, and if it is asked no more, the watchdog process must do it.
        """
        if self.fault:
            return self._clock.now_s() if self._may_still_act else None
        return self._command.captured_at_s

    def report(self) -> BaseReport | None:
        """Return the last report of a robot base; None for an actuator, and for a base that is out of order."""
        told: Callable[[], BaseReport | None] | None = getattr(self._driver, "report", None)
        return None if told is None or self.fault else told()

    def apply(self, command: Command) -> Command | None:
        """Act as commanded, unless the frame behind the command is too old already: then the safe value is applied."""
        with self._lock:
            if self.fault or self._retired:
                return None
            was_acting = self._command.captured_at_s is not None
            self._command = self.safe if self.is_held or self._is_stale(command, self._clock.now_s()) else command
            self._sent_s = self._clock.now_s()
            try:
                applied = self._send()
                if was_acting and self._command.captured_at_s is None:
                    self.at_rest()  # at once: the cycle that commands this may take long yet
                return None if self._stopped_again() else applied
            except DriverError as error:
                self._fail(error)
                return None

    def show_targets(self, tracks: Iterable[Track]) -> None:
        """Pass on the targets that the newest frame has shown, where the driver wants them."""
        show: Callable[[Track], None] | None = getattr(self._driver, "show_target", None)
        if show is None:
            return
        with self._lock:
            try:
                for track in tracks:
                    if not self.fault and not self._retired:
                        show(track)
            except DriverError as error:
                self._fail(error)

    def _send(self) -> Command:
        before = self._times_made_safe
        applied = self._driver.apply(self._command)
        if self._times_made_safe != before:  # by a signal handler, within that call
            self._command = self.safe
            applied = self._driver.apply(self.safe)
        return applied

    def check(self, now_s: float) -> None:
        """End the newest command if its lease has run out, and let the driver move its patterns on.

        Does nothing while the driver is busy with a call of another thread: it must not be called twice at once.
        """
        if not self._lock.acquire(blocking=False):
            return
        try:
            self._check(now_s)
        finally:
            self._lock.release()

    def make_safe(self, wait_s: float = 0.0) -> bool:
        """Put it at its safe value, whatever was commanded last, or is being commanded by a caller of ours.

        Returns False if the driver was busy in another thread for so long: then nothing was done.
        """
        if not self._lock.acquire(timeout=wait_s):
            return False
        try:
            self._times_made_safe += 1
            self._command = self.safe
            if self._was_opened and not self.fault and not self._retired:
                self._driver.apply(self.safe)
            self.at_rest()
        except DriverError as error:
            self._fail(error)
        finally:
            self._lock.release()
        return True

    def forbid(self) -> None:
        """Let no later command move it. A call that is under way in its driver is followed by a stop. Never waits."""
        self._retired = True

    def _check(self, now_s: float) -> None:
        if self._defect is not None:
            defect, self._defect = self._defect, None
            raise defect
        if self._retired:
            self._repeat_stop(now_s)
        elif self.fault:
            self._recover(now_s)
        else:
            self._end_if_stale(now_s)

    def _end_if_stale(self, now_s: float) -> None:
        try:
            if self._is_stale(self._command, now_s):
                self._command = self.safe
                self._driver.apply(self.safe)
                self.at_rest()
            elif self.acts_since_s() is not None and not self.is_held and now_s - self._sent_s >= RESENT_EVERY_S:
                self._sent_s = max(self._sent_s + RESENT_EVERY_S, now_s - RESENT_EVERY_S)  # the mean rate holds
                self._send()
            self._driver.tick(now_s)
            self._stopped_again()
        except DriverError as error:
            self._fail(error)

    def retire(self, wait_s: float = BUSY_WAIT_S) -> None:
        """Stop for good: no later command moves it. Waits so long for a driver that is busy in another thread.

        Raises `DriverError` if the stop could not be sent, or the driver is still busy; then it is stopped when it
        comes back.
        """
        self._retired = True
        with self._free(wait_s):
            self._command = self.safe
            try:
                if not self._broke_off_opening():
                    self._driver.stop()
            finally:
                self.at_rest()

    def close(self) -> None:
        """Stop and release the device, even if the stop could not be sent; a busy driver is another `DriverError`."""
        self._retired = True
        with self._free(CLOSE_WAIT_S):
            if not self._broke_off_opening():
                self._driver.close()

    @contextmanager
    def _free(self, wait_s: float) -> Iterator[None]:
        if not self._lock.acquire(timeout=wait_s):
            raise DriverError("its driver is busy and does not come back; it is stopped as soon as it does")
        try:
            yield
        finally:
            self._lock.release()

    def _stopped_again(self) -> bool:
        """A signal handler may have retired the output while its driver was applying a command: stop it once more."""
        if self._retired:
            self._driver.stop()
        return self._retired

    def _repeat_stop(self, now_s: float) -> None:
        """Let the driver repeat a stop that was not acknowledged. Its fault is known already."""
        if self._end_opening is not None:
            return
        with suppress(DriverError):
            self._driver.tick(now_s)

    def _recover(self, now_s: float) -> None:
        if self._rest_until_s is not None:
            self._rest(now_s, self._rest_until_s)
        elif self._stays_off or now_s < self._retry_at_s:
            self._repeat_stop(now_s)
        elif self._end_opening is None:
            self._end_opening = self._clock.run_beside(self._open_again)

    def _open_again(self) -> None:
        """Close the driver and open it anew. Meanwhile no other thread calls it, and the lock is free."""
        is_open = False
        try:
            with suppress(DriverError):
                self._driver.close()
            with suppress(DriverError):
                self._driver.open()
                self._driver.apply(self.safe)
                is_open = self._was_opened = True
        except TaskEndedError:
            raise
        except BaseException as error:  # noqa: BLE001 - a defect in the driver; the next check raises it
            self._defect = error
        finally:
            with self._lock:
                self._opened_again(is_open=is_open)

    def _opened_again(self, *, is_open: bool) -> None:
        now_s, self._end_opening = self._clock.now_s(), None
        if self._retired:
            with suppress(DriverError):
                self._driver.close()
        elif is_open:
            self._may_still_act = False
            self.fault, self._rest_until_s = RESTING, now_s + REST_S
        else:
            self._retry_later(now_s)

    def _rest(self, now_s: float, until_s: float) -> None:
        """Command the safe value as the control loop would, until the time has passed and the loop knows."""
        try:
            self._driver.apply(self.safe)
            self._driver.tick(now_s)
        except DriverError as error:
            self._fail(error)
            return
        if not self._stopped_again() and now_s >= until_s and self._observed_fault == self.fault:
            self.fault, self._rest_until_s, self._command = "", None, self.safe
            self._in_order_since_s = now_s

    def _broke_off_opening(self) -> bool:
        """Check whether the driver is being opened. That ends now, closes the driver itself, and moved nothing."""
        if self._end_opening is None:
            return False
        self._end_opening()
        return True

    def _retry_later(self, now_s: float) -> None:
        """Wait for longer each time. Only a driver that was in order for a good while begins with the first wait."""
        self._retry_at_s = now_s + self._wait_s
        self._wait_s = min(2 * self._wait_s, MAX_WAIT_S)

    def _is_stale(self, command: Command, now_s: float) -> bool:
        return command.captured_at_s is not None and not now_s - command.captured_at_s <= self._lease_s

    def _fail(self, error: DriverError) -> None:
        now_s = self._clock.now_s()
        if now_s - self._in_order_since_s > MAX_WAIT_S:
            self._wait_s = FIRST_WAIT_S
        self._in_order_since_s, self._rest_until_s = math.inf, None
        self._retry_later(now_s)
        self.fault = str(error) or type(error).__name__
        try:
            self._driver.stop()
        except DriverError as second:
            self._may_still_act = True
            self.fault += f"; stopping it failed too: {second}"
        self.at_rest()


PERIOD_S = 0.02


class Guard:
    """Checks the outputs of a run again and again.

    Attributes:
        failure: A defect in a driver that came up here, a ``SystemExit`` too: it would end the thread of the guard
            without a word. The loop raises it. None if all is well.
    """

    def __init__(self, outputs: Sequence[LeasedOutput], clock: Clock) -> None:
        self.failure: BaseException | None = None
        self._outputs = outputs
        self._clock = clock
        self._cancels: list[Callable[[], None]] = []

    def start(self) -> None:
        """Begin to watch."""
        self._cancels = [self._clock.call_every(PERIOD_S, partial(self._check, output)) for output in self._outputs]

    def _check(self, output: LeasedOutput, now_s: float) -> None:
        try:
            output.check(now_s)
        except BaseException as error:  # noqa: BLE001 - whatever it is, the outputs must stop; the loop reports it
            self.fail(error)

    def fail(self, error: BaseException) -> None:
        """Stop every output for good, for a defect that the loop raises."""
        self.failure = self.failure or error
        retire_all(self._outputs)

    def end_watching(self) -> None:
        """Cease to watch. May be called any number of times."""
        for cancel in self._cancels:
            cancel()
        self._cancels = []


def make_all_safe(outputs: Sequence[LeasedOutput]) -> list[str]:
    """Put every output at its safe value, busy ones last; return which of them are not, in words."""
    busy = [output for output in outputs if not output.make_safe()]
    until_s = time.monotonic() + BUSY_WAIT_S
    left = [output for output in busy if not output.make_safe(max(0.0, until_s - time.monotonic()))]
    return [f"{output.name}: its driver is busy and does not come back" for output in left]


def retire_all(outputs: Sequence[LeasedOutput]) -> list[str]:
    """Stop every output for good, each one whatever becomes of the others, busy ones last; return what went wrong."""
    for output in outputs:
        output.forbid()
    busy = [output for output in outputs if _retired(output, 0.0)]
    until_s = time.monotonic() + BUSY_WAIT_S  # for all of them: one after the other, many would take long
    tried = [(output.name, _retired(output, max(0.0, until_s - time.monotonic()))) for output in busy]
    return [f"{name}: {trouble}" for name, trouble in tried if trouble]


def _retired(output: LeasedOutput, wait_s: float) -> str:
    """Stop one output for good; return what went wrong."""
    try:
        output.retire(wait_s)
    except DriverError as error:
        return str(error)
    except BaseException as error:  # noqa: BLE001 - a defect in one driver must not keep the next from stopping
        return f"{type(error).__name__}: {error}"
    return ""


LOOK_EVERY_S = 0.05
STALLED_AFTER_S = 0.5


class StallWatch:
    """Puts outputs at their safe values while a stepped clock stands still.

    Args:
        guard: Stops every output for a defect that comes up here.
    """

    def __init__(
        self, outputs: Sequence[LeasedOutput], clock: Clock, real_clock: Clock | None = None, guard: Guard | None = None
    ) -> None:
        self._outputs = outputs
        self._guard = guard or Guard(outputs, clock)
        self._clock = clock
        self._real_clock = real_clock or MonotonicClock()
        self._seen_s = clock.now_s()
        self._moved_at_s = self._real_clock.now_s()
        self._cancel: Callable[[], None] | None = None

    def start(self) -> None:
        """Begin to watch."""
        self._cancel = self._real_clock.call_every(LOOK_EVERY_S, self.step)

    def step(self, real_s: float) -> None:
        """Look once."""
        now_s = self._clock.now_s()
        if now_s != self._seen_s:
            self._seen_s, self._moved_at_s = now_s, real_s
        elif real_s - self._moved_at_s > STALLED_AFTER_S:
            for output in self._outputs:
                self._make_safe(output)

    def _make_safe(self, output: LeasedOutput) -> None:
        try:
            output.make_safe()
        except BaseException as error:  # noqa: BLE001 - as in the guard
            self._guard.fail(error)

    def end_watching(self) -> None:
        """Cease to watch. May be called any number of times."""
        if self._cancel is not None:
            self._cancel()
            self._cancel = None
