"""The event log, on a clock that is stepped, in real files and on a real disk that is full."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import pytest

from stadimeter.app import event_log
from stadimeter.app.event_log import BATCH_EVERY_S, FILE_BYTES_MAX, FILES_MAX, URGENT_EVERY_S, EventLog, log_files
from stadimeter.app.loop import RecordingSink
from stadimeter.core.decision import Event, EventKind, SafetyMode, Severity
from stadimeter.testing.rig import ManualClock

NOON = datetime(2026, 7, 1, 12, 0, tzinfo=UTC)


class Rig:
    """A log whose disk and clocks we hold. The thread that writes is played by `pass_s`."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "box.log"
        self.clock = ManualClock(1000.0)
        self.set_by_s = 0.0
        self.is_right = True
        self.log = EventLog(self.path, now=self.now, is_right=lambda: self.is_right, clock=self.clock.now_s)

    def now(self) -> datetime:
        return NOON + timedelta(seconds=self.clock.now_s() - 1000.0 + self.set_by_s)

    def event(self, kind: EventKind, source: str = "near", reason: str = "", by: str = "") -> None:
        event = Event(kind=kind, source=source, at_s=0.0, severity=Severity.WARNING, reason=reason, by=by)
        decision = SimpleNamespace(events=(event,), safety=SafetyMode.ACTIVE)
        self.log(SimpleNamespace(decision=decision))  # type: ignore[arg-type]

    def pass_s(self, seconds: float) -> None:
        for _ in range(round(seconds)):
            self.clock.advance_s(1.0)
            self.log.step()

    def lines(self) -> list[str]:
        return self.path.read_text().splitlines() if self.path.exists() else []


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


def test_it_says_when_and_what_in_words(rig):
    rig.event(EventKind.RAISED, reason="0.45 m, below 0.50 m")
    rig.event(EventKind.ACKNOWLEDGED, by="zoe")
    rig.log.close()
    assert rig.lines() == [
        "2026-07-01 12:00:00.000+00:00  warning: near raised: 0.45 m, below 0.50 m",
        "2026-07-01 12:00:00.000+00:00  warning: near acknowledged by zoe",
    ]


def test_what_rules_do_is_written_once_a_minute_and_a_quiet_hour_writes_nothing(rig):
    rig.event(EventKind.RAISED)
    rig.pass_s(BATCH_EVERY_S - 1)
    rig.event(EventKind.CLEARED)
    assert rig.lines() == []
    rig.pass_s(1)
    assert len(rig.lines()) == 2
    rig.path.unlink()
    rig.pass_s(3600)
    assert not rig.path.exists()


def test_a_fault_is_on_the_disk_within_a_second(rig, monkeypatch):
    flushed: list[int] = []
    monkeypatch.setattr(os, "fdatasync", flushed.append)
    rig.event(EventKind.RAISED)
    rig.event(EventKind.FAULT, source="camera", reason="it was unplugged")
    rig.pass_s(1)
    assert [line.split(": ", 1)[1] for line in rig.lines()] == ["near raised", "camera fault: it was unplugged"]
    assert len(flushed) == 1
    rig.event(EventKind.RAISED)
    rig.pass_s(BATCH_EVERY_S + 1)
    assert (len(rig.lines()), len(flushed)) == (3, 1)


def test_a_loose_contact_does_not_wear_out_the_disk(rig, monkeypatch):
    writes: list[bytes] = []
    monkeypatch.setattr(event_log, "_append_whole", lambda _path, data, **_: writes.append(data))
    for _ in range(120):
        rig.event(EventKind.FAULT)
        rig.pass_s(1)
    assert len(writes) <= 120 / URGENT_EVERY_S + 1
    rig.log.close()
    assert b"".join(writes).count(b"\n") == 120


def test_a_reason_makes_no_line_and_commands_no_terminal(rig):
    rig.event(EventKind.FAULT, reason="gone\n2026-07-01 12:00:00 \x1b[2Jeverything is fine µ")
    rig.log.close()
    assert rig.lines()[0].endswith("gone 2026-07-01 12:00:00 [2Jeverything is fine µ")


def test_a_clock_that_nobody_vouches_for_is_marked_and_it_is_said_by_how_much_it_was_set(rig):
    rig.is_right = False
    log = EventLog(rig.path, now=rig.now, is_right=lambda: rig.is_right, clock=rig.clock.now_s)
    log.say("started")
    rig.clock.advance_s(5.0)
    rig.set_by_s, rig.is_right = 7200.0, True
    log.say("configuration reloaded")
    log.close()
    assert rig.lines() == [
        "2026-07-01 12:00:00.000+00:00? started",
        "2026-07-01 14:00:05.000+00:00  the clock was set by +7200 s: add that to the times with ?",
        "2026-07-01 14:00:05.000+00:00  configuration reloaded",
    ]


def test_a_run_that_was_killed_is_noticed_by_the_next(rig):
    rig.log.start("first")
    rig.pass_s(1)
    killed, ended = Rig(rig.path.parent), Rig(rig.path.parent)
    killed.log.start("second")
    killed.log.end("SIGTERM")
    ended.log.start("third")
    ended.log.end("SIGTERM")
    rig.log.close()
    assert [line.split("  ")[1] for line in rig.lines()] == [
        "started: first",
        "started: second; the run before it was killed, or had no power",
        "ended: SIGTERM",
        "started: third",
        "ended: SIGTERM",
    ]


def test_a_camera_that_gives_nothing_from_the_start_on_is_noted_once_and_its_first_frames_too(rig):
    def cycle(safety: SafetyMode) -> None:
        decision = SimpleNamespace(events=(), safety=safety, safety_reason="there is no camera")
        rig.log(SimpleNamespace(decision=decision))  # type: ignore[arg-type]

    for safety in (SafetyMode.STARTING, SafetyMode.ACTIVE, SafetyMode.STALE):
        for _ in range(60):
            cycle(safety)
            rig.pass_s(1)
    assert [line.split("  ")[1] for line in rig.lines()] == [
        "camera: there is no camera",
        "camera: the first frames have come",
    ]


def test_it_never_grows_beyond_its_bound(rig, monkeypatch):
    monkeypatch.setattr(event_log, "FILE_BYTES_MAX", 1000)
    for number in range(300):
        rig.log.say(f"number {number}")
        rig.pass_s(URGENT_EVERY_S + 1)
    files = log_files(rig.path)
    assert [file.name for file in files] == [*(f"box.log.{n}" for n in range(FILES_MAX - 1, 0, -1)), "box.log"]
    assert all(file.stat().st_size <= 1000 for file in files)
    words = [line.rsplit(" ", 1)[1] for file in files for line in file.read_text().splitlines()]
    assert words == [str(number) for number in range(300 - len(words), 300)]
    assert len(words) > 50
    assert FILE_BYTES_MAX * FILES_MAX == 5_000_000


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system of 64 kB."""
    if os.geteuid() != 0:
        pytest.skip("only root may mount")
    if os.system(f"mount -t tmpfs -o size=64k tmpfs '{tmp_path}' 2>/dev/null"):  # noqa: S605
        pytest.skip("file systems cannot be mounted here")
    yield tmp_path
    os.system(f"umount '{tmp_path}'")  # noqa: S605


def test_a_full_disk_is_told_and_nothing_is_cut_in_half_or_lost_when_there_is_room(full_disk):
    rig = Rig(full_disk)
    rig.log.say("first")
    rig.pass_s(1)
    (full_disk / "other").write_bytes(b"x" * 60_000)
    rig.log.say("second " + "x" * 20_000)
    rig.pass_s(URGENT_EVERY_S + 1)
    assert len(rig.lines()) == 1
    assert rig.log.trouble() == f"the event log {rig.path} is not written: {os.strerror(errno.ENOSPC)}"
    (full_disk / "other").unlink()
    rig.pass_s(BATCH_EVERY_S + 1)
    assert [line.split("  ")[1].split()[0] for line in rig.lines()] == ["first", "second"]
    assert rig.log.trouble() == ""


def test_of_what_a_disk_never_takes_the_newest_is_kept_and_the_rest_is_counted(rig, monkeypatch):
    monkeypatch.setattr(event_log, "WAITING_MAX", 3)
    rig.path.mkdir()
    for number in range(10):
        rig.log.say(f"number {number}")
        rig.pass_s(BATCH_EVERY_S + 1)
    assert "Is a directory" in rig.log.trouble()
    rig.path.rmdir()
    rig.pass_s(BATCH_EVERY_S + 1)
    assert rig.lines()[0].startswith("7 lines before this one are missing: ")
    assert [line.rsplit(" ", 1)[1] for line in rig.lines()[1:]] == ["7", "8", "9"]


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/etc/hostname")])
def test_only_a_file_is_written(rig, make):
    make(rig.path)  # type: ignore[operator]
    before = Path("/etc/hostname").read_bytes()
    rig.log.say("started")
    rig.log.close()
    assert rig.log.trouble()
    assert Path("/etc/hostname").read_bytes() == before


def test_the_loop_tells_it_of_reloads(rig):
    assert isinstance(rig.log, RecordingSink)
    rig.log.note_reload(0.0, None)  # type: ignore[arg-type]
    rig.log.close()
    assert rig.lines()[0].endswith("configuration reloaded")
