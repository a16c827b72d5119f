"""The laser sensor VL53L1X by STMicroelectronics, on I²C.

It needs the library ``VL53L1X``, which the extra ``tof`` adds.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar

from pydantic import Field

from stadimeter.config.extras import install_line
from stadimeter.config.plugins import DriverContext, DriverOptions
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverUnavailableError, LinkLostError
from stadimeter.sensors.protocol import Echo

# The data sheet states a ranging error of ±20 mm, or 1 % beyond 2 m, in the dark; taken as one standard deviation,
# since in daylight it is twice that.
SIGMA_M = 0.02
RELATIVE_SIGMA = 0.01

# As the library has it: up to 4 m in the dark, with 50 ms a measurement.
_LONG_RANGE = 3

# Of the sensor's statuses these say that nothing usable came back: weak or noisy signal, and a phase out of bounds,
# which is how far things look. The others are faults of the sensor.
_NOTHING_IN_RANGE = frozenset({1, 2, 4, 7, 12})
_VALID = frozenset({0, 3, 6, 11})


class Vl53l1xOptions(DriverOptions):
    """The options of a laser sensor VL53L1X: ± 2 cm, beyond 2 m ± 1 %. `pip install 'stadimeter[tof]'`."""

    bus: Annotated[int, Field(ge=0, le=99)] = 1
    """The number of the I²C bus: N of ``/dev/i2c-N``."""
    address: Annotated[int, Field(ge=0x08, le=0x77)] = 0x29
    """Its address on the bus; written as `0x29`."""

    def build(self, context: DriverContext) -> Vl53l1x:
        """Return the sensor."""
        return Vl53l1x(self, context)


class Vl53l1x:
    """A `RangeSensor` on I²C."""

    period_s: ClassVar = 0.01  # `read` itself waits for the next measurement

    def __init__(self, options: Vl53l1xOptions, context: DriverContext) -> None:
        self._options = options
        self._context = context
        self._device: Any = None

    def open(self) -> None:
        """Find the sensor on the bus and begin to measure. Does nothing when open."""
        if self._device is not None:
            return
        try:
            from VL53L1X import VL53L1X  # type: ignore[import-not-found] # noqa: PLC0415 - an optional library
        except (ImportError, OSError) as error:
            raise DriverUnavailableError(
                f"the sensor '{self._context.name}' needs the library VL53L1X: run {install_line('tof')} ({error})"
            ) from error
        try:
            device = VL53L1X(i2c_bus=self._options.bus, i2c_address=self._options.address)
            device.open()
            device.start_ranging(_LONG_RANGE)
        except (OSError, RuntimeError) as error:
            raise DeviceOpenError(
                f"the sensor '{self._context.name}' is not at address {self._options.address:#04x} of "
                f"/dev/i2c-{self._options.bus}: {error}; look for it with `i2cdetect -y {self._options.bus}`, and "
                "enable I²C with raspi-config"
            ) from error
        self._device = device

    def read(self) -> Echo | None:
        """Wait for the next measurement and return it; a `LinkLostError` if the sensor reports a fault or is gone."""
        if self._device is None:
            raise DeviceClosedError(f"the sensor '{self._context.name}' is not open")
        try:
            distance_mm, status = self._device.get_distance(), self._device.get_range_status()
        except (OSError, RuntimeError) as error:
            raise LinkLostError(f"the sensor '{self._context.name}' does not answer: {error}") from error
        if status not in _VALID | _NOTHING_IN_RANGE:
            raise LinkLostError(f"the sensor '{self._context.name}' reports the fault {status}")
        distance_m = distance_mm / 1000 if status in _VALID and distance_mm > 0 else math.inf
        sigma_m = SIGMA_M if math.isinf(distance_m) else max(SIGMA_M, RELATIVE_SIGMA * distance_m)
        return Echo(at_s=self._context.clock.now_s(), distance_m=distance_m, sigma_m=sigma_m)

    def close(self) -> None:
        """Stop measuring and release the bus. May be called any number of times."""
        device, self._device = self._device, None
        if device is not None:
            try:
                device.stop_ranging()
            finally:
                device.close()
