"""Every button keeps the contract."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from stadimeter.config.plugins import BUTTONS, DriverContext, load_driver
from stadimeter.simulation.button import SimulatedButton
from stadimeter.testing.actuator_contract import ABSENT, FAILS, ButtonContract, ButtonRig
from stadimeter.testing.rig import ManualClock, impossible
from stadimeter.testing.wires import WatchedPins

PIN = 27


def gpiozero_rig() -> ButtonRig:
    context = DriverContext(name="front", clock=ManualClock())
    pins = WatchedPins(context)
    model = load_driver(BUTTONS, "gpio")
    return ButtonRig(
        device=model(pin=PIN).build(context),
        press=lambda is_down: pins.ground(PIN, begins=is_down),
        is_held=pins.is_held,
        faults={
            ABSENT: lambda begins: pins.occupy(PIN, begins=begins),
            FAILS: lambda begins: pins.fail(PIN, begins=begins),
        },
    )


class TestGpiozeroButton(ButtonContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], ButtonRig]:
        return gpiozero_rig

    def test_the_pi_pulls_the_pin_up_and_nothing_drives_it(self, opened: ButtonRig) -> None:
        pin = opened.device._device.pin  # type: ignore[attr-defined]
        assert (pin.function, pin.pull) == ("input", "up")


def simulated_rig() -> ButtonRig:
    model = load_driver(BUTTONS, "simulated")
    button: SimulatedButton = model().build(DriverContext(name="front", clock=ManualClock()))
    never = impossible("the simulated button has no fault knob")

    def press(is_down: bool) -> None:
        button.is_down = is_down

    return ButtonRig(device=button, press=press, is_held=lambda: button.is_open, faults={ABSENT: never, FAILS: never})


class TestSimulatedButton(ButtonContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], ButtonRig]:
        return simulated_rig


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
