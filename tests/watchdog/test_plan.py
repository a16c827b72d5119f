"""Lists of what makes outputs safe, which may come from another user."""

from __future__ import annotations

from stadimeter.watchdog.plan import SafePlan
from support.each_case import each_case


def test_a_device_on_a_bus_gets_its_writes_in_order() -> None:
    plan = SafePlan(["i2c 1 0x60 fd10,fa00000000 # all off"])
    assert plan.i2c == [(1, 0x60, [b"\xfd\x10", b"\xfa\0\0\0\0"])]
    assert plan.complaints == []


@each_case(
    "line",
    [
        *("i2c", "i2c 1", "i2c 1 0x60", "i2c x 0x60 00", "i2c 100 0x60 00", "i2c 1 60 00", "i2c 1 0x02 00"),
        *("i2c 1 0x78 00", "i2c 1 0x6 00", "i2c 1 0x60 0", "i2c 1 0x60 00,", "i2c 1 0x60 0G", "i2c 1 0x60 FF"),
        f"i2c 1 0x60 {'00' * 33}",
        f"i2c 1 0x60 {','.join(['00'] * 17)}",
    ],
)
def test_what_is_no_write_to_a_device_is_refused_in_words(line: str) -> None:
    plan = SafePlan([line, "i2c 1 0x40 00"])
    assert plan.i2c == [(1, 0x40, [b"\0"])]
    assert len(plan.complaints) == 1
    assert plan.complaints[0].startswith("i2c ")


def test_buses_and_ports_share_the_room_for_lines() -> None:
    plan = SafePlan([*(f"serial /dev/ttyS{each}" for each in range(15)), "i2c 1 0x40 00", "i2c 1 0x41 00"])
    assert len(plan.serial) + len(plan.i2c) == 16
    assert plan.complaints == ["i2c 1 0x41: not stopped, there are 16 other lines on ports before it"]


def test_what_cannot_be_printed_is_not_and_nothing_is_long() -> None:
    plan = SafePlan(["\x1b[2J\x07" + "x" * 500])
    assert plan.complaints[0].startswith("'?[2J?xxx")
    assert len(plan.complaints[0]) == 200
