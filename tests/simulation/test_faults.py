from __future__ import annotations

from msgspec.structs import fields

from stadimeter.simulation.world import BY_HAND_S, KNOBS, FaultKind, Faults, FaultSchedule, ScheduledFault
from support.each_case import each_case


def fault(kind: str, at: str, lasts: str | None = None) -> ScheduledFault:
    return ScheduledFault.model_validate({"kind": kind, "at": at, "for": lasts} if lasts else {"kind": kind, "at": at})


def test_every_kind_of_fault_has_its_own_knob() -> None:
    assert set(KNOBS) == set(FaultKind)
    assert sorted(KNOBS.values()) == sorted(field.name for field in fields(Faults))


@each_case("kind", list(FaultKind))
def test_a_scheduled_fault_begins_and_ends_in_time(kind: FaultKind) -> None:
    faults, schedule = Faults(), FaultSchedule([fault(kind, "12 s", "2 s")], start_s=100.0)
    states = {}
    for now_s in (111.9, 112.0, 113.9, 114.0):
        schedule.turn(faults, now_s)
        states[now_s] = getattr(faults, KNOBS[kind])
        assert sum(getattr(faults, knob) for knob in KNOBS.values()) == states[now_s], "another knob was turned"
    assert states == {111.9: False, 112.0: True, 113.9: True, 114.0: False}


def test_a_fault_without_a_duration_lasts() -> None:
    faults, schedule = Faults(), FaultSchedule([fault("broker-gone", "1 s")], start_s=0.0)
    schedule.turn(faults, 1e9)
    assert faults.broker_gone


def test_overlapping_faults_of_one_kind_are_one() -> None:
    planned = [
        fault("hide-target", "1 s", "4 s"),
        fault("hide-target", "2 s", "1 s"),
        fault("hide-target", "4 s", "3 s"),
    ]
    faults, schedule = Faults(), FaultSchedule(planned, start_s=0.0)
    hidden = []
    for now_s in range(9):
        schedule.turn(faults, float(now_s))
        hidden.append(faults.target_hidden)
    assert hidden == [False, True, True, True, True, True, True, False, False]


def test_a_fault_that_came_and_went_unasked_is_over() -> None:
    faults, schedule = Faults(), FaultSchedule([fault("block-camera", "1 s", "1 s")], start_s=0.0)
    schedule.turn(faults, 10.0)
    assert not faults.camera_blocked


def test_a_knob_turned_by_hand_stays_until_its_next_scheduled_time() -> None:
    faults, schedule = Faults(), FaultSchedule([fault("hide-target", "5 s", "1 s")], start_s=0.0)
    faults.target_hidden = True
    schedule.turn(faults, 4.0)
    assert faults.target_hidden
    schedule.turn(faults, 6.0)
    assert not faults.target_hidden


def test_a_fault_made_by_hand_ends_by_itself_and_one_that_was_made_again_has_its_whole_time(make_run) -> None:
    run = make_run()

    def is_frozen_after(wait_s: float) -> bool:
        run.clock.advance_s(wait_s)
        return run.world.goes_wrong("freeze-camera")

    for _ in range(3):
        run.world.toggle("freeze-camera")
    assert is_frozen_after(BY_HAND_S - 0.1)
    assert not is_frozen_after(0.2)
    run.world.toggle("freeze-camera")
    run.clock.advance_s(3.0)
    run.world.toggle("freeze-camera")
    run.world.toggle("freeze-camera")
    assert is_frozen_after(BY_HAND_S - 0.1)
    assert not is_frozen_after(0.2)


def test_the_schedule_goes_before_the_end_of_a_fault_made_by_hand(make_run) -> None:
    run = make_run(faults=[{"at": "8 s", "for": "6 s", "kind": "hide-target"}])
    run.world.toggle("hide-target")
    run.clock.advance_s(13.0)
    assert run.world.goes_wrong("hide-target")
    run.clock.advance_s(1.5)
    assert not run.world.goes_wrong("hide-target")
