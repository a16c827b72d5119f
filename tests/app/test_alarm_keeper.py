"""Alarms are remembered: written seldom, never by the loop itself, and found again after a restart."""

import threading
from functools import partial

import pytest
from msgspec.structs import replace

from stadimeter.app.persistence.alarm_store import AlarmStore
from stadimeter.app.persistence.resumption import moment
from stadimeter.app.persistence.state_writer import StateWriter
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.message import Message
from stadimeter.core.plan import LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule, OnDelay
from stadimeter.errors import StateError
from stadimeter.testing.rig import eventually
from support.observing import Rehearsal

NEAR = AlarmRule(name="near", target="ball", output="buzzer", condition=DistanceCondition(below=1.0), off_delay_s=0.45)


def plan_of(*rules):
    return Plan(
        targets=("ball",),
        rules=rules,
        outputs=(LevelOutput(name="buzzer"),),
        tracking=Tracking(confirm_frames=1, coast_s=0.15, outliers_max=0, acceleration_mps2=20.0, autocorrelation=0.0),
        safety=Safety(good_frames=1),
    )


class Disk:
    """In place of the file."""

    def __init__(self):
        self.written = []
        self.trouble = ""
        self.warning = ""
        self.is_closed = False
        self.undelivered = ()
        self.is_free = threading.Event()
        self.is_free.set()
        self.takes = threading.Event()
        self.takes.set()

    def open(self):
        if self.trouble:
            raise StateError(self.trouble)

    def write(self, memory):
        if self.trouble:
            raise StateError(self.trouble)
        self.is_free.wait()
        self.undelivered = memory.undelivered
        self.written.append(memory.alarms)  # last: tests wait for it

    def flush(self):
        self.takes.wait()

    def close(self):
        self.is_closed = True


class Post:
    """In place of messenger and notifiers: what they have not delivered."""

    def __init__(self):
        self.left = ()
        self.sent_again = None

    def undelivered(self):
        return self.left

    def send_again(self, left, now_s, shift_s):
        self.sent_again = left


class Kept:
    """A run whose alarms are kept."""

    def __init__(self, store, *rules, clock="boot 1", clock_s=0.0, unix_s=1e9, is_right=True, post=None):
        self.run = Rehearsal(plan_of(*rules))
        self.run.now_s = clock_s
        self.keeper = StateWriter(store, partial(moment, clock, unix_s=lambda: unix_s, is_right=lambda: is_right), post)
        self.run.state = self.keeper.begin(clock_s, self.run.state) or self.run.state

    def see(self, *distances_m):
        for distance_m in distances_m:
            before = self.run.state
            decision = self.run.see(distance_m)
            self.keeper.cycle(before, self.run.state, decision.events)

    def end(self):
        return self.keeper.end(self.run.state)


@pytest.fixture
def disk():
    return Disk()


@pytest.mark.long
def test_a_quiet_hour_is_not_written_at_all_until_its_end(disk):
    kept = Kept(disk, NEAR)
    kept.see(*[3.0] * 200)
    kept.see(*[3.0, 3.02, 2.98, 3.01] * 300)
    assert len(disk.written) <= 1  # the first sight of the target
    kept.end()
    assert disk.is_closed


def test_timers_that_noise_begins_and_ends_are_written_every_ten_seconds_at_most(disk):
    kept = Kept(disk, replace(NEAR, on_delay=OnDelay(hold_s=30.0)))
    kept.see(*[3.0, 0.6, 3.0, 0.6, 3.0] * 120)
    kept.end()
    assert 1 <= len(disk.written) <= 60 / 10 + 2


MESSAGE = ("", Message(topic="event/alarm", payload="{}", qos=1))


def test_an_alarm_is_written_together_with_its_message(disk):
    post = Post()
    kept = Kept(disk, NEAR, post=post)
    kept.see(3, 3)
    post.left = (MESSAGE,)
    kept.see(0.6, 0.6, 0.6)
    assert eventually(lambda: disk.written and disk.written[-1][0].record.is_active)
    assert disk.undelivered == (MESSAGE,)
    kept.end()


def test_an_alarm_is_written_while_the_disk_still_flushes_the_one_before(disk):
    post = Post()
    kept = Kept(disk, NEAR, post=post)
    kept.see(3, 3)
    post.left = (MESSAGE,)
    disk.takes.clear()
    kept.see(0.6, 0.6, 0.6)
    eventually(lambda: disk.written and disk.written[-1][0].record.is_active)
    kept.see(*[3] * 8)
    eventually(lambda: not disk.written[-1][0].record.is_active)
    disk.takes.set()
    kept.end()


def test_an_alarm_does_not_wait_for_a_disk_that_hangs(disk):
    post = Post()
    kept = Kept(disk, NEAR, post=post)
    kept.see(3, 3)
    post.left = (MESSAGE,)
    disk.is_free.clear()
    kept.see(0.6, 0.6, 0.6)
    assert kept.run.events("near") == ["raised"]
    assert disk.written == []
    disk.is_free.set()
    kept.end()
    assert disk.undelivered == (MESSAGE,)


def test_what_nobody_acknowledges_is_written_soon_and_forgotten_with_what_is_written_next(disk):
    post = Post()
    kept = Kept(disk, NEAR, post=post)
    kept.see(3, 3)
    post.left = (MESSAGE,)
    eventually(lambda: disk.undelivered == (MESSAGE,))
    post.left = ()
    kept.see(0.6, 0.6, 0.6)
    eventually(lambda: disk.undelivered == ())
    assert kept.end() == ""
    assert kept.keeper.kept == ()


def test_what_an_earlier_run_left_is_sent_again_and_stays_in_the_file_until_it_is_acknowledged(path):
    first = Kept(AlarmStore(path), NEAR, post=Post())
    first.keeper._deliveries.left = (MESSAGE,)
    first.see(3, 3)
    first.end()
    for _ in range(2):
        post = Post()
        second = Kept(AlarmStore(path), NEAR, post=post)
        assert post.sent_again == (MESSAGE,)
        post.left = post.sent_again
        second.see(3, 3)
        second.end()


def test_a_disk_that_is_full_is_told_and_does_not_hold_up_the_run(disk):
    kept = Kept(disk, NEAR)
    disk.trouble = "run.sqlite3 cannot be written: database or disk is full"
    kept.see(3, 3, 0.6, 0.6, 0.6)
    assert eventually(kept.keeper.trouble) == disk.trouble
    disk.trouble = ""
    kept.see(3, 3, 3, 3, 3, 3, 3, 3)
    assert eventually(lambda: not kept.keeper.trouble() and disk.written[-1][0].record.is_active is False)
    assert kept.end() == ""


def test_a_defect_in_writing_is_told_and_does_not_hold_up_the_run(disk, monkeypatch):
    def defect(*_):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(disk, "write", defect)
    kept = Kept(disk, NEAR)
    kept.see(3, 3, 0.6, 0.6, 0.6)
    assert "ZeroDivisionError: a defect" in eventually(kept.keeper.trouble)
    assert "a defect" in kept.end()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.sqlite3"


def test_a_run_that_never_turned_leaves_the_file_as_it_was(path):
    first = Kept(AlarmStore(path), NEAR)
    first.see(3, 3, 0.6, 0.6, 0.6)
    first.end()
    Kept(AlarmStore(path), NEAR, clock_s=30.0).end()
    third = Kept(AlarmStore(path), NEAR, clock_s=60.0)
    assert third.run.state.rules.steps[0].record.is_active
    third.end()


SHELVED_S = 600.0


def shelved(path, **clock):
    first = Kept(AlarmStore(path), NEAR, clock_s=5000.0, **clock)
    first.see(3, 3)
    first.run.tell("shelve", "near", for_s=SHELVED_S)
    first.end()


def left_s(path, **clock):
    """Return for how long the alarm is still shelved in a run that begins now."""
    kept = Kept(AlarmStore(path), NEAR, **clock)
    until_s = kept.run.state.rules.steps[0].record.inhibits.shelved_until_s
    kept.end()
    return until_s - clock["clock_s"]


BOOTED = {"clock": "boot 2", "clock_s": 20.0, "unix_s": 1e9 + 100}


@pytest.mark.parametrize(
    ("before", "now", "passed_s"),
    [
        pytest.param({}, {"clock_s": 5100.2, "unix_s": 1e9 + 10_900}, 100, id="the wall clock was set forwards"),
        pytest.param({}, {"clock_s": 5100.2, "unix_s": 1e9 - 10_700}, 100, id="the wall clock was set back"),
        pytest.param({}, BOOTED, 100, id="the computer was off"),
        pytest.param({}, {**BOOTED, "is_right": False}, 0, id="the computer was off and has no time server"),
        pytest.param({"clock": "stepped"}, {"clock": "stepped", "clock_s": 0.0}, 0, id="a simulation begins anew"),
    ],
)
def test_of_a_time_that_was_left_exactly_what_is_known_to_have_passed_is_gone(path, before, now, passed_s):
    shelved(path, **before)
    assert left_s(path, **now) == pytest.approx(SHELVED_S - passed_s, abs=0.1)


def test_what_a_run_takes_over_is_text_that_gives_the_same_again(path):
    from stadimeter.app.persistence.resumption import read_state, state_text

    shelved(path)
    keeper = StateWriter(AlarmStore(path), partial(moment, "boot 2", unix_s=lambda: 1e9, is_right=lambda: True))
    new = Rehearsal(plan_of(NEAR)).state
    resumed = keeper.begin(7.0, new)
    keeper.end(new)
    assert read_state(state_text(resumed), new).rules.steps == resumed.rules.steps != new.rules.steps
    with pytest.raises(StateError, match="not the state of a run"):
        read_state('{"alarms": 7}', new)


def test_a_recording_that_begins_while_a_moved_camera_is_not_confirmed_knows_that():
    from stadimeter.app.persistence.resumption import read_state, state_text

    new = Rehearsal(plan_of(NEAR)).state
    moved = replace(new, is_mounting_unconfirmed=True, events=3, disarmed="by Ann")
    known = read_state(state_text(moved), new)
    assert known.is_mounting_unconfirmed
    assert (known.events, known.disarmed) == (3, "by Ann")
