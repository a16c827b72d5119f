"""Wiring drawings: what hangs on which pin, in text and as pictures."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

from gpiozero.pins.mock import MockFactory

from stadimeter.cli.main import plain
from stadimeter.config.gpio_header import GROUND, HEADER, POWER_3V3, POWER_5V, header_pin
from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import ACTUATORS, BASES, DriverChoice, DriverOptions, load_driver
from stadimeter.config.units import Pin
from stadimeter.core.drawing import Text
from stadimeter.workbench.drawing import svg_of
from stadimeter.workbench.wiring import find_outputs, wiring_picture, wiring_text

CONFIGURATIONS = Path(__file__).parents[2] / "config"

Choose = Callable[..., DriverChoice]


def actuator(name: str, driver: str, **table: object) -> DriverChoice:
    model = load_driver(ACTUATORS, driver)
    return DriverChoice(name=name, driver=driver, options=model.model_validate(table))


EVERY_KIND = (
    actuator("motor", "vibration-motor", pin=18),
    actuator("buzzer", "buzzer", pin=23),
    actuator("warning-light-over-the-door", "led", pin=5),
    actuator("lamp", "led", pin=6, active_high=False),
    actuator("pump", "relay", pin=17),
    actuator("fan", "relay", pin=27, active_high=True),
)


CAR = DriverChoice(
    name="base",
    driver="gpio-motors",
    options=load_driver(BASES, "gpio-motors").model_validate(
        {
            "left": {"forward": 17, "backward": 27, "pwm": 12},
            "right": {"forward": 23, "backward": 24, "pwm": 4},
            "enable": 25,
            "track_width": "15 cm",
            "max_wheel_speed": "0.6 m/s",
        }
    ),
)


def drawn(*actuators: DriverChoice, width: int = 80) -> str:
    return wiring_text(actuators, width=width)


def test_the_header_is_that_of_gpiozero() -> None:
    header = MockFactory().board_info.headers["J8"].pins
    for number, what in enumerate(HEADER, start=1):
        known = header[number].name
        assert known == {POWER_3V3: "3V3", POWER_5V: "5V", GROUND: "GND"}.get(str(what), f"GPIO{what}")


def test_each_output_begins_at_its_pin_of_the_header() -> None:
    text = drawn(*EVERY_KIND)
    for choice in EVERY_KIND:
        gpio = choice.options.pin  # type: ignore[attr-defined]
        assert f"pin {header_pin(gpio):>2}  GPIO {gpio}" in text


def test_the_wires_of_several_outputs_get_pins_of_their_own_while_there_are_any() -> None:
    grounds = [output.supplies[GROUND] for output in find_outputs(EVERY_KIND) if GROUND in output.supplies]
    assert {HEADER[pin - 1] for pin in grounds} == {GROUND}
    assert len(set(grounds)) == len(grounds)
    many = [actuator(f"led{gpio}", "led", pin=gpio) for gpio in range(4, 28)]
    assert all(HEADER[output.supplies[GROUND] - 1] == GROUND for output in find_outputs(many))


def test_a_motor_has_a_diode_a_resistor_that_keeps_it_off_and_a_supply_of_its_own() -> None:
    text = drawn(actuator("motor", "vibration-motor", pin=18))
    for part in ("[diode]", "[10 kohm]", "[MOSFET]", "[switch]", "plus of its own supply", "minus of that supply"):
        assert part in text
    assert POWER_5V not in "\n".join(line for line in text.splitlines() if "─" in line)


def test_an_led_hangs_between_its_pin_and_what_is_opposite_when_it_is_on() -> None:
    for active_high, plus, minus in [(True, "GPIO 5", GROUND), (False, POWER_3V3, "GPIO 5")]:
        lines = drawn(actuator("led", "led", pin=5, active_high=active_high)).splitlines()
        resistor = next(line for line in lines if "[330 ohm]" in line)
        end = next(line for line in lines if line.endswith("┘"))
        assert plus in resistor
        assert minus in end


def test_the_input_of_a_relay_is_pulled_to_where_it_is_off() -> None:
    for active_high, rest in [(True, GROUND), (False, POWER_3V3)]:
        lines = drawn(actuator("pump", "relay", pin=5, active_high=active_high)).splitlines()
        ends = [line for line in lines if "┬" in line or "┴" in line]
        assert len(ends) == 2
        assert any(rest in line for line in ends)
        assert any("GPIO 5" in line for line in ends)


def test_a_pin_that_is_pulled_towards_on_while_the_pi_boots_is_told() -> None:
    for gpio, active_high, is_on in [(5, True, 1), (18, True, 0), (18, False, 1), (5, False, 0)]:
        text = drawn(actuator("led", "led", pin=gpio, active_high=active_high))
        assert len(re.findall(r"while the Pi boots, towards\s+on", text)) == is_on


def test_a_transistor_that_would_be_on_the_wrong_way_round_is_told() -> None:
    text = drawn(actuator("motor", "vibration-motor", pin=18, active_high=False))
    assert "write active_high = true" in text


def test_no_line_is_wider_than_the_terminal() -> None:
    for width in [40, 48, 63, 80, 120]:
        assert max(map(len, drawn(*EVERY_KIND, width=width).splitlines())) <= width


def test_every_input_of_a_motor_driver_has_a_resistor_and_one_wire_joins_the_grounds() -> None:
    outputs = find_outputs([CAR])
    assert [output.gpio for output in outputs] == [17, 27, 12, 23, 24, 4, 25]
    assert [output.name for output in outputs][:2] == ["base left.forward", "base left.backward"]
    assert [len(output.supplies) for output in outputs] == [1, 0, 0, 0, 0, 0, 0]
    text = drawn(CAR)
    assert text.count("[10 kohm]") == 7
    assert text.count("GPIO 4 is weakly pulled up while the Pi boots") == 1


def test_where_the_circuit_has_no_room_the_way_to_its_picture_is_named() -> None:
    text = " ".join(drawn(actuator("motor", "vibration-motor", pin=18), width=40).split())
    assert "┬" not in text
    assert "needs 63 columns; --output FILE draws it as a picture" in text


def test_an_ascii_terminal_gets_ascii() -> None:
    text = "".join(map(plain, wiring_text(EVERY_KIND)))
    assert "\\u" not in text
    assert "[220 ohm]--+--" in text


def test_an_output_of_another_package_is_a_signal_and_its_driver_need_not_say_more() -> None:
    class Stepper(DriverOptions):
        step: Pin
        direction: Pin

    choice = DriverChoice(name="lift", driver="stepper", options=Stepper(step=20, direction=21))
    text = drawn(choice)
    assert "lift step: a signal of 3.3 V" in text
    assert "pin 40  GPIO 21 ── its input" in text


def test_outputs_that_are_on_no_pin_are_left_out() -> None:
    assert drawn(actuator("motor", "simulated")) == "no part is on a pin of the header"


def test_no_line_of_text_leaves_the_picture() -> None:
    picture = wiring_picture(EVERY_KIND)
    texts = [each for each in picture.shapes if isinstance(each, Text) and each.anchor == "start"]
    letter_m = {each: each.size_m * (0.6 if each.is_fixed_width else 0.5) for each in texts}
    assert all(each.x_m + len(each.text) * letter_m[each] <= picture.width_m for each in texts)


def test_the_picture_says_what_the_text_says() -> None:
    for name in ["distance-alert", "appliance"]:
        actuators = load_configuration(CONFIGURATIONS / f"{name}.toml").actuators
        picture = wiring_picture(actuators)
        words = " ".join(each.text or "" for each in ET.fromstring(svg_of(picture)).iter() if each.tag.endswith("text"))  # noqa: S314
        of_text = re.sub(r"[─│┌┐└┘├┤┬┴┼●○\[\]]", " ", drawn(*actuators))
        assert sorted(set(re.findall(r"[A-Za-z0-9.]+", words))) == sorted(set(re.findall(r"[A-Za-z0-9.]+", of_text)))
        for shape in picture.shapes:
            for key, value in shape._asdict().items():
                if key.startswith("x"):
                    assert 0 <= value <= picture.width_m
                if key.startswith("y"):
                    assert 0 <= value <= picture.height_m
