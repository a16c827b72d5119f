"""Push buttons: what counts as a press, what a press asks for, and what happens to a button that fails."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.panel import OPEN_AGAIN_S, PERIOD_S, STUCK_S, UNSEEN_S, Presses, PushButton
from stadimeter.app.recordings.journal import JournalWriter, read_journal, to_be_recorded
from stadimeter.config.loader import load_configuration
from stadimeter.config.models import ButtonTable
from stadimeter.config.plugins import BUTTONS, DriverContext, load_driver
from stadimeter.core.decision import EventKind
from stadimeter.errors import DeviceOpenError, DriverError
from stadimeter.operator_actions import OperatorAction
from stadimeter.simulation.devices import SimulatedButton
from stadimeter.testing.rig import ManualClock
from support.pins import WatchedPins
from support.replaying import replay
from support.simulated_run import SIMULATED_BALL

PIN = 27


class Front:
    """A button on a pin of a run, and a finger."""

    def __init__(self, clock: ManualClock | None = None, **table: object) -> None:
        self.clock = clock or ManualClock(start_s=50.0)
        context = DriverContext(name="front", clock=self.clock)
        self.pins = WatchedPins(context)
        model = load_driver(BUTTONS, "gpio")
        driver = model(pin=PIN).build(context)
        self.button = PushButton(driver, "front", ButtonTable.model_validate(table), self.clock)

    def touch(self, is_down: bool, seconds: float) -> None:
        self.pins.ground(PIN, begins=is_down)
        self.clock.advance_s(seconds)

    def press(self, seconds: float) -> None:
        self.touch(True, seconds)
        self.touch(False, 0.2)

    def actions(self) -> list[OperatorAction]:
        return [command.action for command in self.button.commands()]


@pytest.fixture
def front() -> Iterable[Front]:
    front = Front(press="acknowledge", hold="shelve", shelve_for="30 min")
    front.button.open()
    front.clock.advance_s(1.0)
    yield front
    front.button.close()
    assert not front.pins.is_held()


def test_a_short_press_and_a_long_one_ask_for_different_things(front):
    front.press(0.1)
    front.press(1.9)
    front.press(2.1)
    short, nearly, long = front.button.commands()
    assert [short.action, nearly.action, long.action] == ["acknowledge", "acknowledge", "shelve"]
    assert (short.by, short.rule, short.for_s, long.for_s) == ("button front", "", None, 1800.0)
    assert len({short.id, nearly.id, long.id}) == 3
    assert front.button.commands() == ()


def test_contacts_that_bounce_are_one_press(front):
    for is_down, seconds in [(True, 0.02), (False, 0.02), (True, 0.02), (False, 0.02), (True, 0.3), (False, 0.02),
                             (True, 0.02), (False, 0.3)]:  # fmt: skip
        front.touch(is_down, seconds)
    assert front.actions() == ["acknowledge"]


def test_a_spike_on_the_wire_is_no_press(front):
    for _ in range(20):
        front.press(PERIOD_S)
    assert front.actions() == []


def test_a_button_that_is_never_let_go_does_nothing_and_is_told(front):
    front.touch(True, STUCK_S)
    assert front.button.trouble() == ""
    front.clock.advance_s(0.1)
    assert "button front: it is held down all the time" in front.button.trouble()
    front.touch(False, 0.2)
    assert (front.actions(), front.button.trouble()) == ([], "")
    front.press(0.1)
    assert front.actions() == ["acknowledge"]


def test_a_button_that_is_down_when_the_run_begins_does_nothing_and_is_told():
    front = Front()
    front.pins.ground(PIN, begins=True)
    front.button.open()
    assert "held down" in front.button.trouble()
    front.clock.advance_s(0.5)
    front.touch(False, 0.2)
    assert (front.actions(), front.button.trouble()) == ([], "")


def test_a_press_over_a_pause_in_which_nobody_looked_is_none():
    presses = Presses(is_down=False, now_s=0.0)
    assert presses.look(is_down=True, now_s=0.02) is None
    assert presses.look(is_down=True, now_s=0.06) is None
    assert presses.look(is_down=False, now_s=0.06 + UNSEEN_S + 0.01) is None
    lasted_s = presses.look(is_down=False, now_s=0.06 + UNSEEN_S + 0.05)
    assert lasted_s is not None
    assert lasted_s > STUCK_S


def test_a_button_that_stops_outputs_does_so_as_soon_as_it_is_down_and_once():
    front = Front(press="stop-outputs")
    front.button.open()
    front.clock.advance_s(1.0)
    front.touch(True, 0.1)
    assert front.actions() == [OperatorAction.STOP_OUTPUTS]
    front.touch(True, STUCK_S + 1.0)
    front.touch(False, 1.0)
    assert front.actions() == []
    front.button.close()


def test_one_that_is_down_when_the_run_begins_stops_them_too():
    front = Front(press="stop-outputs")
    front.pins.ground(PIN, begins=True)
    front.button.open()
    front.clock.advance_s(1.0)
    assert front.actions() == [OperatorAction.STOP_OUTPUTS]
    front.button.close()


@pytest.mark.parametrize(
    "table",
    [
        {"press": "stop-outputs", "hold": "release-outputs"},
        {"hold": "stop-outputs"},
        {"press": "stop-outputs", "rule": "near"},
        {"hold": "release-outputs", "rule": "near"},
    ],
)
def test_a_button_that_stops_outputs_does_nothing_else(table):
    with pytest.raises(ValueError, match="outputs"):
        ButtonTable.model_validate(table)


def test_a_button_that_cannot_be_opened_keeps_a_run_from_beginning():
    front = Front()
    front.pins.occupy(PIN, begins=True)
    with pytest.raises(DeviceOpenError, match="front: cannot open GPIO27"):
        front.button.open()


def test_a_service_begins_without_a_button_and_opens_it_later():
    front = Front()
    front.pins.occupy(PIN, begins=True)
    with pytest.raises(DeviceOpenError) as caught:
        front.button.open()
    assert front.button.open_later(caught.value)
    assert "cannot open GPIO27" in front.button.trouble()
    front.pins.occupy(PIN, begins=False)
    front.clock.advance_s(OPEN_AGAIN_S + 0.1)
    front.press(0.1)
    assert (front.button.trouble(), front.actions()) == ("", ["acknowledge"])


def test_a_button_that_fails_is_told_opened_again_and_works(front):
    front.pins.ground(PIN, begins=True)
    front.pins.fail(PIN, begins=True)
    front.clock.advance_s(0.1)
    assert "button front: front: cannot read GPIO27" in front.button.trouble()
    front.pins.fail(PIN, begins=False)
    front.clock.advance_s(OPEN_AGAIN_S)
    front.touch(False, 0.2)
    assert (front.button.trouble(), front.actions()) == ("", [])
    front.press(0.1)
    assert front.actions() == ["acknowledge"]


@pytest.mark.parametrize("defect", [ZeroDivisionError, SystemExit])
def test_a_driver_with_a_defect_does_not_end_the_looking(defect):
    class Broken(SimulatedButton):
        is_broken = False

        def is_pressed(self) -> bool:
            if self.is_broken:
                raise defect
            return super().is_pressed()

        def close(self) -> None:
            super().close()
            if self.is_broken:
                raise DriverError("it hangs")

    clock = ManualClock()
    model = load_driver(BUTTONS, "simulated")
    driver = Broken(model(), DriverContext(name="it", clock=clock))
    button = PushButton(driver, "it", ButtonTable(), clock)
    button.open()
    driver.is_broken = True
    clock.advance_s(0.1)
    assert button.trouble() == f"button it: {defect.__name__}; closing it failed too: it hangs"
    driver.is_broken = False
    clock.advance_s(OPEN_AGAIN_S)
    assert button.trouble() == ""


RUN = (
    SIMULATED_BALL
    + """
[world]
path = [{ at = "0 s", x = "1 m", y = "0 m" }, { at = "20 s", x = "1 m", y = "0 m" }]

[rules.near]
actuator = "motor"
when = { below = "2 m" }
ack = "required"

[buttons.front]
driver = "simulated"
presses = [{ at = "0.5 s" }, { at = "2 s", for = "3 s" }]
hold = "shelve"
shelve_for = "2 s"
"""
)


def test_presses_operate_the_alarms_of_a_run_and_replay_from_its_journal(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(RUN)
    configuration = load_configuration(path)
    loop = Loop(build(configuration, speed=None))
    events = []
    loop.listeners.append(lambda record, _: events.extend(record.decision.events))
    journal = JournalWriter(tmp_path / "run.jsonl", to_be_recorded(configuration))
    loop.listeners.append(journal.write)
    loop.run(Limits(seconds=10.0))
    journal.close()
    told = [(event.kind, round(event.at_s, 1), event.by) for event in events if event.by]
    assert told == [
        (EventKind.ACKNOWLEDGED, pytest.approx(0.7, abs=0.11), "button front"),
        (EventKind.SHELVED, pytest.approx(5.0, abs=0.11), "button front"),
    ]
    result = replay(read_journal(tmp_path / "run.jsonl"), configuration.plan)
    assert result.identical == result.cycles
    assert result.events == result.recorded_events
