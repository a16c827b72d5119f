"""A camera that stays open from one look to the next: to open one takes seconds, and a picture should be live."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stadimeter.config.plugins import DriverChoice
from stadimeter.errors import DriverError
from stadimeter.workbench.frame_source import Source, open_source
from stadimeter.workbench.simulated_room import SimulatedRoom


class HeldCamera:
    """Opens a camera when it is first looked through, and holds it until another one is wanted, or `close`.

    Args:
        build: Builds a camera; touches no hardware.
    """

    def __init__(self, build: Callable[[DriverChoice], Source] = open_source) -> None:
        self._build = build
        self._choice: DriverChoice | None = None
        self._source: Source | None = None

    @property
    def room(self) -> SimulatedRoom | None:
        """The room that is simulated before the camera; None before a real one, or none."""
        return self._source.room if self._source is not None else None

    @contextmanager
    def opened(self, choice: DriverChoice) -> Iterator[Source]:
        """Give a camera that is open and has settled. A recording is read from its beginning, and not held.

        A camera that fails is let go: the next look opens it anew, or another way.

        Raises:
            DriverError: It cannot be opened, or no frame comes.
        """
        source = self._source if choice == self._choice else None
        try:
            if source is None:
                self.close()
                source = self._build(choice)
                source.settle()
                if source.is_live:
                    self._choice, self._source = choice, source
            yield source
        except DriverError:
            self.close()
            raise
        finally:
            if source is not None and self._source is not source:
                source.capture.close()

    def close(self) -> None:
        """Let the camera go; it is opened again for the next look."""
        source, self._source = self._source, None
        if source is not None:
            source.capture.close()
