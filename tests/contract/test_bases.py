from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from stadimeter.bases.protocol import MobileBase
from stadimeter.config.plugins import BASES, PORTS, DriverContext, load_driver
from stadimeter.errors import DeviceClosedError, LinkLostError
from stadimeter.simulation.motors import FULL_DUTY_MPS, STARTS_AT_DUTY, EmulatedPca9685Options, HBridgeMotors
from stadimeter.simulation.world import World, WorldOptions
from stadimeter.testing.base_contract import SILENT, TAKES_NO_BYTES, UNPLUGGED, BaseContract, BaseRig, clog, is_locked
from stadimeter.testing.output_contract import raised_by
from stadimeter.testing.rig import TICK_S, ManualClock, eventually, impossible
from support.pins import WatchedPins

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


def serial_rig(context: DriverContext, driver: str, port: str, options: dict[str, Any], *, answers: bool = True) -> Any:
    """Return what makes rigs over a real pseudo-terminal to the emulated firmware, which turns the robot's wheels."""
    model = load_driver(BASES, driver)
    checked = model(port=port, track_width="16 cm", max_wheel_speed="0.5 m/s", **options)
    board = load_driver(PORTS, port).board(context)
    path = board.port.path
    silence = lambda begins: setattr(board.firmware, "silent", begins)  # noqa: E731
    return lambda: BaseRig(
        device=checked.build(context),
        clock=context.clock,
        is_held=lambda: is_locked(path),
        motion=lambda: true_motion(context),
        faults={
            UNPLUGGED: pulled_cable(context),
            SILENT: silence if answers else impossible("this base never says anything"),
            TAKES_NO_BYTES: lambda begins: clog(board.port, begins=begins),
        },
    )


ENCODERS = {"wheel_diameter": "65 mm", "ticks_per_turn": 1440}
ROS_ARDUINO = ("ros-arduino-bridge", "emulated-ros-arduino-bridge", ENCODERS)
BLIND = {"drive": "h500\nc{left:d},{right:d}\n", "stop": "c0,0\n", "full_speed": "0.8 m/s", "auto_stop": "500 ms"}
OPENBOT = BLIND | {"question": "f\n", "answers": {"identity": "f[A-Z].*", "battery": "v([0-9.]+)"}}


def alike(*values: Any, id: str) -> Any:  # noqa: A002 - pytest's name
    """Return a case that differs from others by its codec alone, which has tests of its own."""
    return pytest.param(*values, id=id, marks=pytest.mark.long)


@pytest.mark.parametrize(
    ("driver", "port", "options", "answers"),
    [
        pytest.param(*ROS_ARDUINO, True, id="ros-arduino-bridge"),
        pytest.param("ascii", "emulated-openbot", BLIND, False, id="driven blindly"),
        pytest.param("roomba", "emulated-roomba", {}, True, id="roomba"),
        alike("waveshare-ugv", "emulated-waveshare-ugv", {}, True, id="waveshare-ugv"),
        alike("hoverboard", "emulated-hoverboard", {"full_speed": "1 m/s"}, True, id="hoverboard"),
        alike("ascii", "emulated-openbot", OPENBOT, True, id="openbot"),
        alike("roboclaw", "emulated-roboclaw", ENCODERS, True, id="roboclaw"),
        alike("roboclaw", "emulated-roboclaw", {"full_speed": "1 m/s"}, True, id="roboclaw without encoders"),
        alike("sabertooth", "emulated-sabertooth", {"full_speed": "1 m/s"}, False, id="sabertooth"),
    ],
)
class TestSerialBases(BaseContract):
    @pytest.fixture
    def make_rig(self, context: DriverContext, driver: str, port: str, options: dict[str, Any], answers: bool) -> Any:
        return serial_rig(context, driver, port, options, answers=answers)


THREE_INPUTS = {
    "left": {"forward": 17, "backward": 27, "pwm": 12},
    "right": {"forward": 23, "backward": 24, "pwm": 13},
    "enable": 25,
}
TWO_INPUTS = {"left": {"forward": 17, "backward": 27}, "right": {"forward": 23, "backward": 24}, "brake": "0 s"}
ONE_DIRECTION = {"left": {"direction": 17, "pwm": 12}, "right": {"direction": 23, "pwm": 13}}

# As the emulated motors are.
CAR = {"track_width": "16 cm", "max_wheel_speed": f"{FULL_DUTY_MPS} m/s", "minimum_duty": STARTS_AT_DUTY}


@pytest.mark.parametrize("motors", [THREE_INPUTS, TWO_INPUTS, ONE_DIRECTION], ids=["three", "two", "direction"])
class TestGpioMotors(BaseContract):
    """On pins in memory, whose levels turn the wheels of the simulated robot."""

    @pytest.fixture
    def make_rig(self, context: DriverContext, motors: dict[str, object]) -> Callable[[], BaseRig]:
        pins = WatchedPins(context)
        options = load_driver(BASES, "gpio-motors").model_validate({**CAR, **motors})
        emulated = HBridgeMotors(context.shared.parts["world"], context.clock, pins.state)
        emulated.wire([options.left.outputs()], [options.right.outputs()], options.enable)
        return lambda: BaseRig(
            device=options.build(context),
            clock=context.clock,
            is_held=pins.is_held,
            motion=lambda: true_motion(context),
            faults={
                UNPLUGGED: lambda begins: fail_all(pins, begins=begins),
                SILENT: impossible("a pin does not answer"),
                TAKES_NO_BYTES: impossible("a pin takes no bytes"),
            },
        )


CHANNELS = {"left": [{"direction": 9, "pwm": 8}], "right": [{"direction": 3, "pwm": 13}]}


@pytest.mark.parametrize(
    "board", [{"board": "freenove-4wd"}, {"board": "jetbot"}, {"board": "motorkit", "brake": "0 s"}, CHANNELS], ids=str
)
class TestPca9685Base(BaseContract):
    """Over the registers of an emulated chip, whose channels turn the wheels of the simulated robot."""

    @pytest.fixture
    def make_rig(self, context: DriverContext, board: dict[str, object]) -> Callable[[], BaseRig]:
        options = load_driver(BASES, "pca9685").model_validate({**CAR, **board, "port": "emulated-pca9685"})
        bus = EmulatedPca9685Options.device(context)

        def make() -> BaseRig:
            base = options.build(context)
            return BaseRig(
                device=base,
                clock=context.clock,
                is_held=lambda: base.is_open,
                motion=lambda: true_motion(context),
                faults={
                    UNPLUGGED: pulled_cable(context),
                    SILENT: impossible("a chip that does not acknowledge is one that is unplugged"),
                    TAKES_NO_BYTES: lambda begins: setattr(bus, "is_held", begins),
                },
            )

        return make


def fail_all(pins: WatchedPins, *, begins: bool) -> None:
    for pin in (12, 13, 17, 23, 24, 25, 27):
        pins.fail(pin, begins=begins)


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


def ros2_rig(
    context: DriverContext, make_robot: Callable[[Callable[[float, float], None]], Any]
) -> Callable[[], BaseRig]:
    """Return what makes rigs with a robot on the network, whose controller stops after half a second.

    The clock of the rig stands while a message is on its way: each is waited for.
    """
    robot = context.shared.parts["world"].robot
    half_m = TRACK_WIDTH_M / 2

    def drive(linear_mps: float, angular_radps: float) -> None:
        left_mps, right_mps = linear_mps - angular_radps * half_m, linear_mps + angular_radps * half_m
        robot.drive_wheels(left_mps, right_mps, context.clock.now_s() + 0.5)

    peer = make_robot(drive)
    context.at_end(peer.stop)
    options = load_driver(BASES, "ros2-rosbridge")(url=peer.url)

    def waiting_link() -> Any:
        link = type(options).link(options)
        send, check, close = link.send, link.check, link.close

        def send_and_wait(motion: Any) -> None:
            heard = len(peer.heard)
            send(motion)
            eventually(lambda: len(peer.heard) > heard or not peer.is_used)

        def check_as_lost_once_it_is() -> None:
            """Wait for the news that the peer has gone: it takes time on the network, none on the clock of the rig."""
            eventually(lambda: peer.is_used or raised_by(check))
            check()

        def close_and_wait() -> None:
            close()
            eventually(lambda: not peer.is_used)

        link.send, link.check, link.close = send_and_wait, check_as_lost_once_it_is, close_and_wait
        return link

    def unplug(begins: bool) -> None:
        peer.stop() if begins else peer.start()
        eventually(lambda: not peer.is_used)

    object.__setattr__(options, "link", waiting_link)
    return lambda: BaseRig(
        device=options.build(context),
        clock=context.clock,
        is_held=lambda: peer.is_used,
        motion=lambda: true_motion(context),
        faults={
            UNPLUGGED: unplug,
            SILENT: impossible("pings in real time find it: bases/test_rosbridge.py"),
            TAKES_NO_BYTES: impossible("what the network does not take is dropped, or found in real time"),
        },
    )


class TestRosbridgeBase(BaseContract):
    """Over a web socket to a server that speaks the rosbridge protocol."""

    @pytest.fixture
    def make_rig(self, context: DriverContext) -> Callable[[], BaseRig]:
        pytest.importorskip("websockets")
        from support.rosbridge_server import RosbridgeServer

        return ros2_rig(context, RosbridgeServer)


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
