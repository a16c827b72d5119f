"""Each contract suite passes a sound driver and catches each mistake that `planted_mistakes.py` plants in it."""

from __future__ import annotations

import subprocess
import sys
from collections import defaultdict
from xml.etree import ElementTree as ET

import pytest

from support import planted_mistakes
from support.planted_mistakes import SoundBase, SoundButton, SoundLamp, SoundMessenger, SoundNotifier

pytestmark = pytest.mark.long  # each suite runs in a process of its own, against every mistake

OPENED_TWICE = "test_opening_it_twice_takes_the_device_once"
CANNOT_OPEN = "test_a_device_that_cannot_be_opened_raises_and_is_not_held"
FAILS = "test_a_device_that_fails_raises_one_of_our_errors"
RELEASED = "test_a_device_that_fails_is_released_all_the_same"
BUTTON_FAILS = "test_one_that_fails_raises_one_of_our_errors_and_can_be_opened_again"
CLOSES = "test_close_stops_first_and_may_come_again"
TICKS = "test_it_acts_and_ticks_without_keeping_the_loop_waiting"

CAUGHT_BY = {
    "ReportsWhatWasAsked": "test_levels_that_act_alike_are_reported_alike",
    "ReportsAnotherLevel": "test_what_is_reported_would_do_the_same_if_it_were_asked_for",
    "LetsTheVendorsErrorThrough": FAILS,
    "LetsTheVendorsErrorThroughWhenOpened": CANNOT_OPEN,
    "HidesTheVendorsError": FAILS,
    "SwallowsTheVendorsError": FAILS,
    "TakesThePinAgainWhenOpenedTwice": OPENED_TWICE,
    "KeepsThePinWhenOpeningFails": CANNOT_OPEN,
    "KeepsThePinWhenClosingFails": RELEASED,
    "TicksSlowly": TICKS,
    "TicksForEver": TICKS,
    "TakesThePinInItsConstructor": "test_the_constructor_touches_no_hardware",
    "StaysOnWhenClosed": CLOSES,
    "IgnoresUseWhenClosed": "test_using_it_after_it_was_closed_raises",
    "ReadsUpsideDown": "test_nobody_presses_it_at_first",
    "SaysItOnce": "test_it_is_pressed_for_as_long_as_it_is_held_down",
    "IsReadWhenClosed": "test_using_it_while_it_is_closed_raises",
    "LetsTheChipsErrorThrough": BUTTON_FAILS,
    "BelievesThatNobodyPresses": BUTTON_FAILS,
    "HoldsTheChipTwice": "test_opening_and_closing_it_twice_is_once",
    "NeverNoticesSilence": "test_a_lost_connection_is_noticed_while_driving",
    "OpensWithoutAnAnswer": CANNOT_OPEN,
    "LetsOsErrorsThrough": FAILS,
    "ReportsTheSpeedThatWasAsked": "test_speeds_that_move_it_alike_are_reported_alike",
    "ReportsATiltThatItHasNot": "test_a_tilt_is_applied_only_where_the_camera_tilts",
    "TakesThePortAgainWhenOpenedTwice": OPENED_TWICE,
    "KeepsThePortWhenTheLinkIsLost": RELEASED,
    "DrivesOnWhenClosed": CLOSES,
    "WaitsForEachAnswer": TICKS,
    "PublishesWaiting": "test_sending_never_waits_for_the_other_side",
    "RaisesWhenTheBrokerIsGone": "test_what_must_arrive_waits_for_the_other_side",
    "ForgetsWhatWasNotAcknowledged": "test_what_was_sent_but_not_acknowledged_is_not_lost",
    "NeverNoticesThatTheBrokerIsGone": "test_without_the_other_side_it_opens_all_the_same_and_says_so_in_one_line",
    "ForgetsWhatIsLeftWhenClosed": "test_what_is_left_at_the_end_is_known_and_sent_when_it_is_opened_again",
    "DropsTheOldestUncounted": "test_more_than_fits_is_given_up_and_counted",
    "LeavesAThread": "test_closing_it_ends_its_threads",
    "NotifiesWaiting": "test_sending_never_waits_for_the_other_side",
    "BelievesThatEverythingWasTaken": "test_what_must_arrive_waits_for_the_other_side",
    "TellsItsAddress": "test_without_the_other_side_it_opens_all_the_same_and_says_so_in_one_line",
    "RaisesWhenTheServiceIsGone": "test_what_must_arrive_waits_for_the_other_side",
}
SOUND = (SoundLamp, SoundButton, SoundBase, SoundMessenger, SoundNotifier)


@pytest.fixture(scope="module")
def failures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """Run sound drivers and planted mistakes once; return for each the tests that failed, with their messages."""
    report = tmp_path_factory.mktemp("planted") / "report.xml"
    chosen = " or ".join(["Sound", "NamesNoFaults", *(f"({test} and {name})" for name, test in CAUGHT_BY.items())])
    arguments = ["-q", "--noconftest", "--tb=no", f"--junitxml={report}", "-k", chosen, planted_mistakes.__file__]
    subprocess.run([sys.executable, "-m", "pytest", *arguments], capture_output=True, check=False, timeout=120)
    failed: dict[str, dict[str, str]] = defaultdict(dict)
    for case in ET.parse(report).iter("testcase"):  # noqa: S314 - our own pytest wrote it
        test, _, parameters = case.get("name", "").partition("[")
        driver = parameters.rstrip("]").split("-")[-1]
        for failure in (*case.iter("failure"), *case.iter("error")):
            failed[driver][test] = failure.get("message", "")
    return failed


@pytest.mark.parametrize("driver", SOUND)
def test_a_sound_driver_passes(failures: dict[str, dict[str, str]], driver: type) -> None:
    assert failures.get(driver.__name__, {}) == {}


@pytest.mark.parametrize(("driver", "test"), CAUGHT_BY.items())
def test_a_mistake_is_caught(failures: dict[str, dict[str, str]], driver: str, test: str) -> None:
    assert test in failures[driver]


def test_every_planted_mistake_is_named_here() -> None:
    planted = {each.__name__ for sound in SOUND for each in sound.__subclasses__()}
    assert planted == set(CAUGHT_BY)


def test_a_slow_driver_fails_at_once_and_says_which_call_is_slow(failures: dict[str, dict[str, str]]) -> None:
    assert "TicksSlowly.tick() is too slow" in failures["TicksSlowly"][TICKS]
    assert "TicksForEver.tick() has not returned in 5 s" in failures["TicksForEver"][TICKS]
    assert "WaitsForEachAnswer.apply() is too slow" in failures["WaitsForEachAnswer"][TICKS]


def test_a_rig_that_names_no_fault_fails_the_tests_that_need_it(failures: dict[str, dict[str, str]]) -> None:
    assert set(failures["absent"]) | set(failures["fails"]) == {
        CANNOT_OPEN,
        FAILS,
        RELEASED,
        "test_a_device_that_failed_opens_at_rest_and_works_again",
    }
