"""Wiring drawings: what hangs on which pin, in text and as pictures."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import ACTUATORS, BASES, DriverChoice, DriverOptions, load_driver
from stadimeter.config.units import GROUND, HEADER, POWER_3V3, POWER_5V, Pin
from stadimeter.workbench.printing import svg_of
from stadimeter.workbench.wiring import find_outputs, wiring_picture, wiring_text

CONFIGURATIONS = Path(__file__).parents[2] / "config"


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


def drawn(*actuators: DriverChoice) -> str:
    return wiring_text(actuators)


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


def test_every_input_of_a_motor_driver_has_a_resistor_and_one_wire_joins_the_grounds() -> None:
    outputs = find_outputs([CAR])
    assert [output.gpio for output in outputs] == [17, 27, 12, 23, 24, 4, 25]
    assert [output.name for output in outputs][:2] == ["base left.forward", "base left.backward"]
    assert [len(output.supplies) for output in outputs] == [1, 0, 0, 0, 0, 0, 0]
    text = drawn(CAR)
    assert text.count("[10 kohm]") == 7
    assert text.count("GPIO 4 is weakly pulled up while the Pi boots") == 1


def test_an_output_of_another_package_is_a_signal_and_its_driver_need_not_say_more() -> None:
    class Stepper(DriverOptions):
        step: Pin
        direction: Pin

    choice = DriverChoice(name="lift", driver="stepper", options=Stepper(step=20, direction=21))
    text = drawn(choice)
    assert "lift step: a signal of 3.3 V" in text
    assert "pin 40  GPIO 21 ── its input" in text


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
