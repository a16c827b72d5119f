"""Every way in which the program saves a file, each with what the program reads of it afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import mcap.writer  # noqa: F401 - before the processes that save are forked
import numpy as np
from msgspec import Struct

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.event_log import FILE_BYTES_MAX, EventLog, log_files
from stadimeter.app.persistence.alarm_store import AlarmStore
from stadimeter.app.persistence.resumption import ClockReading, Memory
from stadimeter.app.recordings.journal import MAGIC, JournalWriter, RecordedConfiguration
from stadimeter.app.recordings.recorder import Writer
from stadimeter.app.recordings.recording import Recorded, RecordingWriter
from stadimeter.config.camera_file import camera_file_text, load_camera_model, save_camera_model
from stadimeter.core.alarms.machine import AlarmRecord
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.frame import Frame
from stadimeter.core.message import Message
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.persistence import AlarmSnapshot
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import JournalError
from stadimeter.workbench.replay import read_recording
from support.observing import Rehearsal

LENS = CameraModel.with_focal_length(600.0, 640, 480)
OTHER_LENS = CameraModel.with_focal_length(650.0, 640, 480)

CONFIGURATION = """
[camera]
driver = "simulated"
model = "camera.toml"

[targets.ball]
detector = "ideal"

[actuators.buzzer]
driver = "simulated"

[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]

[rules.near]
actuator = "buzzer"
when = {{ below = "{below}" }}
"""


class Saving(Struct, frozen=True):
    """A kind of save.

    Attributes:
        prepare: Makes what is there before.
        save: Saves, and yields after each step.
        read: Returns what the program finds when it starts, and raises what it would end with. May change the files.
    """

    prepare: Callable[[Path], object]
    save: Callable[[Path], Iterator[object]]
    read: Callable[[Path], object]


def nothing(_folder: Path) -> None:
    """Leave the folder empty."""


def setup_files(focal: CameraModel, below: str) -> dict[str, str]:
    """Return what `init` writes, in its order."""
    return {"camera.toml": camera_file_text(focal), "stadimeter.toml": CONFIGURATION.format(below=below)}


def save_lens(folder: Path) -> Iterator[object]:
    yield save_camera_model(folder / "camera.toml", OTHER_LENS)


def read_lens(folder: Path) -> object:
    return load_camera_model(folder / "camera.toml").fx_px if (folder / "camera.toml").exists() else None


def save_lens_through_link(folder: Path) -> Iterator[object]:
    yield save_camera_model(folder / "link.toml", OTHER_LENS)


def prepare_lens(folder: Path) -> None:
    save_camera_model(folder / "camera.toml", LENS)


def prepare_linked_lens(folder: Path) -> None:
    prepare_lens(folder)
    (folder / "link.toml").symlink_to("camera.toml")


def read_linked_lens(folder: Path) -> object:
    assert (folder / "link.toml").is_symlink()
    return load_camera_model(folder / "link.toml").fx_px


def memory(*rules: str, messages: int = 0) -> Memory:
    """Return what some alarms remember, and some messages that wait."""
    return Memory(
        moment=ClockReading(clock="boot", at_s=1.0 + messages, unix_s=1.7e9, is_synchronised=True),
        alarms=tuple(AlarmSnapshot(rule=rule, meaning="a" * 64, record=AlarmRecord()) for rule in rules),
        undelivered=tuple(("", Message(topic="event/alarm", payload=f"{n} {'x' * 2000}")) for n in range(messages)),
    )


MEMORIES = (memory("near"), memory("near", "far"), memory("far"), memory("far", messages=130), memory("last"))
"""The fourth is larger than the log of the file may be, so that the log is taken over into it."""


def save_state(folder: Path) -> Iterator[object]:
    store = AlarmStore(folder / "state" / "run.sqlite3")
    yield store.open()
    for each in MEMORIES:
        store.write(each)
        yield store.flush()
    yield store.close()


def prepare_state(folder: Path) -> None:
    """Leave a state file as a run does that was killed: with its log beside it."""
    for _ in save_state(folder):
        pass
    store = AlarmStore(folder / "state" / "run.sqlite3")
    store.open()
    store.write(memory("before"))
    files = {file: file.read_bytes() for file in (folder / "state").iterdir() if not file.name.endswith("-shm")}
    store.close()
    for file, data in files.items():
        file.write_bytes(data)


def read_state(folder: Path) -> object:
    store = AlarmStore(folder / "state" / "run.sqlite3")
    found = store.open()
    store.close()
    assert store.warning == "", store.warning
    return found


def cycles_of(count: int) -> Iterator[CycleRecord]:
    """Yield the cycles of a run whose target comes nearer, and whose alarm goes off."""
    buzzer = AlarmRule(name="near", target="ball", output="buzzer", condition=DistanceCondition(below=1.0))
    rehearsal = Rehearsal(Plan(targets=("ball",), rules=(buzzer,), outputs=(LevelOutput(name="buzzer"),)))
    for number in range(count):
        decision = rehearsal.see(2.0 - number / 10)
        stamp = FrameStamp(captured_at_s=rehearsal.now_s, sequence=number)
        seen = Observation(now_s=rehearsal.now_s, frame=stamp)
        yield CycleRecord(observation=seen, decision=decision, applied=(), timings_s={"decide": 1e-4})


def new_journal(folder: Path) -> Writer:
    return JournalWriter(folder / "run.jsonl", RecordedConfiguration(text="# configuration"))


def new_recording(folder: Path) -> Writer:
    recorded = Recorded(configuration=RecordedConfiguration(text="# configuration"), camera=LENS)
    return RecordingWriter(folder / "run.mcap", recorded)


def save_cycles(writer: Writer, count: int) -> Iterator[object]:
    for record in cycles_of(count):
        number = record.observation.frame.sequence if record.observation.frame else 0
        picture = Frame(np.full((48, 64, 3), 10 + number, np.uint8), record.observation.now_s, number)
        yield writer.write(record, picture)
    yield writer.close()


def save_journal(folder: Path) -> Iterator[object]:
    yield from save_cycles(new_journal(folder), 20)


def save_recording(folder: Path) -> Iterator[object]:
    yield from save_cycles(new_recording(folder), 25)


def prepare_journal(folder: Path) -> None:
    for _ in save_cycles(new_journal(folder), 3):
        pass


def prepare_recording(folder: Path) -> None:
    for _ in save_cycles(new_recording(folder), 3):
        pass


def times_of(file: Path) -> list[float]:
    """Return when each cycle was; none where a cut came before the first, which the reader says."""
    try:
        return [cycle.record().observation.now_s for cycle in read_recording(file).cycles()]
    except JournalError as error:
        if "ends before its first cycle" not in str(error):
            raise
        return []


def read_records(folder: Path) -> object:
    """Return how many cycles each file holds, after a further run has begun to write under the same name."""
    name = "run.jsonl" if any(folder.glob("*.jsonl")) else "run.mcap"
    writer = new_journal(folder) if name == "run.jsonl" else new_recording(folder)
    for record in cycles_of(1):
        writer.write(record)
    writer.close()
    counts = {}
    for file in folder.glob(f"run*{Path(name).suffix}"):
        if file.name != name and file.stat().st_size > len(MAGIC):
            counts[file.name] = times_of(file)
    return sorted(filter(None, counts.values()))


def save_events(folder: Path) -> Iterator[object]:
    log = EventLog(folder / "run.log", is_right=lambda: True, clock=count(0, 1000).__next__)
    for number in range(12):
        yield log.say(f"event {number}: {'x' * 900}")
        yield log.step()


def prepare_events(folder: Path) -> None:
    """Leave a log that must make room after a few lines, and older ones."""
    line = "before " + "x" * 992 + "\n"
    (folder / "run.log.1").write_text(line * 3)
    (folder / "run.log").write_text(line * (FILE_BYTES_MAX // len(line) - 3))


def read_events(folder: Path) -> object:
    """Return how many lines there were before, and the events of the run."""
    lines = [line for file in log_files(folder / "run.log") for line in file.read_text("utf-8").splitlines()]
    events = [line for line in lines if not line.startswith("before")]
    return len(lines) - len(events), [int(line.partition("event ")[2].partition(":")[0]) for line in events]


SAVINGS = {
    "a camera file": Saving(nothing, save_lens, read_lens),
    "a camera file over an older one": Saving(prepare_lens, save_lens, read_lens),
    "a camera file through a link": Saving(prepare_linked_lens, save_lens_through_link, read_linked_lens),
    "a new state file": Saving(nothing, save_state, read_state),
    "the state file of a run that was killed": Saving(prepare_state, save_state, read_state),
    "a journal": Saving(nothing, save_journal, read_records),
    "a journal over an older one": Saving(prepare_journal, save_journal, read_records),
    "a recording": Saving(nothing, save_recording, read_records),
    "an event log": Saving(nothing, save_events, read_events),
    "an event log that makes room": Saving(prepare_events, save_events, read_events),
    "a recording over an older one": Saving(prepare_recording, save_recording, read_records),
}
