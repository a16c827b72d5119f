from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import pytest

from stadimeter.bases.protocol import MobileBase
from stadimeter.config.plugins import BASES, DriverContext, load_driver
from stadimeter.errors import DeviceClosedError, LinkLostError
from stadimeter.simulation.ros_arduino_firmware import emulated_ros_arduino
from stadimeter.simulation.world import World, WorldOptions
from stadimeter.testing.base_contract import SILENT, TAKES_NO_BYTES, UNPLUGGED, BaseContract, BaseRig
from stadimeter.testing.manual_clock import ManualClock
from stadimeter.testing.rig import TICK_S, impossible
from stadimeter.testing.wires import clog, is_locked

TRACK_WIDTH_M = 0.16


@pytest.fixture
def context() -> Iterator[DriverContext]:
    clock = ManualClock()
    made = DriverContext(name="base", clock=clock)
    world = WorldOptions(track_width="16 cm", ticks_per_metre=1440 / (math.pi * 0.065))
    made.share("world", lambda: World(world, clock))
    yield made
    for close in reversed(made.shared.closers):
        close()


def true_motion(context: DriverContext) -> tuple[float, float]:
    left_mps, right_mps = context.shared.parts["world"].robot.wheels_mps
    return ((left_mps + right_mps) / 2, (right_mps - left_mps) / TRACK_WIDTH_M)


class TestRosArduinoBase(BaseContract):
    """Over a real pseudo-terminal to the emulated firmware, which turns the wheels of the simulated robot."""

    @pytest.fixture
    def make_rig(self, context: DriverContext) -> Callable[[], BaseRig]:
        model = load_driver(BASES, "ros-arduino-bridge")
        options = model(
            port="emulated-ros-arduino-bridge",
            wheel_diameter="65 mm",
            ticks_per_turn=1440,
            track_width="16 cm",
            max_wheel_speed="0.5 m/s",
        )
        board = emulated_ros_arduino(context)
        path = board.port.path
        return lambda: BaseRig(
            device=options.build(context),
            clock=context.clock,
            is_held=lambda: is_locked(path),
            motion=lambda: true_motion(context),
            faults={
                UNPLUGGED: pulled_cable(context),
                SILENT: lambda begins: setattr(board.firmware, "silent", begins),
                TAKES_NO_BYTES: lambda begins: clog(board.port, begins=begins),
            },
        )


class TestSimulatedBase(BaseContract):
    """In the simulated world, without a port."""

    @pytest.fixture
    def make_rig(self, context: DriverContext) -> Callable[[], BaseRig]:
        model = load_driver(BASES, "simulated")

        def make() -> BaseRig:
            base = model().build(context)
            return BaseRig(
                device=base,
                clock=context.clock,
                is_held=lambda: is_connected(base),
                motion=lambda: true_motion(context),
                faults={
                    UNPLUGGED: pulled_cable(context),
                    SILENT: impossible("the simulated base has no line"),
                    TAKES_NO_BYTES: impossible("the simulated base has no port"),
                },
            )

        return make


def pulled_cable(context: DriverContext) -> Callable[[bool], None]:
    def pull(begins: bool) -> None:
        context.shared.parts["world"].faults.base_unplugged = begins
        context.clock.sleep_until_s(context.clock.now_s() + TICK_S)  # the port goes with its next service

    return pull


def is_connected(base: MobileBase) -> bool:
    try:
        base.tick(0.0)
    except DeviceClosedError:
        return False
    except LinkLostError:
        pass
    return True
