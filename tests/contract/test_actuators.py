"""Every actuator and every button keeps its contract."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from stadimeter.config.plugins import ACTUATORS, BUTTONS, DriverContext, load_driver
from stadimeter.simulation.devices import SimulatedActuator, SimulatedButton
from stadimeter.testing.actuator_contract import ABSENT, FAILS, ActuatorContract, ActuatorRig, ButtonContract, ButtonRig
from stadimeter.testing.rig import ManualClock, impossible
from support.pins import WatchedPins

PIN, BUTTON_PIN = 18, 27


def gpiozero_rig(driver: str, options: dict[str, object]) -> ActuatorRig:
    context = DriverContext(name="it", clock=ManualClock())
    pins = WatchedPins(context)
    model = load_driver(ACTUATORS, driver)
    checked = model.model_validate({"pin": PIN, **options})
    return ActuatorRig(
        device=checked.build(context),
        clock=context.clock,
        output=lambda: pins.state(PIN) if checked.active_high else 1.0 - pins.state(PIN),
        is_held=pins.is_held,
        faults={
            ABSENT: lambda begins: pins.occupy(PIN, begins=begins),
            FAILS: lambda begins: pins.fail(PIN, begins=begins),
        },
    )


@pytest.mark.parametrize(
    ("driver", "options"),
    [
        ("vibration-motor", {}),
        ("vibration-motor", {"active_high": False, "minimum_duty": 1.0, "frequency": "1 kHz"}),
        ("buzzer", {}),
        ("buzzer", {"steady": True, "active_high": False}),
        ("led", {}),
        ("led", {"dimmed": True, "active_high": False}),
        ("relay", {}),
    ],
    ids=str,
)
class TestGpiozeroActuators(ActuatorContract):
    @pytest.fixture
    def make_rig(self, driver: str, options: dict[str, object]) -> Callable[[], ActuatorRig]:
        return lambda: gpiozero_rig(driver, options)


def simulated_rig(options: dict[str, object]) -> ActuatorRig:
    clock = ManualClock()
    model = load_driver(ACTUATORS, "simulated")
    actuator: SimulatedActuator = model.model_validate(options).build(DriverContext(name="it", clock=clock))
    never = impossible("the simulated actuator has no fault knob")
    return ActuatorRig(
        device=actuator,
        clock=clock,
        output=lambda: actuator.level,
        is_held=lambda: actuator.is_open,
        faults={ABSENT: never, FAILS: never},
    )


@pytest.mark.parametrize("options", [{}, {"steps": 7}], ids=str)
class TestSimulatedActuator(ActuatorContract):
    @pytest.fixture
    def make_rig(self, options: dict[str, object]) -> Callable[[], ActuatorRig]:
        return lambda: simulated_rig(options)


def gpiozero_button_rig() -> ButtonRig:
    context = DriverContext(name="front", clock=ManualClock())
    pins = WatchedPins(context)
    model = load_driver(BUTTONS, "gpio")
    return ButtonRig(
        device=model(pin=BUTTON_PIN).build(context),
        press=lambda is_down: pins.ground(BUTTON_PIN, begins=is_down),
        is_held=pins.is_held,
        faults={
            ABSENT: lambda begins: pins.occupy(BUTTON_PIN, begins=begins),
            FAILS: lambda begins: pins.fail(BUTTON_PIN, begins=begins),
        },
    )


class TestGpiozeroButton(ButtonContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], ButtonRig]:
        return gpiozero_button_rig

    def test_the_pi_pulls_the_pin_up_and_nothing_drives_it(self, opened: ButtonRig) -> None:
        pin = opened.device._device.pin  # type: ignore[attr-defined]
        assert (pin.function, pin.pull) == ("input", "up")


def simulated_button_rig() -> ButtonRig:
    model = load_driver(BUTTONS, "simulated")
    button: SimulatedButton = model().build(DriverContext(name="front", clock=ManualClock()))
    never = impossible("the simulated button has no fault knob")

    def press(is_down: bool) -> None:
        button.is_down = is_down

    return ButtonRig(device=button, press=press, is_held=lambda: button.is_open, faults={ABSENT: never, FAILS: never})


class TestSimulatedButton(ButtonContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], ButtonRig]:
        return simulated_button_rig


def test_a_simulated_button_is_pressed_when_its_table_says() -> None:
    clock = ManualClock(start_s=100.0)
    model = load_driver(BUTTONS, "simulated")
    options = model.model_validate({"presses": [{"at": "1 s", "for": "500 ms"}, {"at": "3 s"}]})
    button = options.build(DriverContext(name="front", clock=clock))
    button.open()
    seen = []
    for _ in range(16):
        seen.append(button.is_pressed())
        clock.advance_s(0.25)
    assert [0.25 * step for step, is_down in enumerate(seen) if is_down] == [1.0, 1.25, 3.0]
