"""Every actuator keeps the contract."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from gpiozero.pins.mock import MockFactory, MockPWMPin

from stadimeter.actuators.pin_factory import SHARED_KEY
from stadimeter.config.plugins import ACTUATORS, DriverContext, load_plugin
from stadimeter.simulation.actuator import SimulatedActuator
from stadimeter.testing.actuator_contract import ActuatorContract, ActuatorRig
from stadimeter.testing.manual_clock import ManualClock
from stadimeter.testing.recording import RecordingActuator

PIN = 18


class WatchedPin(MockPWMPin):
    """A mock pin that remembers what it did when it was let go: as an input it no longer drives anything."""

    released: float | None = None

    def close(self) -> None:
        self._remember()
        super().close()

    def _set_frequency(self, value: float | None) -> None:
        if value is None and self._frequency is not None:
            self._remember()
        super()._set_frequency(value)

    def _set_function(self, value: str) -> None:
        super()._set_function(value)
        if value == "output":
            self.released = None

    def _remember(self) -> None:
        if self._function == "output" and self.released is None:
            self.released = self._state


def gpiozero_rig(driver: str, options: dict[str, object]) -> ActuatorRig:
    clock = ManualClock()
    context = DriverContext(name="it", clock=clock)
    factory = context.share(SHARED_KEY, lambda: MockFactory(pin_class=WatchedPin))
    plugin = load_plugin(ACTUATORS, driver)
    checked = plugin.options.model_validate({"pin": PIN, **options})

    def output() -> float:
        pin = factory.pin(PIN)
        state = float(pin.state if pin.released is None else pin.released)
        return state if checked.active_high else 1.0 - state

    def held() -> bool:
        reserved = any(reference() for references in factory._reservations.values() for reference in references)
        driven = any(pin.function == "output" for pin in factory.pins.values())
        assert reserved == driven
        return reserved

    return ActuatorRig(actuator=plugin.build(checked, context), clock=clock, output=output, held=held)


@pytest.mark.parametrize(
    ("driver", "options"),
    [
        ("vibration-motor", {}),
        ("vibration-motor", {"active_high": False, "minimum_duty": 0.405, "kick": "200 ms", "frequency": "1 kHz"}),
        ("vibration-motor", {"minimum_duty": 1.0, "kick": "0 s"}),
        ("buzzer", {}),
        ("buzzer", {"steady": True, "active_high": False}),
        ("buzzer", {"slowest": "300 ms", "fastest": "200 ms", "beep": "100 ms"}),
        ("led", {}),
        ("led", {"dimmed": True}),
        ("led", {"dimmed": True, "active_high": False}),
        ("relay", {}),
        ("relay", {"active_high": True, "on_at": 1.0}),
    ],
    ids=str,
)
class TestGpiozeroActuators(ActuatorContract):
    @pytest.fixture
    def make_rig(self, driver: str, options: dict[str, object]) -> Callable[[], ActuatorRig]:
        return lambda: gpiozero_rig(driver, options)


@pytest.mark.parametrize("options", [{}, {"steps": 1}, {"steps": 7}], ids=str)
class TestSimulatedActuator(ActuatorContract):
    @pytest.fixture
    def make_rig(self, options: dict[str, object]) -> Callable[[], ActuatorRig]:
        def make() -> ActuatorRig:
            clock = ManualClock()
            plugin = load_plugin(ACTUATORS, "simulated")
            actuator: SimulatedActuator = plugin.build(
                plugin.options.model_validate(options), DriverContext(name="it", clock=clock)
            )
            return ActuatorRig(
                actuator=actuator, clock=clock, output=lambda: actuator.level, held=lambda: actuator.is_open
            )

        return make


class TestRecordingActuator(ActuatorContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], ActuatorRig]:
        def make() -> ActuatorRig:
            clock = ManualClock()
            actuator = RecordingActuator(clock)
            return ActuatorRig(
                actuator=actuator, clock=clock, output=lambda: actuator.level, held=lambda: actuator.is_open
            )

        return make
