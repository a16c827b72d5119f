"""A camera that stays open from one look to the next: to open one takes seconds, and a picture should be live."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from stadimeter.config.plugins import DriverChoice
from stadimeter.workbench.frame_source import Source, open_source
from stadimeter.workbench.simulated_room import SimulatedRoom


class HeldCamera:
    """Opens a camera when it is first looked through, and holds it until another one is wanted, or `close`."""

    def __init__(self) -> None:
        self._choice: DriverChoice | None = None
        self._source: Source | None = None

    @property
    def room(self) -> SimulatedRoom | None:
        """The room that is simulated before the camera; None before a real one, or none."""
        return self._source.room if self._source is not None else None

    @contextmanager
    def opened(self, choice: DriverChoice) -> Iterator[Source]:
        """Give a camera that is open and has settled. A recording is read from its beginning, and not held.

        Raises:
            DriverError: It cannot be opened, or no frame comes.
        """
        if self._source is not None and choice == self._choice:
            yield self._source
            return
        self.close()
        source = open_source(choice)
        try:
            source.settle()
            if source.is_live:
                self._choice, self._source = choice, source
            yield source
        finally:
            if self._source is not source:
                source.capture.close()

    def close(self) -> None:
        """Let the camera go; it is opened again for the next look."""
        source, self._source = self._source, None
        if source is not None:
            source.capture.close()
