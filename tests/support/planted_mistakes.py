"""Our own drivers with one mistake each, under the contract suites; `test_contracts_catch_mistakes.py` runs this."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import pytest
from msgspec import Struct
from msgspec.structs import replace

from contract import test_actuators, test_bases, test_messengers
from stadimeter.errors import DeviceClosedError, DeviceOpenError, DriverError, LinkLostError
from stadimeter.testing.actuator_contract import ActuatorContract, ButtonContract
from stadimeter.testing.base_contract import BaseContract
from stadimeter.testing.messaging_contract import MessengerContract, NotifierContract

context = test_bases.context  # the fixture that the rig of the base asks for

CANNOT_OPEN = "test_a_device_that_cannot_be_opened_raises_and_is_not_held"
FAILS = "test_a_device_that_fails_raises_one_of_our_errors"
RELEASED = "test_a_device_that_failed_is_released_all_the_same_and_works_again"
TICKS = "test_it_acts_and_ticks_without_keeping_the_loop_waiting"
CLOSED = "test_close_stops_first_and_it_can_be_opened_again"
USED_CLOSED = "test_using_it_while_it_is_closed_raises"
TOLD = "test_without_the_other_side_it_opens_all_the_same_and_says_so_in_one_line"
LOST = "test_a_lost_connection_is_noticed_by_ticks_alone"
BUTTON_FAILS = "test_one_that_fails_raises_one_of_our_errors_and_can_be_opened_again"


class Planted:
    """A driver with methods of which some are replaced: each gets the driver first, then what it is called with."""

    def __init__(self, driver: Any, replaced: dict[str, Callable[..., Any]]) -> None:
        self._driver = driver
        for name, method in replaced.items():
            setattr(self, name, partial(method, driver))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._driver, name)


class Mistake(Struct, frozen=True):
    """The test that catches it, and the methods that make it."""

    caught_by: str
    methods: dict[str, Callable[..., Any]]


def without_our_error(driver: Any, command: Any) -> Any:
    try:
        return driver.apply(command)
    except DeviceClosedError:
        raise
    except DriverError as error:
        raise error.__cause__ or error from None


def hiding(error: type[Exception], method: str) -> Callable[..., Any]:
    """Return a method that passes over an error, and returns its argument or nothing."""

    def call(driver: Any, *given: Any) -> Any:
        with suppress(error):
            return getattr(driver, method)(*given)
        return given[0] if given else False

    return call


def then(method: str, act: Callable[[Any], object]) -> Callable[..., Any]:
    """Return a method that does something more behind what it is to do."""

    def call(driver: Any, *given: Any) -> Any:
        answer = getattr(driver, method)(*given)
        act(driver)
        return answer

    return call


def close_unless_stopping_fails(driver: Any) -> None:
    with suppress(DeviceClosedError):
        driver.stop()
    driver.close()


def fail_without_the_other_side(driver: Any, item: Any) -> None:
    driver.publish(item)
    if driver.trouble():
        raise OSError("connection refused")


ACTUATOR = {
    "reports-what-was-asked": Mistake(
        "test_levels_that_act_alike_are_reported_alike", {"apply": lambda it, asked: (it.apply(asked), asked)[1]}
    ),
    "reports-another-level": Mistake(
        "test_what_is_reported_would_do_the_same_if_it_were_asked_for",
        {"apply": lambda it, asked: replace(it.apply(asked), level=min(1.0, asked.level * 1.5))},
    ),
    "raises-the-vendors-error": Mistake(FAILS, {"apply": without_our_error}),
    "swallows-errors": Mistake(FAILS, {"apply": hiding(DriverError, "apply"), "tick": hiding(DriverError, "tick")}),
    "opens-in-spite-of-errors": Mistake(CANNOT_OPEN, {"open": hiding(DeviceOpenError, "open")}),
    "keeps-the-pin-when-stopping-fails": Mistake(RELEASED, {"close": close_unless_stopping_fails}),
    "is-closed-and-not-let-go": Mistake(
        "test_close_stops_first_and_it_can_be_opened_again", {"close": lambda _it: None}
    ),
    "acts-when-closed": Mistake(USED_CLOSED, {"apply": hiding(DeviceClosedError, "apply")}),
    "ticks-slowly": Mistake(TICKS, {"tick": then("tick", lambda _it: time.sleep(1.0))}),
}
BUTTON = {
    "reads-upside-down": Mistake(
        "test_it_is_pressed_for_as_long_as_it_is_held_down", {"is_pressed": lambda it: not it.is_pressed()}
    ),
    "believes-that-nobody-presses": Mistake(BUTTON_FAILS, {"is_pressed": hiding(DriverError, "is_pressed")}),
}
BASE = {
    "never-notices-silence": Mistake(LOST, {"tick": hiding(LinkLostError, "tick")}),
    "reports-a-tilt-that-it-has-not": Mistake(
        "test_a_tilt_is_applied_only_where_the_camera_tilts",
        {"apply": lambda it, asked: replace(it.apply(asked), tilt_radps=asked.tilt_radps)},
    ),
    "waits-for-each-answer": Mistake(TICKS, {"apply": then("apply", lambda _it: time.sleep(1.0))}),
}
MESSENGER = {
    "raises-when-the-broker-is-gone": Mistake(
        "test_what_must_arrive_waits_for_the_other_side", {"publish": fail_without_the_other_side}
    ),
    "never-notices-that-the-broker-is-gone": Mistake(TOLD, {"trouble": lambda _it: ""}),
    "forgets-what-is-left": Mistake("test_what_is_left_at_the_end_is_known", {"undelivered": lambda _it: ()}),
    "leaves-a-thread": Mistake(
        "test_closing_it_ends_its_threads",
        {"open": then("open", lambda _it: threading.Thread(target=time.sleep, args=(3.0,), daemon=True).start())},
    ),
}
NOTIFIER = {
    "tells-its-address": Mistake(
        TOLD, {"trouble": lambda it: (words := it.trouble()) and f"https://user:secret@example.com: {words}"}
    )
}


MISTAKES = ACTUATOR | BUTTON | BASE | MESSENGER | NOTIFIER


def planted(make_rig: Callable[[], Any], name: str) -> Callable[[], Any]:
    """Return a rig whose driver has a mistake, in a class of its own, whose name messages have."""
    mistaken = type(name, (Planted,), {})
    return lambda: replace(rig := make_rig(), device=mistaken(rig.device, MISTAKES[name].methods))


@pytest.mark.parametrize("name", ACTUATOR)
class TestActuators(ActuatorContract):
    @pytest.fixture
    def make_rig(self, name: str) -> Callable[[], Any]:
        return planted(lambda: test_actuators.gpiozero_rig("led", {"dimmed": True}), name)


@pytest.mark.parametrize("name", BUTTON)
class TestButtons(ButtonContract):
    @pytest.fixture
    def make_rig(self, name: str) -> Callable[[], Any]:
        return planted(test_actuators.gpiozero_button_rig, name)


@pytest.mark.parametrize("name", BASE)
class TestBases(BaseContract):
    @pytest.fixture
    def make_rig(self, name: str, context: Any) -> Callable[[], Any]:
        return planted(test_bases.serial_rig(context, *test_bases.ROS_ARDUINO), name)


@pytest.mark.parametrize("name", MESSENGER)
class TestMessengers(MessengerContract):
    @pytest.fixture
    def make_rig(self, name: str) -> Callable[[], Any]:
        return planted(test_messengers.simulated_rig, name)


@pytest.mark.parametrize("name", NOTIFIER)
class TestNotifiers(NotifierContract):
    @pytest.fixture
    def make_rig(self, name: str) -> Callable[[], Any]:
        return planted(test_messengers.simulated_notifier_rig, name)


class TestActuatorWhoseRigNamesNoFaults(ActuatorContract):
    @pytest.fixture
    def make_rig(self) -> Callable[[], Any]:
        return lambda: replace(test_actuators.gpiozero_rig("led", {}), faults={})
