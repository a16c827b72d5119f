from __future__ import annotations

import pytest

from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.message import Message
from stadimeter.errors import DeviceClosedError, DriverError, LinkLostError
from stadimeter.testing.manual_clock import ManualClock
from stadimeter.testing.recording import Call, RecordingActuator, RecordingBase, RecordingMessenger


def level(value: float) -> LevelCommand:
    return LevelCommand(output="motor", level=value, captured_at_s=0.0)


def test_an_actuator_records_commands_and_stops_with_the_clocks_time() -> None:
    clock = ManualClock(10.0)
    motor = RecordingActuator(clock, "motor")
    motor.open()
    clock.advance_s(1.0)
    motor.apply(level(0.5))
    assert motor.level == 0.5
    clock.advance_s(1.0)
    motor.stop()
    assert motor.level == 0.0
    assert motor.commands == [level(0.5)]
    assert motor.command_times_s == [11.0]
    assert motor.stop_times_s == [12.0]


def test_a_base_records_how_it_was_told_to_move() -> None:
    base = RecordingBase(ManualClock())
    base.open()
    twist = TwistCommand(output="base", linear_mps=0.2, angular_radps=-0.1, captured_at_s=0.0)
    assert base.apply(twist) == twist
    assert (base.linear_mps, base.angular_radps) == (0.2, -0.1)
    base.close()
    assert (base.linear_mps, base.angular_radps) == (0.0, 0.0)
    assert len(base.stop_times_s) == 1


def test_one_list_shows_the_order_between_several_devices() -> None:
    clock = ManualClock()
    calls: list[Call] = []
    motor, buzzer = RecordingActuator(clock, "motor", calls), RecordingActuator(clock, "buzzer", calls)
    for device in (motor, buzzer):
        device.open()
    for device in (buzzer, motor):
        device.close()
    assert [(call.device, call.action) for call in calls] == [
        ("motor", "open"),
        ("buzzer", "open"),
        ("buzzer", "stop"),
        ("buzzer", "close"),
        ("motor", "stop"),
        ("motor", "close"),
    ]


def test_a_double_fails_where_it_is_told_to_and_records_the_attempt() -> None:
    motor = RecordingActuator(ManualClock(), "motor")
    motor.open()
    motor.fail_with = LinkLostError("motor: the cable is out")
    with pytest.raises(LinkLostError):
        motor.apply(level(0.5))
    assert motor.commands == [level(0.5)]
    assert motor.level == 0.0
    motor.stop()
    motor.fail_on = ("stop", "tick")
    with pytest.raises(LinkLostError):
        motor.tick(0.0)
    with pytest.raises(LinkLostError):
        motor.close()
    assert not motor.is_open
    motor.close()


def test_a_double_that_cannot_be_opened_stays_closed() -> None:
    motor = RecordingActuator(ManualClock())
    motor.fail_with, motor.fail_on = DriverError("busy"), ("open",)
    with pytest.raises(DriverError):
        motor.open()
    with pytest.raises(DeviceClosedError):
        motor.apply(level(0.0))


def test_a_messenger_keeps_messages_by_topic() -> None:
    messenger = RecordingMessenger()
    with pytest.raises(DeviceClosedError):
        messenger.publish(Message(topic="a", payload="0"))
    messenger.open()
    for topic, payload in (("a", "1"), ("b", "2"), ("a", "3")):
        messenger.publish(Message(topic=topic, payload=payload))
    assert messenger.payloads("a") == ["1", "3"]
    messenger.fail_with = DriverError("full")
    with pytest.raises(DriverError):
        messenger.publish(Message(topic="a", payload="4"))
    messenger.trouble_text = "refused"
    assert messenger.trouble() == "refused"
    assert len(messenger.messages) == 3
