"""Every actuator keeps the contract."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from stadimeter.config.plugins import ACTUATORS, DriverContext, load_driver
from stadimeter.simulation.actuator import SimulatedActuator
from stadimeter.testing.actuator_contract import ABSENT, FAILS, ActuatorContract, ActuatorRig
from stadimeter.testing.rig import ManualClock, impossible
from stadimeter.testing.wires import WatchedPins

PIN = 18


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
        ("vibration-motor", {"active_high": False, "minimum_duty": 1.0, "kick": "0 s", "frequency": "1 kHz"}),
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
