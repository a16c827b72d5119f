"""Bases at the end of a line that carries fewer bytes than the loop sends, in the hands of the run's outputs."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import pytest
from msgspec import Struct

from stadimeter.app.guard import Guard, LeasedOutput
from stadimeter.bases.protocol import DOUBTED_AFTER_S
from stadimeter.bases.serial_base import STANDING, SerialLink
from stadimeter.config.plugins import BASES, load_driver
from stadimeter.core.command import TwistCommand
from stadimeter.errors import DriverError
from stadimeter.testing.rig import ManualClock
from support.base_bench import base_bench, opened

STEP_S = 0.01
FRAME_STEPS = 3
RATES = (200, 150, 100, 50, 20)

# By the emulated board: the driver, and its table.
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "ros-arduino-bridge": ("ros-arduino-bridge", {"wheel_diameter": "65 mm", "ticks_per_turn": 1440}),
    "roboclaw": ("roboclaw", {"wheel_diameter": "65 mm", "ticks_per_turn": 1440}),
    "waveshare-ugv": ("waveshare-ugv", {}),
    "hoverboard": ("hoverboard", {"full_speed": "1 m/s"}),
    "sabertooth": ("sabertooth", {"full_speed": "1 m/s"}),
    "roomba": ("roomba", {}),
    "openbot": (
        "ascii",
        {
            "drive": "h500\nc{left:d},{right:d}\n",
            "stop": "c0,0\n",
            "question": "f\n",
            "answers": {"identity": "f[A-Z].*", "battery": "v([0-9.]+)"},
            "full_speed": "0.8 m/s",
            "auto_stop": "500 ms",
        },
    ),
}


class SlowLine:
    """An adapter or a radio: it takes and keeps all that comes, and carries so many bytes a second to the board."""

    newest: SlowLine

    def __init__(self, clock: ManualClock) -> None:
        SlowLine.newest = self
        self.bytes_a_second = math.inf
        self.waiting = b""
        self._clock = clock
        self._carried_at_s = 0.0

    def __call__(self, data: bytes) -> bytes:
        """Take what the host has sent, and return what has come through to the board by now."""
        self.waiting += data
        now_s, count = self._clock.now_s(), len(self.waiting)
        if self.bytes_a_second < math.inf:
            count = min(count, int((now_s - self._carried_at_s) * self.bytes_a_second + 1e-6))
        # A line that has nothing to carry saves no time up.
        is_idle = count == len(self.waiting)
        self._carried_at_s = now_s if is_idle else self._carried_at_s + count / self.bytes_a_second
        carried, self.waiting = self.waiting[:count], self.waiting[count:]
        return carried


class Outcome(Struct, frozen=True):
    """What came of a line that became slow while a robot drove.

    Attributes:
        fault: What the first fault said; empty if none came.
        fault_s: How long after the line had become slow it came; infinity for never.
        driven_s: How long motors were driven after the target had gone, or after the fault.
    """

    fault: str
    fault_s: float
    driven_s: float


def drive(kind: str, bytes_a_second: float, *, seen_s: float, seconds: float = 4.0) -> Outcome:
    """Command a robot 30 times a second on a line that becomes slow; its target is in sight for so long after that."""
    driver, table = KINDS[kind]
    safe = TwistCommand(output="base", linear_mps=0.0, angular_radps=0.0)
    with base_bench(kind) as bench:
        model = load_driver(BASES, driver).model_validate({"port": f"emulated-{kind}", "track_width": "16 cm"} | table)
        bench.board.port.spoil = line = SlowLine(bench.clock)
        output = LeasedOutput(model.build(bench.context), safe, 0.3, bench.clock)
        output.open()
        Guard([output], bench.clock).start()
        slow_s = bench.clock.now_s() + 0.5
        fault, fault_s, driven_s = "", math.inf, 0.0
        for step in range(round(seconds / STEP_S)):
            now_s = bench.clock.now_s()
            if now_s >= slow_s:
                line.bytes_a_second = bytes_a_second
            if step % FRAME_STEPS == 0:
                turn_radps = 0.1 + step * 1e-3  # no two commands are alike
                follow = TwistCommand(output="base", linear_mps=0.3, angular_radps=turn_radps, captured_at_s=now_s)
                output.observed_fault()
                output.apply(follow if now_s < slow_s + seen_s else safe)
            bench.clock.advance_s(STEP_S)
            if output.fault and not fault:
                fault, fault_s = output.fault, bench.clock.now_s() - slow_s
            if bench.firmware.left.driven_mps or bench.firmware.right.driven_mps:
                driven_s = bench.clock.now_s() - slow_s
        with suppress(DriverError):
            output.close()
        bench.clock.advance_s(1.0)  # or what opens it again would not end
    return Outcome(fault=fault, fault_s=fault_s, driven_s=driven_s - min(fault_s, seen_s))


@pytest.mark.parametrize("bytes_a_second", RATES)
@pytest.mark.parametrize("seen_s", [0.05, 2.0])
def test_no_commands_queue_up_out_of_sight_where_a_base_acknowledges_them(bytes_a_second: int, seen_s: float) -> None:
    """A command of 8 bytes and the stop behind it take 0.7 s at 20 bytes a second."""
    outcome = drive("ros-arduino-bridge", bytes_a_second, seen_s=seen_s)
    assert outcome.driven_s <= (0.7 if bytes_a_second == 20 else 0.3)
    if bytes_a_second <= 50 and seen_s == 2.0:
        assert outcome.fault_s <= 0.5
        assert "acknowledges commands too late; raise the baud rate" in outcome.fault


@pytest.mark.parametrize(("bytes_a_second", "within_s"), [(200, 0.6), (150, 0.6), (100, 0.6), (50, 0.8), (20, 1.5)])
@pytest.mark.parametrize("seen_s", [0.05, 2.0])
def test_a_board_that_every_byte_keeps_driving_is_left_in_silence_until_it_stops_by_itself(
    bytes_a_second: int, within_s: float, seen_s: float
) -> None:
    """It understands nothing whose bytes pause for 10 ms. What was sent takes up to 1.1 s, its time-out 0.3 s more."""
    outcome = drive("roboclaw", bytes_a_second, seen_s=seen_s)
    assert outcome.driven_s <= within_s
    assert outcome.fault_s <= 0.55


@pytest.fixture
def in_sight(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a port hold back what the line has not carried, as the system does without an adapter that takes it.

    A pseudo-terminal never says so, and moves what is written by a worker of the kernel, at times of its own.
    """

    def offer(_link: SerialLink, data: bytes) -> int:
        SlowLine.newest.waiting += data
        return len(data)

    monkeypatch.setattr(SerialLink, "_offer", offer)
    monkeypatch.setattr(SerialLink, "waiting", lambda _link: len(SlowLine.newest.waiting))
    monkeypatch.setattr(SerialLink, "discard", lambda _link: setattr(SlowLine.newest, "waiting", b""))


@pytest.mark.usefixtures("in_sight")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bytes_a_second", RATES)
def test_a_stop_waits_for_no_commands_that_the_port_holds_back(kind: str, bytes_a_second: int) -> None:
    for seen_s in (0.05, 2.0):
        outcome = drive(kind, bytes_a_second, seen_s=seen_s)
        # A hoverboard understands no frame that is not in one burst, and stops by itself; a RoboClaw as above.
        assert outcome.driven_s <= {"hoverboard": 0.8, "roboclaw": 1.0}.get(kind, 0.6)


@pytest.mark.usefixtures("in_sight")
@pytest.mark.parametrize("kind", ["waveshare-ugv", "hoverboard", "sabertooth", "roomba"])
def test_a_port_that_sends_less_than_its_baud_rate_is_a_fault(kind: str) -> None:
    outcome = drive(kind, 20, seen_s=2.0)
    assert outcome.fault_s <= 0.2
    assert "is slower than its" in outcome.fault
    assert "raise the baud rate" in outcome.fault


def test_a_command_that_is_not_answered_is_followed_by_a_stop_and_one_that_is_lost_is_no_fault() -> None:
    _, table = KINDS["ros-arduino-bridge"]
    with base_bench("ros-arduino-bridge") as bench, opened(bench, track_width="16 cm", **table) as base:
        bench.drive(base, 0.3)
        bench.firmware.silent = True
        bench.command(base, 0.2)
        bench.pass_time(base, STEP_S)
        bench.firmware.silent = False
        bench.pass_time(base, DOUBTED_AFTER_S + STEP_S)
        assert bench.firmware.left.driven_mps == 0.0
        bench.drive(base, 0.3)
        assert bench.wheels_mps == pytest.approx((0.3, 0.3), rel=0.02)


def test_a_command_that_a_silent_board_must_not_hear_is_not_said_to_be_done() -> None:
    _, table = KINDS["roboclaw"]
    with base_bench("roboclaw") as bench, opened(bench, track_width="16 cm", **table) as base:
        bench.drive(base, 0.3)
        bench.firmware.silent = True
        bench.command(base, 0.3)
        bench.pass_time(base, DOUBTED_AFTER_S + STEP_S)
        assert base._awaited.must_be_quiet
        assert not bench.command(base, 0.1).moves
        bench.firmware.silent = False
        with suppress(DriverError):
            bench.pass_time(base, 2.0)
        assert bench.firmware.left.driven_mps == 0.0


@pytest.mark.parametrize("baud", [2400, 9600])
def test_at_a_low_baud_rate_the_newest_command_waits_for_none_but_the_one_on_its_way(baud: int) -> None:
    _, table = KINDS["sabertooth"]
    with base_bench("sabertooth") as bench, opened(bench, track_width="16 cm", baud=baud, **table) as base:
        sent: list[bytes] = []
        write = base._link.write
        base._link.write = lambda frame: [sent.append(frame), write(frame)][1]
        for step in range(100):
            bench.command(base, 0.2 + step * 1e-3)
            bench.clock.advance_s(STEP_S)
        assert sum(map(len, sent)) <= baud / 10 * 1.05
        assert sum(map(len, sent)) >= baud / 10 * 0.6
        bench.command(base, 0.0)
        assert base._sent == STANDING
