"""Decides when what alarms remember is written, and writes it without holding up the loop.

What people were told of, or have said, is written at once. What noise may change several times a second, such as a
timer that begins, is written every ten seconds at most: what is lost with it is taken up again by the time that has
passed. In a quiet hour nothing is written at all.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

from stadimeter.app.keeping.alarm_store import AlarmStore, Memory
from stadimeter.app.keeping.moments import Moment
from stadimeter.app.keeping.resumption import Resumption, resumption_at
from stadimeter.core.decide import State
from stadimeter.core.rules.keeping import Turn, absent, kept, turn
from stadimeter.errors import StateError

PASSING_EVERY_S = 10.0
RETRY_S = 60.0
"""What could not be written is tried again after this long."""

END_WAIT_S = 10.0
"""At the end of a run the disk is waited for this long."""

MomentOf = Callable[[float], Moment]
"""Returns this moment, given what the run's clock shows."""


class AlarmKeeper:
    """Lets the alarms of a run remember what those of earlier runs did.

    Args:
        store: The file.
        moment_of: Returns this moment.

    Attributes:
        writes: How often the file was written.
        warning: What was wrong with the file at the beginning, and what became of it; empty for nothing.
    """

    def __init__(self, store: AlarmStore, moment_of: MomentOf) -> None:
        self.writes = 0
        self.warning = ""
        self._store = store
        self._moment_of = moment_of
        self._trouble = ""
        self._is_owed = False
        self._submitted_s = -math.inf
        self._newest: State | None = None
        self._is_ending = False
        self._turned = threading.Condition()
        self._thread: threading.Thread | None = None

    def begin(self, now_s: float) -> Resumption | None:
        """Read the file, and begin to write it. A file that cannot be used keeps no run from beginning.

        Args:
            now_s: The run's clock.

        Returns:
            What the run takes over from an earlier one; None if there is nothing.
        """
        try:
            memory = self._store.open()
        except StateError as error:
            self.warning = str(error)
            return None
        self.warning = self._store.warning
        self._thread = threading.Thread(target=self._write_all, name="alarm keeper", daemon=True)
        self._thread.start()
        return resumption_at(self._moment_of(now_s), memory) if memory else None

    def cycle(self, before: State, after: State) -> None:
        """Take in a cycle. Never waits for the disk.

        Args:
            before: What was remembered before it.
            after: What was remembered after it.
        """
        found = turn(before, after)
        if found is Turn.NOTHING and not self._is_owed:
            return
        now_s = after.now_s or 0.0
        if found is Turn.LASTING or now_s - self._submitted_s >= PASSING_EVERY_S:
            self.keep(after)
        else:
            self._is_owed = True

    def keep(self, state: State) -> None:
        """Have a state written, as soon as the disk can. Never waits for it.

        Args:
            state: What is remembered now.
        """
        if self._thread is None:
            return
        self._is_owed, self._submitted_s = False, state.now_s or 0.0
        with self._turned:
            self._newest = state
            self._turned.notify()

    def end(self, state: State) -> str:
        """Write what is remembered at the end of the run, and close the file. Waits for the disk.

        Does nothing if it was called before, in whatever thread.

        Args:
            state: What is remembered.

        Returns:
            What went wrong, in words; empty for nothing.
        """
        thread = self._thread
        if thread is None or self._is_ending:
            return ""
        if state.now_s is not None:
            self.keep(state)
        with self._turned:
            self._is_ending = True
            self._turned.notify()
        thread.join(END_WAIT_S)
        self._thread = None
        if thread.is_alive():
            return "the disk does not take the state of the alarms"
        self._store.close()
        return self._trouble

    def trouble(self) -> str:
        """Return why nothing is written at present, in words; empty if all is well."""
        return self._trouble

    def _write_all(self) -> None:
        """Write the newest state, again and again, until the end."""
        while True:
            with self._turned:
                while self._newest is None and not self._is_ending:
                    self._turned.wait()
                state, self._newest = self._newest, None
                is_last = self._is_ending
            if state is not None and not self._write(state) and not is_last:
                self._wait_and_try_again(state)
            if is_last:
                return

    def _write(self, state: State) -> bool:
        try:
            self._store.write(
                Memory(moment=self._moment_of(state.now_s or 0.0), alarms=kept(state), absent=absent(state))
            )
        except StateError as error:
            self._trouble = str(error)
            return False
        except Exception as error:  # noqa: BLE001 - a defect here must not end the run, and must not stay unseen
            self._trouble = f"what alarms remember cannot be written: {type(error).__name__}: {error}"
            return False
        self._trouble = ""
        self.writes += 1
        return True

    def _wait_and_try_again(self, state: State) -> None:
        with self._turned:
            self._turned.wait_for(lambda: self._newest is not None or self._is_ending, timeout=RETRY_S)
            self._newest = self._newest or state
