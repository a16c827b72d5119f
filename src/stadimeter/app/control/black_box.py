"""The black box of a run: writes the seconds around an alarm, a fault or the press of a button as a clip.

The loop says what is worth a clip, and gives it a name before the messages of that cycle are sent. All else is done by
the thread of a recorder, so the loop never waits.

What happens while a clip is under way makes it longer, by the whole of ``after``. A clip that has been made longer by
`LONGER_MAX_S` is not made longer again: the next event begins another one, which overlaps it by ``before``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING

from stadimeter.app.control.messages import OutputsArgs, Reply
from stadimeter.app.control.recording import CLIPS, recordings_folder
from stadimeter.app.control.socket_server import Answer
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings.black_box import BlackBoxMemory
from stadimeter.app.recordings.record_file import ENDING
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.app.recordings.recorder import Recorder
from stadimeter.app.recordings.recording import ImageChooser, ImageOptions, what_is_recorded
from stadimeter.config.optional_tables import BlackBoxTable
from stadimeter.core.decide import State
from stadimeter.core.decision import EventKind
from stadimeter.core.frame import Frame
from stadimeter.core.operator import OperatorCommand

if TYPE_CHECKING:
    from stadimeter.app.bootstrap import Parts
    from stadimeter.app.ending import Deadline

# The names of clips behind that of the configuration: the time to the millisecond.
NAMES = f"-????????T??????.???Z{ENDING}"

# A clip can begin, and a run that is killed loses, so much at most.
SEGMENT_S = 1.0

# What happens later than this after a clip's first event begins another one.
LONGER_MAX_S = 60.0

# While more cycles than this wait to be encoded, nothing is written.
BEHIND = 2

_KINDS = {EventKind.RAISED: "alarm", EventKind.FAULT: "fault"}


class BlackBox:
    """Keeps the last seconds of a run, and has clips written. A listener of the loop.

    Args:
        state: Returns what the run remembers of its newest cycle.
        tell: Takes what a person should read.

    Attributes:
        clips: The name of the newest clip of each rule, output and so on.
    """

    def __init__(
        self, parts: Parts, state: Callable[[], State | None], tell: Callable[[str], None], deadline: Deadline
    ) -> None:
        table = parts.configuration.black_box or BlackBoxTable()
        self.clips: dict[str, str] = {}
        self._table = table
        self._state, self._tell = state, tell
        self._stem = parts.configuration.path.stem
        self._folder = recordings_folder(parts.configuration.path) / CLIPS
        recorded = what_is_recorded(parts.configuration, parts.cycle.detectors)
        self._memory = BlackBoxMemory(recorded, table, self._stem + NAMES)
        self._recorder = Recorder(self._memory, is_live=parts.is_live, deadline=deadline)
        self._memory.is_behind = lambda: self._recorder.waiting > BEHIND
        self._orders: list[tuple[OutputsArgs, Answer]] = []
        self._due: Callable[[], None] | None = None
        self._name = ""
        self._ends_s = self._latest_s = self._sealed_s = math.nan
        self._said: set[str] = set()
        self._left_out = 0
        self._pictures = ImageChooser(ImageOptions(rate_hz=table.rate))
        self._batch: list[tuple[CycleRecord, Frame | None]] = []

    def act(self, args: OutputsArgs, answer: Answer) -> None:
        """Have a clip written of now. Answers with its name after the next cycle."""
        self._orders.append((args, answer))

    def look(self, record: CycleRecord) -> None:
        """Name the clip of what happened in a cycle, before that is sent to anybody."""
        now_s = record.observation.now_s
        for kind, source, reason in self._found(record):
            self.clips[source] = self._name_clip(now_s, kind, source, reason)
        orders, self._orders = self._orders, []
        for args, answer in orders:
            if self._recorder.failure:
                answer(Reply(error=self.trouble()))
                continue
            name = self._name_clip(now_s, "order", args.by, args.why)
            words = f"{name} will hold the last {self._table.before:g} s and the next {self._table.after:g} s"
            answer(Reply({"words": words, "clip": name, "seconds": round(self._ends_s - now_s, 3)}))

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        """Take in a cycle; begin and end clips."""
        now_s = record.observation.now_s
        is_wanted = frame is not None and self._pictures.is_wanted(record, frame)
        self._batch.append((record, self._recorder.admit(frame) if is_wanted else None))
        is_over = now_s >= self._ends_s
        if self._due is not None or is_over or not 0 <= now_s - self._sealed_s < SEGMENT_S:
            self._sealed_s = now_s
            self._hand_over()
            self._recorder.put(partial(self._memory.begin_segment, self._state()))
            self._left_out, self._recorder.images_left_out = self._recorder.images_left_out, 0
        elif is_wanted:
            self._hand_over()
        if self._due is not None:
            self._recorder.put(self._due)
            self._due = None
        elif is_over:
            self._recorder.put(self._memory.finish_clip)
            self._ends_s = math.nan
        self._tell_trouble()

    def note_state(self, state: State) -> None:
        """Take in what the run restores from an earlier one, before its first cycle."""
        self._recorder.note_state(state)

    def note_reload(self, now_s: float, configuration: RecordedConfiguration) -> None:
        """Take in that another configuration was loaded."""
        self._hand_over()
        self._recorder.note_reload(now_s, configuration)

    def trouble(self) -> str:
        """Describe the trouble with the memory, or with the newest clip; empty if there is none."""
        slow = "pictures are left out, since this computer is too slow" if self._left_out else ""
        words = self._recorder.failure or self._memory.trouble() or slow
        return f"black box: {words}" if words else ""

    def close(self) -> None:
        """Finish the clip under way with what there is, and wait for the disk as long as there is time."""
        self._hand_over()
        self._recorder.close()
        self._tell_trouble()

    def _found(self, record: CycleRecord) -> Iterator[tuple[str, str, str]]:
        """Yield what happened that is worth a clip. An alarm that is inhibited, since it is shelved say, is not."""
        decision, on = record.decision, self._table.on
        for event in decision.events:
            is_inhibited = any(rule.inhibits for rule in decision.rules if rule.rule == event.source)
            if _KINDS.get(event.kind) in on and not is_inhibited:
                yield event.kind.value, event.source, event.reason
        for each in record.observation.operator_commands:
            if (
                isinstance(each, OperatorCommand)
                and each.is_from_button
                and ("button" in on or each.action.writes_file)
            ):
                yield "button", each.by, each.action.value

    def _name_clip(self, now_s: float, kind: str, source: str, reason: str) -> str:
        """Return the name of the clip of this moment: that of the clip under way, or of a new one."""
        ends_s = now_s + self._table.after
        if not ends_s <= self._latest_s or math.isnan(self._ends_s):
            now = datetime.now(UTC)
            self._name = f"{self._stem}-{now:%Y%m%dT%H%M%S}.{now.microsecond // 1000:03}Z{ENDING}"
            anchor_ns = time.time_ns() - round(now_s * 1e9)
            clip_of = {"kind": kind, "source": source, "reason": reason}
            self._due = partial(self._memory.begin_clip, self._folder / self._name, clip_of, anchor_ns)
            self._latest_s = ends_s + LONGER_MAX_S
        self._ends_s = ends_s
        return self._name

    def _hand_over(self) -> None:
        """Hand over the cycles since the last picture: to wake the thread in each cycle would cost the loop more."""
        self._recorder.put(partial(_write, self._memory, self._batch))
        self._batch = []

    def _tell_trouble(self) -> None:
        trouble = self.trouble()
        if trouble and trouble not in self._said:
            self._said.add(trouble)
            self._tell(f"warning: {trouble}")


def _write(memory: BlackBoxMemory, batch: list[tuple[CycleRecord, Frame | None]]) -> None:
    for record, frame in batch:
        memory.write(record, frame)
