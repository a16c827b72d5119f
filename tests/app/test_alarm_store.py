"""The state file: what was written is read again, or put aside; never half of it, and never something else."""

import math
import random
import sqlite3
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.app.persistence.alarm_store import AlarmStore, moved_on
from stadimeter.app.persistence.resumption import ClockReading, Memory
from stadimeter.core.alarms.machine import AlarmRecord, AlarmState
from stadimeter.core.alarms.state import Inhibits, Leg, Resumed, Timers
from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.message import Message, Notification
from stadimeter.core.persistence import Absence, AlarmSnapshot
from stadimeter.errors import StateError

RAISED = Event(
    kind=EventKind.RAISED, source="near", at_s=11.0, severity=Severity.ALARM, reason="0.43 m is below 0.50 m"
)
ACTIVE = AlarmRecord(
    state=AlarmState.UNACKNOWLEDGED,
    timers=Timers(held_last=True, recent=(True, False), was_judged=True),
    raised_at_s=11.1,
    reported_at_s=11.1,
    notified_at_s=11.1,
    leg=Leg(on="raised", began_s=11.1, event=RAISED, sent=(0, 2)),
    inhibits=Inhibits(shelved_until_s=1811.0, is_one_shot=True, shelved_by="Zoë"),
    resumed=Resumed(from_s=math.inf, at_s=3.0),
)
NEAR = AlarmSnapshot(rule="near", meaning="a" * 64, record=ACTIVE, is_first_out=True)
FAR = AlarmSnapshot(rule="far", meaning="b" * 64, record=AlarmRecord())
NOON = ClockReading(clock="boot one", at_s=12.5, unix_s=1.7e9, is_synchronised=True)


LEFT = (
    ("", Message(topic="event/alarm", payload='{"id":"a-1","reason":"0.43 m ± 0.01"}', qos=1)),
    ("", Message(topic="door/alert", payload="on", qos=1, retain=True)),
    ("", Message(topic="door/alert", payload="on", qos=1, retain=True)),
    ("phone", Notification(title="near", body="0.43 m", severity=Severity.ALARM, time="2026-06-01T22:14:03+02:00")),
)


def remembered(*alarms, undelivered=LEFT):
    absent = (Absence(target="ball", since_s=3.25),)
    return Memory(moment=NOON, alarms=alarms, absent=absent, undelivered=undelivered)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "state" / "run.sqlite3"


@pytest.fixture
def store(path):
    store = AlarmStore(path)
    store.open()
    yield store
    store.close()


def written(path, *alarms):
    store = AlarmStore(path)
    store.open()
    store.write(remembered(*alarms))
    store.close()
    return path


def by_rule(alarms):
    return sorted(alarms, key=lambda alarm: alarm.rule)


def read(path):
    store = AlarmStore(path)
    memory = store.open()
    store.close()
    return memory, store.warning


def test_only_the_user_can_read_a_new_file_and_what_is_kept_beside_it(path, store):
    store.write(remembered(NEAR))
    modes = {each.name: each.stat().st_mode & 0o777 for each in path.parent.iterdir()}
    store.close()
    assert set(modes) >= {"run.sqlite3", "run.sqlite3-wal"}
    assert set(modes.values()) == {0o600}


def test_what_was_written_is_read_again_to_the_last_bit(path):
    memory, warning = read(written(path, NEAR, FAR))
    assert memory.moment == NOON
    assert memory.absent == (Absence(target="ball", since_s=3.25),)
    assert by_rule(memory.alarms) == by_rule([NEAR, FAR])
    assert memory.undelivered == LEFT
    assert warning == ""


def alert(number):
    return "", Message(topic="event/alarm", payload=str(number), qos=1)


def test_who_stopped_the_outputs_is_read_again_until_they_are_released(path):
    store = AlarmStore(path)
    store.open()
    for stopped in ("by Zoë: a child", "by Zoë: a child", ""):
        store.write(replace(remembered(NEAR), stopped=stopped))
        store.close()
        store = AlarmStore(path)
        assert store.open().stopped == stopped
    store.close()


@pytest.mark.long
@given(
    steps=st.lists(
        st.lists(st.tuples(st.sampled_from(["", "phone"]), st.sampled_from("abc")), max_size=8), min_size=2, max_size=5
    )
)
def test_rows_become_whatever_queues_became(steps):
    rows = {}
    for queued in steps:
        after = moved_on(rows, queued)
        assert all(rows[number] == after[number] for number in {*rows} & {*after})
        rows = after
        for name in ("", "phone"):
            assert [row for _, row in sorted(rows.items()) if row[0] == name] == [
                row for row in queued if row[0] == name
            ]


@pytest.mark.long
def test_a_change_that_was_cut_off_by_a_power_cut_leaves_what_was_there_before(path, store):
    store.write(remembered(FAR))
    log = path.with_name(path.name + "-wal")
    before = log.stat().st_size
    store.write(remembered(NEAR, FAR))
    files = {path: path.read_bytes(), log: log.read_bytes()}
    store.close()
    for cut in range(before, len(files[log]), 397):
        path.write_bytes(files[path])
        log.write_bytes(files[log][:cut])
        memory, warning = read(path)
        assert memory.alarms == (FAR,)
        assert warning == ""


SEVERAL = (NEAR, FAR, *(replace(NEAR, rule=f"gate {number}", meaning=f"{number:064x}") for number in range(8)))


@pytest.mark.parametrize("flips", [200, pytest.param(10_000, marks=[pytest.mark.long, pytest.mark.timeout(1800)])])
def test_flipped_bytes_are_damage_and_never_another_memory_or_the_end_of_a_start(path, flips):
    store = AlarmStore(path)
    store.open()
    store.write(remembered(*SEVERAL[:6]))
    store.write(remembered(*SEVERAL))
    log = path.with_name(path.name + "-wal")
    good = {path: path.read_bytes(), log: log.read_bytes()}  # as a power cut would leave them
    store.close()
    closed = {path: path.read_bytes()}
    chance, seen = random.Random(9), Counter()  # noqa: S311 - the same flips each time
    for number in range(flips):
        files = dict(closed if number % 2 else good)
        file = chance.choice(list(files))
        place = chance.randrange(len(files[file]))
        files[file] = (
            files[file][:place] + bytes([files[file][place] ^ chance.randrange(1, 256)]) + files[file][place + 1 :]
        )
        for each in path.parent.iterdir():
            each.unlink()
        for each, content in files.items():
            each.write_bytes(content)
        store = AlarmStore(path)
        memory = store.open()
        store.write(remembered(FAR))
        store.close()
        seen["damaged" if store.warning else "whole"] += 1
        if store.warning:
            assert memory is None
            assert "is damaged" in store.warning or "version of stadimeter" in store.warning
            assert list(path.parent.glob(f"{path.name}.*-1"))
        else:
            # A log with a wrong frame ends before it: what was written before that.
            possible = (by_rule(SEVERAL), by_rule(SEVERAL[:6]))
            assert by_rule(memory.alarms) in possible if memory else file == log
        assert read(path)[0].alarms == (FAR,)
    assert seen["damaged"] > flips / 20
    assert seen["whole"] > flips / 20


def broken(path, statement, *values):
    """Change a state file in a way that SQLite takes for right."""
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA writable_schema = ON")
        database.execute(statement, values)
    database.close()


ENDLESS = """CREATE VIEW memory AS WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n)
SELECT x AS key, x AS value FROM n"""

ALARM = "UPDATE memory SET value = {} WHERE key = 'alarm near'"


@pytest.mark.parametrize(
    ("statement", "values"),
    [
        (ALARM.format("CAST(x'ff9241' AS TEXT)"), ()),
        (ALARM.format("?"), (b"bytes",)),
        (ALARM.format("?"), (2**62,)),
        (ALARM.format("json_set(value, '$.state.phase', 'asleep')"), ()),
        (ALARM.format("?"), ("[" * 100_000,)),
        (ALARM.format("?"), ("9" * 5_000,)),
        (ALARM.format("CAST(zeroblob(3000000) AS TEXT)"), ()),
        ("UPDATE memory SET value = ? WHERE key = 'moment'", (1.5,)),
        ("DELETE FROM memory WHERE key = 'checksum'", ()),
        ("DELETE FROM memory WHERE key = 'undelivered 000000002'", ()),
        ("UPDATE memory SET key = 'undelivered x' WHERE key = 'undelivered 000000002'", ()),
        ("UPDATE sqlite_schema SET sql = 'CREATE TABLE memory (one)' WHERE name = 'memory'", ()),
        ("DELETE FROM sqlite_schema WHERE name = 'memory'", ()),
        ("UPDATE sqlite_schema SET type = 'view', rootpage = 0, sql = ? WHERE name = 'memory'", (ENDLESS,)),
    ],
)
def test_whatever_a_file_of_ours_holds_is_damage_and_costs_little(path, statement, values):
    broken(written(path, NEAR, FAR), statement, *values)
    memory, warning = read(path)
    assert memory is None
    assert f"{path} is damaged: " in warning
    assert path.with_name("run.sqlite3.damaged-1").exists()


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
    store.write(remembered(FAR))
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


@pytest.mark.parametrize(("version", "words", "name"), [(7, "a later", "newer"), (5, "an earlier", "older")])
def test_a_file_of_another_version_is_put_aside_and_named_so(path, version, words, name):
    written(path, NEAR)
    with sqlite3.connect(path) as database:
        database.execute(f"PRAGMA user_version = {version}")
    database.close()
    memory, warning = read(path)
    assert memory is None
    assert f"was written by {words} version of stadimeter (format {version}, not 6); it is now" in warning
    assert path.with_name(f"run.sqlite3.{name}-1").exists()


def test_those_that_were_put_aside_before_are_not_replaced(path):
    path.parent.mkdir()
    for content in (b"first", b"second"):
        path.write_bytes(content)
        read(path)
    assert path.with_name("run.sqlite3.damaged-1").read_bytes() == b"first"
    assert path.with_name("run.sqlite3.damaged-2").read_bytes() == b"second"


def test_a_second_run_on_the_same_file_is_refused_and_the_first_goes_on(path):
    first = AlarmStore(path)
    first.open()
    first.write(remembered(FAR))
    with pytest.raises(StateError, match="is used by another run"):
        AlarmStore(path).open()
    first.write(remembered(NEAR))
    first.close()
    assert read(path)[0].alarms == (NEAR,)


def test_a_full_disk_leaves_the_file_as_it_was_and_a_later_write_succeeds(path, store):
    store.write(remembered(FAR))
    (pages,) = store._database.execute("PRAGMA page_count").fetchone()
    store._database.execute(f"PRAGMA max_page_count = {pages}")
    many = tuple(replace(NEAR, rule=f"near-{number}") for number in range(40))
    with pytest.raises(StateError, match=r"cannot be written: .*full"):
        store.write(remembered(*many))
    store._database.execute("PRAGMA max_page_count = 10000")
    store.write(remembered(FAR, NEAR))
    store.close()
    assert by_rule(read(path)[0].alarms) == by_rule([FAR, NEAR])


def database_of_somebody(path):
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("CREATE TABLE photos (name TEXT)")
    database.close()


@pytest.mark.parametrize("make", [lambda path: path.write_text("a diary\n" * 400), database_of_somebody])
def test_a_file_of_somebody_else_that_was_named_is_refused_and_stays_as_it_is(path, make):
    path.parent.mkdir()
    make(path)
    before = path.read_bytes()
    with pytest.raises(StateError, match="is no state file, and was left as it is; name another file with --state"):
        AlarmStore(path, is_named=True).open()
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]
