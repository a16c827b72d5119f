from __future__ import annotations

from collections.abc import Iterator

import pytest
from gpiozero.pins.mock import MockFactory, MockPWMPin

from stadimeter.config.plugins import DriverContext
from stadimeter.gpio.output_pin import SHARED_KEY
from stadimeter.testing.rig import ManualClock
from support.pins import lgpio, pretended_pi  # noqa: F401 - fixtures


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def factory() -> Iterator[MockFactory]:
    factory = MockFactory(pin_class=MockPWMPin)
    yield factory
    factory.reset()


@pytest.fixture
def context(clock: ManualClock, factory: MockFactory) -> DriverContext:
    context = DriverContext(name="motor", clock=clock)
    context.shared.parts[SHARED_KEY] = factory
    return context
