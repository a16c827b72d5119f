"""The one shape of rig that every contract suite takes: a driver, the wire behind it, and a way to make it fail.

A suite is a class. Subclass it with a fixture ``make_rig`` that returns a function; each call of that function builds
a new driver, not opened, and wraps it in the suite's kind of rig::

    class TestMyActuator(ActuatorContract):
        @pytest.fixture
        def make_rig(self) -> Callable[[], ActuatorRig]:
            return my_rig

A rig never asks the driver what it does. It looks at the wire: the pin, the file, the port, the service.
"""

from __future__ import annotations

import os
import time
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any, ClassVar, Generic, TypeVar

import pytest
from msgspec import Struct, field

from stadimeter.app.clock import SteppedClock
from stadimeter.core.command import Command
from stadimeter.errors import DriverError

DeviceT = TypeVar("DeviceT")
ResultT = TypeVar("ResultT")

# The runtime ticks its outputs this often.
TICK_S = 0.02

# One slow call may be the fault of a busy computer; this many in a row are the driver's.
SLOW_CALL_S = 0.05
SLOW_IN_A_ROW = 3

# Begins with True and ends with False.
Fault = Callable[[bool], None]


class ManualClock(SteppedClock):
    """A clock that a test moves."""

    def advance_s(self, seconds: float) -> None:
        """Move the clock on, calling on the way whatever is due."""
        self.sleep_until_s(self.now_s() + seconds)


def eventually(condition: Callable[[], ResultT], within_s: float = 120.0) -> ResultT:
    """Wait until a condition returns something true, else raise `AssertionError`.

    Args:
        within_s: How long a condition that never comes true is waited for. It is no measurement: a machine at load 20
            takes ten times as long for everything.
    """
    until_s = time.monotonic() + within_s
    while not (result := condition()):
        assert time.monotonic() < until_s, f"this did not become true within {within_s:g} s: {result!r}"
        time.sleep(0.005)
    return result


def impossible(reason: str) -> Fault:
    """Return a fault that the device cannot have: the tests that need it are skipped, with the reason."""

    def skip(begins: bool) -> None:
        if begins:
            pytest.skip(reason)

    return skip


class Rig(Struct, Generic[DeviceT], frozen=True, kw_only=True, eq=False):
    """A driver and its device.

    Attributes:
        device: The driver, built but not opened.
        faults: For each fault that the suite names, a function that begins it (True) and ends it (False); or
            `impossible` with the reason. A fault that is left out fails the tests that need it.
        patience_s: How long `eventually` waits, in real seconds: for a slow computer, not for a slow driver.
    """

    device: DeviceT
    faults: Mapping[str, Fault]
    patience_s: float = 20.0
    _slow_in_a_row: Counter[str] = field(default_factory=Counter)

    def begin(self, fault: str) -> None:
        """Let something go wrong."""
        self._fault(fault)(True)

    def end(self, fault: str) -> None:
        """Let it come right again."""
        self._fault(fault)(False)

    def eventually(self, condition: Callable[[], ResultT]) -> ResultT:
        """Wait until another thread or program has made something true, and return it."""
        return eventually(condition, self.patience_s)

    def timed(self, method: str, *args: object) -> Any:
        """Call a method of the driver that must return at once, and fail the test if it does not."""
        begun_s = time.perf_counter()
        result = getattr(self.device, method)(*args)
        took_s = time.perf_counter() - begun_s
        # With more to do than a computer has cores, each call takes so many times as long through no fault of its own.
        limit_s = SLOW_CALL_S * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))
        self._slow_in_a_row[method] = self._slow_in_a_row[method] + 1 if took_s > limit_s else 0
        if self._slow_in_a_row[method] == SLOW_IN_A_ROW:
            pytest.fail(
                f"{type(self.device).__qualname__}.{method}() is too slow: {SLOW_IN_A_ROW} calls in a row took more "
                f"than {limit_s * 1e3:.0f} ms, the last one {took_s * 1e3:.0f} ms. The control loop calls it, and "
                "must never wait: leave waiting to a thread, or look again at the next tick"
            )
        return result

    def _fault(self, fault: str) -> Fault:
        if fault not in self.faults:
            pytest.fail(
                f"the rig does not say how to cause the fault {fault!r}: add it to `faults`, or `impossible(reason)` "
                "if the device cannot have it"
            )
        return self.faults[fault]


class OutputRig(Rig[DeviceT], frozen=True, kw_only=True):
    """An actuator or a base with its device.

    Attributes:
        clock: The clock that the driver was given. Its device lives on it too.
        is_held: Whether the device is taken (a pin reserved, a port locked), seen from outside of the driver.
    """

    clock: ManualClock
    is_held: Callable[[], bool]
    settles_s: ClassVar[float]
    """Time that the device may take to come to rest after a stop."""

    @abstractmethod
    def rests(self) -> bool:
        """Check whether the device is off or stands, seen on the wire."""

    @abstractmethod
    def act(self) -> Command:
        """Command something that is plain to see on the wire, and return what was applied."""

    def comes_to_rest(self) -> bool:
        """Check whether the device rests after the time that it may take, without any call of the driver."""
        self.clock.advance_s(self.settles_s)
        return self.rests()

    def tick(self) -> None:
        """Tick the driver as the runtime does."""
        self.timed("tick", self.clock.now_s())

    def pass_time_s(self, seconds: float, each_tick: Callable[[], object] = lambda: None) -> None:
        """Let time pass with ticks, and call ``each_tick`` after each of them."""
        for _ in range(round(seconds / TICK_S)):
            self.clock.advance_s(TICK_S)
            self.tick()
            each_tick()


class Contract:
    """The base of every contract suite: rigs of the driver under test."""

    @pytest.fixture
    def make_rig(self) -> Callable[[], Any]:
        """Return a function that builds a new rig. Override it."""
        raise NotImplementedError(f"override the fixture make_rig in {type(self).__name__}")

    @pytest.fixture
    def rig(self, make_rig: Callable[[], Any]) -> Any:
        """Return a rig that is not open."""
        return make_rig()

    @pytest.fixture
    def opened(self, rig: Any) -> Iterator[Any]:
        """Open a rig, and close it at the end."""
        rig.device.open()
        yield rig
        with suppress(DriverError):
            rig.device.close()
