"""A clock to move by hand."""

from __future__ import annotations

from stadimeter.app.clock import SteppedClock


class ManualClock(SteppedClock):
    """A clock that a test moves."""

    def advance_s(self, seconds: float) -> None:
        """Move the clock on, calling on the way whatever is due."""
        self.sleep_until_s(self.now_s() + seconds)
