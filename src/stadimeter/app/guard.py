"""The guard: watches over the outputs apart from the control loop.

It calls every output every 20 ms, so that a command whose frame has grown too old ends, even while the control loop
hangs in a camera or a detector.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from stadimeter.app.leased_output import LeasedOutput
from stadimeter.core.clock import Clock
from stadimeter.errors import DriverError

PERIOD_S = 0.02


class Guard:
    """Checks the outputs of a run again and again.

    Args:
        outputs: The outputs.
        clock: The run's clock; a real one calls from a thread of its own.

    Attributes:
        failure: A defect in a driver that came up here; the loop raises it. None if all is well.
    """

    def __init__(self, outputs: Sequence[LeasedOutput], clock: Clock) -> None:
        self.failure: Exception | None = None
        self._outputs = outputs
        self._clock = clock
        self._cancel: Callable[[], None] | None = None

    def start(self) -> None:
        """Begin to watch."""
        self._cancel = self._clock.call_every(PERIOD_S, self.step)

    def step(self, now_s: float) -> None:
        """Check every output once.

        Args:
            now_s: The run's clock.
        """
        for output in self._outputs:
            try:
                output.check(now_s)
            except Exception as error:  # noqa: BLE001 - whatever it is, the outputs must stop; the loop reports it
                self.failure = self.failure or error
                retire_all(self._outputs)

    def stop(self) -> None:
        """Cease to watch. May be called any number of times."""
        if self._cancel is not None:
            self._cancel()
            self._cancel = None


def retire_all(outputs: Sequence[LeasedOutput]) -> list[str]:
    """Stop every output for good, each one whatever becomes of the others.

    Args:
        outputs: The outputs.

    Returns:
        What went wrong, in words.
    """
    troubles: list[str] = []
    for output in outputs:
        try:
            output.retire()
        except DriverError as error:
            troubles.append(f"{output.name}: {error}")
        except Exception as error:  # noqa: BLE001 - a defect in one driver must not keep the next from stopping
            troubles.append(f"{output.name}: {type(error).__name__}: {error}")
    return troubles
