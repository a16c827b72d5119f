"""What a configuration says must be switched off when the program is gone."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.app.service import safe_lines, safe_outputs_path, without_stop_from_outside, write_safe_outputs
from stadimeter.bases.ros_arduino_base import RosArduinoOptions
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.plugins import DriverChoice, DriverOptions, I2cStop, SerialStop
from support.simulated_run import SIMULATED_BALL

BASE = """
[base]
driver = "ros-arduino-bridge"
port = "{port}"
baud = 115200
wheel_diameter = "6.5 cm"
ticks_per_turn = 800
track_width = "20 cm"
"""

ACTUATORS = """
[actuators.buzzer]
driver = "buzzer"
pin = 18
[actuators.fan]
driver = "relay"
pin = 5
[actuators.lamp]
driver = "led"
pin = 17
active_high = false
"""


def loaded(folder: Path, text: str) -> Configuration:
    path = folder / "box.toml"
    path.write_text(SIMULATED_BALL + text + "[world]\n")
    return load_configuration(path)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "safe-outputs.conf"


def test_each_pin_has_the_level_at_which_it_is_off_and_a_base_the_bytes_that_stop_it(tmp_path, file):
    found = loaded(tmp_path, ACTUATORS + BASE.format(port="/dev/robot-base"))
    assert write_safe_outputs(found, file) == []
    assert file.read_text().splitlines() == [
        "pin 18 low",
        "pin 5 high",
        "pin 17 high",
        "serial /dev/robot-base 115200 " + b"\rm 0 0\r".hex(),
    ]


def test_a_list_that_is_right_is_not_written_again(tmp_path, file):
    found = loaded(tmp_path, ACTUATORS)
    write_safe_outputs(found, file)
    before = file.stat().st_ino
    write_safe_outputs(found, file)
    assert file.stat().st_ino == before
    write_safe_outputs(loaded(tmp_path, ACTUATORS.replace("18", "12")), file)
    assert file.read_text().startswith("pin 12 low\n")


@pytest.mark.parametrize(
    "port", ["/dev/two words", "/dev/x\npin 4 high", "robot", "../dev/ttyUSB0", "/dev/$(id)", "/dev/"]
)
def test_a_port_that_would_be_another_line_or_no_device_is_left_out_and_said(tmp_path, file, port):
    found = loaded(tmp_path, BASE.format(port=port.replace("\n", "\\n")))
    assert write_safe_outputs(found, file) == []
    assert [words.split(":")[0] for words in without_stop_from_outside(found)] == ["base"]
    assert file.read_text() == ""


def test_a_base_whose_driver_does_not_say_how_it_stops_is_told_of(tmp_path, monkeypatch):
    found = loaded(tmp_path, BASE.format(port="/dev/robot-base"))
    assert found.base is not None
    for stop in (None, SerialStop(port="/dev/robot-base", baud=9600, frame=b"")):
        monkeypatch.setattr(RosArduinoOptions, "serial_stop", lambda _options, stop=stop: stop)
        assert without_stop_from_outside(found)[0].startswith("base: nothing but itself stops it")


class OverI2c(DriverOptions):
    def i2c_stop(self) -> I2cStop:
        return I2cStop(bus=1, address=0x40, writes=(b"\xfd\x10", b"\x00\x11"))


def test_an_output_on_an_i2c_bus_has_the_writes_that_stop_it():
    choice = DriverChoice(name="base", driver="over-i2c", options=OverI2c())
    assert list(safe_lines(choice)) == ["i2c 1 0x40 fd10,0011"]


def test_a_list_that_cannot_be_written_is_told_of_and_the_run_goes_on(tmp_path):
    trouble = write_safe_outputs(loaded(tmp_path, ACTUATORS), tmp_path / "absent" / "safe-outputs.conf")
    assert "nothing is switched off if this process is killed" in trouble[0]


def test_only_a_service_has_a_list():
    assert safe_outputs_path({}) is None
    assert safe_outputs_path({"RUNTIME_DIRECTORY": "/run/a:/run/b"}) == Path("/run/a/safe-outputs.conf")
