"""Decides when what alarms remember is written, and writes it without the loop having to wait for a slow disk.

What people were notified of, or have done, is written at once. What noise may change several times a second, such as a
timer that begins, is written every ten seconds at most: what is lost with it is taken up again by the time that has
passed. In a quiet hour nothing is written at all.

An alarm's message goes to the broker and into the file at the same time, in one transaction with the alarm itself,
since the alarm will not be raised anew. Everything else that is not acknowledged after half a second is written,
too, and so outlives a power cut. It goes out of the file with whatever is written next, after ten seconds at most: a
power cut in between sends it twice, with one id.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from stadimeter.app.deliveries import Deliveries, Undelivered
from stadimeter.app.persistence.resumption import ClockReading, Memory, resume, shift_s
from stadimeter.core.decide import State
from stadimeter.core.decision import SYSTEM_EVENTS, Event
from stadimeter.core.persistence import SnapshotChange, classify_change, find_absences, snapshot_alarms
from stadimeter.errors import StateError

if TYPE_CHECKING:  # a run without a state file works on a system without SQLite
    from stadimeter.app.persistence.alarm_store import AlarmStore

# What could not be written is tried again after this long.
PASSING_EVERY_S = 10.0
RETRY_S = 60.0

# Period of the check for messages that are not acknowledged.
LOOK_EVERY_S = 0.5

# So long the loop waits at most until an alarm is in the file. A program that is killed after that has kept it.
#
# The operating system takes a write in a millisecond or two; only a power cut can lose what is not flushed yet. The
# outputs have their commands by then, and a disk that hangs costs a third of a cycle.
ALARM_WAIT_S = 0.01

# At the end of a run the disk is waited for this long; it has had the time of closing everything before.
END_WAIT_S = 1.0

# Returns this moment, given what the run's clock shows.
ReadClocks = Callable[[float], ClockReading]


class StateWriter:
    """Lets the alarms of a run remember what those of earlier runs did.

    Attributes:
        writes: How often the file was written.
        warning: What was wrong with the file at the beginning, and what became of it; empty for nothing.
        kept: The undelivered messages in the file.
    """

    def __init__(self, store: AlarmStore, moment_of: ReadClocks, deliveries: Deliveries | None = None) -> None:
        self.writes = 0
        self.warning = ""
        self.kept: tuple[Undelivered, ...] = ()
        self._store = store
        self._moment_of = moment_of
        self._deliveries = deliveries
        self._trouble = ""
        self._is_owed = False
        self._submitted_s = -math.inf
        self._newest: State | None = None
        self._latest: State | None = None
        self._written_at_s = -math.inf
        self._is_ending = False
        self._is_writing = False
        self._is_unflushed = False
        self._turned = threading.Condition()
        self._thread: threading.Thread | None = None

    def begin(self, now_s: float, state: State) -> State | None:
        """Read the file, send what an earlier run left in it, and begin to write it.

        A file that cannot be used keeps no run from beginning.

        Returns the state of a run that has not begun with what alarms restore from an earlier one; None for nothing.
        """
        try:
            memory = self._store.open()
        except StateError as error:
            self.warning = str(error)
            return None
        self.warning = self._store.warning
        now = self._moment_of(now_s)
        if memory is not None and self._deliveries is not None:
            self.kept = memory.undelivered
            self._deliveries.send_again(memory.undelivered, now_s, shift_s(memory.moment, now))
        self._thread = threading.Thread(target=self._write_all, name="alarm keeper", daemon=True)
        self._thread.start()
        threading.Thread(target=self._flush_all, name="alarm flusher", daemon=True).start()
        return resume(state, memory, now) if memory else None

    def cycle(self, before: State, after: State, events: Iterable[Event] = ()) -> None:
        """Take in a cycle, after its messages were sent and before its listeners.

        Never waits for the disk, but a moment if there is an alarm that others have not got yet.
        """
        self._latest = after
        is_alarm = any(event.kind not in SYSTEM_EVENTS for event in events) and bool(self._undelivered())
        if is_alarm or before.stopped != after.stopped:
            self.keep(after)
            if is_alarm:
                with self._turned:
                    self._turned.wait_for(lambda: self._newest is None and not self._is_writing, ALARM_WAIT_S)
            return
        found = classify_change(before, after)
        if found is SnapshotChange.NOTHING and not self._is_owed:
            return
        now_s = after.now_s or 0.0
        if found is SnapshotChange.LASTING or now_s - self._submitted_s >= PASSING_EVERY_S:
            self.keep(after)
        else:
            self._is_owed = True

    def keep(self, state: State) -> None:
        """Have a state written, as soon as the disk can. Never waits for it."""
        if self._thread is None or state.now_s is None:
            return
        self._is_owed, self._submitted_s = False, state.now_s
        with self._turned:
            self._newest = state
            self._turned.notify_all()

    def end(self, state: State) -> str:
        """Write what is remembered at the end of the run, and close the file. Waits for the disk.

        Call it when messenger and notifiers are closed: then it is known what they could not deliver. Does nothing if
        it was called before, in whatever thread.

        Returns what went wrong, in words.
        """
        thread = self._thread
        if thread is None or self._is_ending:
            return ""
        with self._turned:
            self._newest = state if state.now_s is not None else None
            self._is_ending = True
            self._turned.notify_all()
        thread.join(END_WAIT_S)
        self._thread = None
        if thread.is_alive():
            return "the disk does not take the state of the alarms"
        self._store.close()
        return self._trouble

    def is_kept(self) -> bool | None:
        """Check whether all that was to be written is in the file; None if nothing can be."""
        if self._thread is None or self._trouble:
            return None
        with self._turned:
            return self._newest is None and not self._is_writing

    def trouble(self) -> str:
        """Return why nothing is written at present, in words; empty if all is well."""
        return self._trouble

    def _write_all(self) -> None:
        """Write the newest state, again and again, until the end."""
        while True:
            with self._turned:
                self._turned.wait_for(lambda: self._newest is not None or self._is_ending, LOOK_EVERY_S)
                state, self._newest = self._newest, None
                is_last = self._is_ending
                self._is_writing = state is not None
            if state is None and self._owes_deliveries():
                state = self._latest
            is_written = state is None or self._write(state)
            with self._turned:
                self._is_writing = False
                self._is_unflushed |= state is not None and is_written
                self._turned.notify_all()
            if state is not None and not is_written and not is_last:
                self._wait_and_try_again(state)
            if is_last:
                return

    def _flush_all(self) -> None:
        """Have the disk take what was written, apart from writing: an alarm must not wait for that of the last one."""
        while True:
            with self._turned:
                self._turned.wait_for(lambda: self._is_unflushed or self._is_ending)
                if self._is_ending:  # closing the file flushes it
                    return
                self._is_unflushed = False
            try:
                self._store.flush()
            except StateError as error:
                self._trouble = str(error)

    def _undelivered(self) -> tuple[Undelivered, ...]:
        return self._deliveries.undelivered() if self._deliveries is not None else ()

    def _owes_deliveries(self) -> bool:
        """Check whether undelivered messages are to be written: new ones at once, a shorter list after a while."""
        undelivered = self._undelivered()
        if undelivered == self.kept:
            return False
        return not {*undelivered} <= {*self.kept} or time.monotonic() - self._written_at_s >= PASSING_EVERY_S

    def _write(self, state: State) -> bool:
        undelivered = self._undelivered()
        try:
            moment = self._moment_of(state.now_s or 0.0)
            memory = Memory(
                moment=moment,
                alarms=snapshot_alarms(state),
                absent=find_absences(state),
                undelivered=undelivered,
                stopped=state.stopped,
            )
            self._store.write(memory)
        except StateError as error:
            self._trouble = str(error)
            return False
        except BaseException as error:  # noqa: BLE001 - a defect here must not end the run, and must not stay unseen
            self._trouble = f"what alarms remember cannot be written: {type(error).__name__}: {error}"
            return False
        self._trouble = ""
        self.kept, self._written_at_s = undelivered, time.monotonic()
        self.writes += 1
        return True

    def _wait_and_try_again(self, state: State) -> None:
        with self._turned:
            self._turned.wait_for(lambda: self._newest is not None or self._is_ending, timeout=RETRY_S)
            self._newest = self._newest or state
