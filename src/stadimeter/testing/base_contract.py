"""The contract of every robot base: subclass it with a fixture ``make_rig``, as `stadimeter.testing.rig` shows."""

from __future__ import annotations

import fcntl
import math
import os
import select
from collections.abc import Callable
from contextlib import suppress
from typing import ClassVar

import pytest
from msgspec.structs import replace

from stadimeter.bases.protocol import MobileBase
from stadimeter.core.command import TwistCommand
from stadimeter.errors import LinkLostError
from stadimeter.simulation.emulated_base import EmulatedPort
from stadimeter.testing.output_contract import OutputContract
from stadimeter.testing.rig import OutputRig

UNPLUGGED, SILENT, TAKES_NO_BYTES = FAULTS = ("unplugged", "silent", "takes no bytes")

STANDING_MPS = 1e-3
STANDING_RADPS = 1e-2
LOOP_S = 0.04
LOST_WITHIN_S = 1.0

# A kernel moves bytes from the buffer that is written into another one, and then has room once more: by a worker of its
# own, which on a busy machine (load 7) was once not there after 200 ms.
MOVED_ON_WITHIN_MS = 500


class BaseRig(OutputRig[MobileBase], frozen=True, kw_only=True):
    """A base with its counterpart, real or emulated.

    Its faults are `UNPLUGGED` (the port is gone), `SILENT` (bytes are taken, nothing is answered) and
    `TAKES_NO_BYTES` (the port is full).

    Attributes:
        motion: How the robot really moves now: speed forwards in m/s, rate of turn in rad/s, positive to the left.
    """

    motion: Callable[[], tuple[float, float]]
    settles_s: ClassVar[float] = 1.0

    def twist(self, linear_mps: float, angular_radps: float) -> TwistCommand:
        """Return a command that a frame of this moment justifies."""
        return TwistCommand(
            output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=self.clock.now_s()
        )

    def drive(self, linear_mps: float, angular_radps: float, seconds: float = 1.0) -> TwistCommand:
        """Command a motion again and again as the loop does, and return what was applied last."""
        for _ in range(math.ceil(seconds / LOOP_S)):
            applied: TwistCommand = self.timed("apply", self.twist(linear_mps, angular_radps))
            self.pass_time_s(LOOP_S)
        return applied

    def act(self) -> TwistCommand:
        """Drive forwards for a second."""
        return self.drive(0.2, 0.0)

    def rests(self) -> bool:
        """Check whether the robot really stands."""
        linear_mps, angular_radps = self.motion()
        return abs(linear_mps) < STANDING_MPS and abs(angular_radps) < STANDING_RADPS


class BaseContract(OutputContract):
    """The tests. The base must be able to drive at 0.2 m/s and to turn at 1 rad/s, and not to drive at 20 m/s.

    Attributes:
        tilts: Whether it tilts its camera.
    """

    tilts: ClassVar[bool] = False

    @pytest.fixture(params=FAULTS)
    def opening_fault(self, request: pytest.FixtureRequest) -> str:
        """Return each fault that keeps the base from being opened: one that does not answer must not open either."""
        return str(request.param)

    @pytest.fixture(params=FAULTS)
    def fault(self, request: pytest.FixtureRequest) -> str:
        """Return each fault that may come up in use."""
        return str(request.param)

    @pytest.mark.parametrize("motion", [(0.2, 0.0), (-0.2, 0.0), (0.0, 1.0), (0.0, -1.0), (0.2, -0.5)])
    def test_it_moves_as_reported_and_about_as_commanded(self, opened: BaseRig, motion: tuple[float, float]) -> None:
        applied = opened.drive(*motion)
        assert (applied.linear_mps, applied.angular_radps) == pytest.approx(motion, rel=0.05, abs=0.02)
        assert opened.motion() == pytest.approx((applied.linear_mps, applied.angular_radps), rel=0.02, abs=1e-3)

    def test_speeds_that_move_it_alike_are_reported_alike(self, opened: BaseRig) -> None:
        """A driver that rounds and reports what was asked for is found by two speeds that become one on the wire."""
        reported: dict[tuple[float, float], set[tuple[float, float]]] = {}
        for speed_mps in (0.2, 0.2 + 1e-6, 0.2 + 1e-4):
            applied = opened.drive(speed_mps, 0.0, 2.0)
            reported.setdefault(opened.motion(), set()).add((applied.linear_mps, applied.angular_radps))
        twice = {moves: answers for moves, answers in reported.items() if len(answers) > 1}
        assert not twice, "the robot moves the same, but different speeds are reported: return what was sent"

    def test_too_fast_a_command_is_limited_and_the_answer_shows_it(self, opened: BaseRig) -> None:
        applied = opened.drive(20.0, 0.0)
        assert 0.2 <= applied.linear_mps < 20.0
        assert opened.motion()[0] == pytest.approx(applied.linear_mps, rel=0.02)

    def test_a_tilt_is_applied_only_where_the_camera_tilts(self, opened: BaseRig) -> None:
        command = replace(opened.twist(0.2, 0.0), tilt_radps=0.2)
        applied = opened.device.apply(command)
        assert applied.tilt_radps == 0.0 or self.tilts
        assert (applied.output, applied.captured_at_s) == (command.output, command.captured_at_s)

    def test_a_command_of_zero_and_a_stop_end_a_turn_too(self, opened: BaseRig) -> None:
        opened.drive(0.2, 1.0)
        applied = opened.device.apply(TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0))
        assert (applied.linear_mps, applied.angular_radps) == (0.0, 0.0)
        opened.pass_time_s(1.0)
        assert opened.rests()
        opened.drive(0.2, 1.0)
        opened.device.stop()
        opened.pass_time_s(1.0)
        assert opened.rests()

    def test_a_lost_connection_is_noticed_by_ticks_alone(self, opened: BaseRig, fault: str) -> None:
        """A stop that is not answered counts as well as a command, and is waited for while nothing else is sent."""
        opened.act()
        opened.begin(fault)
        with pytest.raises(LinkLostError):  # noqa: PT012 - either may notice it
            opened.device.stop()
            opened.pass_time_s(LOST_WITHIN_S)

    def _use(self, rig: OutputRig[MobileBase]) -> None:
        """Drive until silence must have been noticed."""
        assert isinstance(rig, BaseRig)
        rig.drive(0.2, 0.0, LOST_WITHIN_S)


def is_locked(path: str) -> bool:
    """Check whether some program holds the serial port at ``path`` for itself alone."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def clog(port: EmulatedPort, *, begins: bool) -> None:
    """Begin or end the fault that a port takes no more bytes: nothing is read at the board's end, and it is full.

    A kernel moves bytes from the buffer that is written into the one that is read by a worker of its own, and then has
    room once more: on a busy machine that may be late, so the port is filled again at each service, too.
    """
    port.is_full = begins
    if not begins:
        return
    descriptor = os.open(port.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    room = select.poll()
    room.register(descriptor, select.POLLOUT)
    while room.poll(MOVED_ON_WITHIN_MS):
        with suppress(BlockingIOError):
            while True:
                os.write(descriptor, b"\n" * 64)  # firmware passes over empty lines
    os.close(descriptor)
