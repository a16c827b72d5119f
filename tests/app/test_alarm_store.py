"""The state file: what was written is read again, or put aside; never half of it, and never something else."""

import json
import math
import signal
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from stadimeter.app.keeping.alarm_store import AlarmStore, Memory
from stadimeter.app.keeping.moments import Moment
from stadimeter.core.alarms.state import AlarmState, Gates, Leg, Resumed, Timers
from stadimeter.core.alarms.table import Phase
from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.rules.keeping import Absence, KeptAlarm
from stadimeter.errors import StateError

RAISED = Event(
    kind=EventKind.RAISED, source="near", at_s=11.0, severity=Severity.ALARM, reason="0.43 m is below 0.50 m"
)
ACTIVE = AlarmState(
    phase=Phase.UNACKNOWLEDGED,
    timers=Timers(held_last=True, recent=(True, False), was_judged=True),
    raised_at_s=11.1,
    reported_at_s=11.1,
    notified_at_s=11.1,
    leg=Leg(on="raised", began_s=11.1, event=RAISED, sent=(0, 2)),
    gates=Gates(shelved_until_s=1811.0, is_one_shot=True, shelved_by="Zoë"),
    resumed=Resumed(from_s=math.inf, at_s=3.0),
)
NEAR = KeptAlarm(rule="near", meaning="a" * 64, state=ACTIVE, is_first_out=True)
FAR = KeptAlarm(rule="far", meaning="b" * 64, state=AlarmState())
NOON = Moment(clock="boot one", at_s=12.5, unix_s=1.7e9, is_synchronised=True)


def remembered(*alarms):
    return Memory(moment=NOON, alarms=alarms, absent=(Absence(target="ball", since_s=3.25),))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "state" / "run.sqlite3"


def written(path, *alarms):
    store = AlarmStore(path)
    store.open()
    store.write(remembered(*alarms))
    store.close()
    return path


def read(path):
    store = AlarmStore(path)
    memory = store.open()
    store.close()
    return memory, store.warning


def test_what_was_written_is_read_again_to_the_last_bit(path):
    memory, warning = read(written(path, NEAR, FAR))
    assert memory.moment == NOON
    assert memory.absent == (Absence(target="ball", since_s=3.25),)
    assert set(memory.alarms) == {NEAR, FAR}
    assert warning == ""


def test_nothing_is_remembered_at_first(path):
    assert read(path) == (None, "")


def test_an_alarm_that_is_not_there_any_more_is_forgotten(path):
    store = AlarmStore(path)
    store.open()
    store.write(remembered(NEAR, FAR))
    store.write(
        remembered(
            FAR,
        )
    )
    store.close()
    memory, _ = read(path)
    assert memory.alarms == (FAR,)


def test_only_what_changed_is_written(path):
    store = AlarmStore(path)
    store.open()
    store.write(remembered(NEAR, FAR))
    statements = []
    store._database.set_trace_callback(statements.append)
    store.write(remembered(NEAR, replace(FAR, meaning="c" * 64)))
    store.close()
    assert len([each for each in statements if "INTO alarm" in each]) == 1


KILLED = """
import os, signal, sys
from pathlib import Path

sys.path.insert(0, sys.argv[2])
from test_alarm_store import FAR, NEAR, AlarmStore, remembered

store = AlarmStore(Path(sys.argv[1]))
store.open()
store.write(remembered(NEAR,))
store.write(remembered(NEAR, FAR))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_process_that_is_killed_leaves_what_it_wrote_last(path):
    done = subprocess.run(
        [sys.executable, "-c", KILLED, path, Path(__file__).parent], capture_output=True, text=True, check=False
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    memory, warning = read(path)
    assert set(memory.alarms) == {NEAR, FAR}
    assert warning == ""


def test_a_change_that_was_cut_off_by_a_power_cut_leaves_what_was_there_before(path):
    store = AlarmStore(path)
    store.open()
    store.write(
        remembered(
            FAR,
        )
    )
    log = path.with_name(path.name + "-wal")
    before = log.stat().st_size
    store.write(remembered(NEAR, FAR))
    files = {path: path.read_bytes(), log: log.read_bytes()}
    store.close()
    for cut in range(before, len(files[log]), 97):
        path.write_bytes(files[path])
        log.write_bytes(files[log][:cut])
        memory, warning = read(path)
        assert memory.alarms == (FAR,)
        assert warning == ""


def test_a_flipped_byte_anywhere_never_becomes_another_memory(path):
    good = written(path, NEAR, FAR).read_bytes()
    expected, _ = read(path)
    for place in [*range(120), *range(120, len(good), 61)]:
        path.write_bytes(good[:place] + bytes([good[place] ^ 0x41]) + good[place + 1 :])
        memory, warning = read(path)
        if warning:
            assert memory is None
            assert "damaged" in warning or "later version" in warning
        else:
            assert memory == expected
    asides = list(path.parent.glob("run.sqlite3.damaged-*"))
    assert len(asides) > 50
    assert not list(path.parent.glob("*-wal"))


def test_a_damaged_file_is_put_aside_and_the_run_starts_without_it(path):
    good = written(path, NEAR).read_bytes()
    bad = good.replace(b"0.43 m", b"0.42 m")
    assert bad != good
    path.write_bytes(bad)
    store = AlarmStore(path)
    assert store.open() is None
    assert store.warning == (
        f"{path} is damaged: its checksum is wrong; it is now {path}.damaged-1, and the alarms start anew"
    )
    store.write(
        remembered(
            FAR,
        )
    )
    store.close()
    assert path.with_name("run.sqlite3.damaged-1").read_bytes() == bad
    assert read(path)[0].alarms == (FAR,)


@pytest.mark.parametrize("content", [b"rules: none\n" * 400, b"SQLite format 3\0" + b"\0" * 84, b"\xff" * 5000, b"x"])
def test_a_file_of_something_else_is_put_aside_unharmed(path, content):
    path.parent.mkdir()
    path.write_bytes(content)
    memory, warning = read(path)
    assert memory is None
    assert "is damaged" in warning
    assert path.with_name("run.sqlite3.damaged-1").read_bytes() == content


def test_the_database_of_another_program_is_put_aside_unharmed(path):
    path.parent.mkdir()
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE photos (name TEXT)")
    database.close()
    _, warning = read(path)
    assert "it is no state file" in warning


def test_a_file_of_a_later_version_is_put_aside_and_named_so(path):
    written(path, NEAR)
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA user_version = 7")
    database.close()
    memory, warning = read(path)
    assert memory is None
    assert "written by a later version of stadimeter (format 7, not 1); it is now" in warning
    assert path.with_name("run.sqlite3.newer-1").exists()


def test_those_that_were_put_aside_before_are_not_replaced(path):
    path.parent.mkdir()
    for content in (b"first", b"second"):
        path.write_bytes(content)
        read(path)
    assert path.with_name("run.sqlite3.damaged-1").read_bytes() == b"first"
    assert path.with_name("run.sqlite3.damaged-2").read_bytes() == b"second"


def test_a_memory_that_no_alarm_can_have_is_refused_whole(path):
    written(path, NEAR)
    with sqlite3.connect(path) as database:
        (memory,) = database.execute("SELECT memory FROM alarm").fetchone()
        changed = json.loads(memory)
        changed[0]["state"]["phase"] = "asleep"
        database.execute("UPDATE alarm SET memory = ?", (json.dumps(changed),))
    database.close()
    memory, warning = read(path)
    assert memory is None
    assert "is damaged" in warning


def test_a_second_run_on_the_same_file_is_refused_and_the_first_goes_on(path):
    first = AlarmStore(path)
    first.open()
    first.write(remembered(FAR))
    with pytest.raises(StateError, match="is used by another run"):
        AlarmStore(path).open()
    first.write(remembered(NEAR))
    first.close()
    assert read(path)[0].alarms == (NEAR,)


def test_a_full_disk_leaves_the_file_as_it_was_and_a_later_write_succeeds(path):
    store = AlarmStore(path)
    store.open()
    store.write(
        remembered(
            FAR,
        )
    )
    (pages,) = store._database.execute("PRAGMA page_count").fetchone()
    store._database.execute(f"PRAGMA max_page_count = {pages}")
    many = tuple(replace(NEAR, rule=f"near-{number}") for number in range(40))
    with pytest.raises(StateError, match=r"cannot be written: .*full"):
        store.write(remembered(*many))
    store._database.execute("PRAGMA max_page_count = 10000")
    store.write(remembered(FAR, NEAR))
    store.close()
    assert set(read(path)[0].alarms) == {FAR, NEAR}


@pytest.mark.parametrize("name", ["/proc/none/run.sqlite3", "/dev/null/run.sqlite3"])
def test_a_place_that_cannot_be_written_is_told_plainly(name):
    with pytest.raises(StateError, match="cannot be written"):
        AlarmStore(Path(name)).open()
