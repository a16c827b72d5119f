"""What `doctor` finds on groups, cameras, pins and serial ports, on computers that are given as captured texts."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from msgspec.structs import replace

from stadimeter.workbench.doctor.computer import DiagnosisSeverity
from stadimeter.workbench.doctor.devices import IN_USE
from support.captured_computers import (
    GROUP,
    IMX219,
    LOADED,
    PC,
    PI_4,
    PI_5,
    PLACES,
    STATUS,
    WEBCAM,
    examine,
    library,
    only,
)

NOT_FREE = f"{IN_USE}: motion (412); close that one"
CONFIG = Path(__file__).parents[2] / "config"
FINE, WARNING, WRONG, UNKNOWN = DiagnosisSeverity


class TestGroups:
    def test_a_group_since_this_login_needs_another_login(self, tmp_path: Path) -> None:
        stale = PI_4.with_files(status=STATUS.format(uid=1000, groups="44 1000"))
        found = examine(stale, tmp_path, "groups")
        assert [each.severity for each in found] == [WRONG, WRONG]
        assert found[0].seen.startswith("the user maker is in the group dialout since the last login only")
        assert found[0].remedy == "log out and in again, or restart"

    def test_a_group_that_the_configuration_needs_is_wrong_to_lack(self, tmp_path: Path) -> None:
        none = PI_4.with_files(
            group=GROUP.format(dialout="", video="", gpio=""), status=STATUS.format(uid=1000, groups="1000")
        )
        severities = {each.seen.split()[8].rstrip(","): each.severity for each in examine(none, tmp_path, "groups")}
        assert set(severities.values()) == {WARNING}
        found = examine(none, tmp_path, "groups", config=CONFIG / "distance-alert.toml")
        assert {each.seen.split()[8].rstrip(","): each.severity for each in found} == {
            "video": WRONG, "gpio": WRONG, "dialout": WARNING,
        }  # fmt: skip
        assert "`sudo usermod -aG video maker`, then log out and in again" in {each.remedy for each in found}

    def test_root_is_asked_for_whoever_called_sudo(self, tmp_path: Path) -> None:
        root = PI_4.with_files(
            group=GROUP.format(dialout="maker", video="", gpio="maker"), status=STATUS.format(uid=0, groups="0")
        )
        assert only(root, tmp_path, "groups").seen.startswith("root may use every device")
        found = only(replace(root, environment={"SUDO_USER": "maker"}), tmp_path, "groups")
        assert found.seen.startswith("the user maker is not in the group video")


class TestCameras:
    def test_each_camera_is_named_with_its_stack(self, tmp_path: Path) -> None:
        assert only(PI_4, tmp_path / "pi", "cameras").seen == f"imx219, by libcamera: {IMX219['device']}"
        assert "by V4L2: /dev/v4l/by-id/" in only(PC, tmp_path / "pc", "cameras").seen

    def test_a_camera_that_is_in_use_says_so(self, tmp_path: Path) -> None:
        busy = replace(PC, cameras=({**WEBCAM, "trouble": NOT_FREE},))
        found = only(busy, tmp_path, "cameras")
        assert (found.severity, found.remedy) == (WRONG, NOT_FREE)
        serving = busy.printing("systemctl is-active stadimeter.service", "active\n")
        assert only(serving, tmp_path, "cameras").seen.endswith("; it is in use, and the service runs")

    def test_the_legacy_stack_is_found_in_config_txt(self, tmp_path: Path) -> None:
        old = replace(PI_4, cameras=()).with_files(config_txt="start_x=1\ngpu_mem=128\n")
        assert "legacy camera stack (start_x=1)" in examine(old, tmp_path, "cameras")[0].seen

    def test_a_ribbon_camera_without_its_library_is_found(self, tmp_path: Path) -> None:
        bare = replace(PI_4, cameras=(), imports=(*LOADED[:5], library("picamera2", missing=True)))
        found = examine(bare, tmp_path, "cameras")[0]
        assert found.seen == "a ribbon camera is there, and the library picamera2 is not"
        assert found.remedy.startswith("`sudo apt install python3-picamera2`")

    def test_a_library_that_this_environment_does_not_see_is_found(self, tmp_path: Path) -> None:
        hidden = replace(PI_5, cameras=(), imports=(*LOADED[:5], library("picamera2", missing=True)))
        (tmp_path / "usr/lib/python3/dist-packages/picamera2").mkdir(parents=True)
        found = examine(hidden, tmp_path, "cameras")[0]
        assert "does not see picamera2" in found.seen
        assert "--system-site-packages" in found.remedy

    def test_a_camera_whose_detection_is_off_is_found(self, tmp_path: Path) -> None:
        off = replace(PI_4, cameras=()).with_files(config_txt="camera_auto_detect=0\n").without(PLACES["video0"])
        assert "turns the detection of the latter off" in examine(off, tmp_path, "cameras")[0].seen

    def test_a_configuration_without_such_a_camera_needs_none(self, tmp_path: Path) -> None:
        assert only(replace(PC, cameras=()), tmp_path, "cameras").severity is WRONG
        found = only(replace(PC, cameras=()), tmp_path, "cameras", CONFIG / "demo.toml")
        assert (found.severity, "needs none" in found.seen) == (FINE, True)

    def test_only_who_wants_a_ribbon_camera_lacks_one(self, tmp_path: Path) -> None:
        bare = replace(PI_4, cameras=()).without(PLACES["video0"])
        on_usb = only(bare, tmp_path / "usb", "cameras", CONFIG / "distance-alert.toml")
        assert on_usb.seen == "no camera is found on this computer"
        config = tmp_path / "ribbon.toml"
        lines = (CONFIG / "distance-alert.toml").read_text()
        config.write_text(lines.replace('driver = "opencv"\ndevice = 0', 'driver = "picamera2"'))
        with_webcam = replace(bare, cameras=(WEBCAM,))
        assert only(with_webcam, tmp_path / "none", "cameras").severity is FINE
        found = examine(with_webcam, tmp_path / "ribbon", "cameras", config=config)
        assert found[-1].seen.startswith("no ribbon camera is found")


class TestPins:
    def test_the_chip_is_the_one_that_gpiozero_takes(self, tmp_path: Path) -> None:
        assert only(PI_4, tmp_path / "4", "pins").seen.endswith("by /dev/gpiochip0")
        assert only(PI_5, tmp_path / "5", "pins").seen.endswith("by /dev/gpiochip4")

    @pytest.mark.parametrize(("factory", "severity"), [("lgpio", FINE), ("mock", WARNING), ("rpigpio", WRONG)])
    def test_another_factory_is_found(self, tmp_path: Path, factory: str, severity: DiagnosisSeverity) -> None:
        captured = replace(PI_4, environment={"GPIOZERO_PIN_FACTORY": factory})
        assert only(captured, tmp_path, "pins").severity is severity

    def test_pins_of_a_configuration_need_a_pi(self, tmp_path: Path) -> None:
        assert examine(PC, tmp_path, "pins") == []
        assert only(PC, tmp_path, "pins", CONFIG / "distance-alert.toml").severity is WRONG


def a_base(folder: Path, port: str) -> Path:
    config = folder / "base.toml"
    lines = (CONFIG / "follow-ball.toml").read_text()
    lines = lines.replace('driver = "gpio-motors"', 'driver = "ros-arduino-bridge"')
    config.write_text(re.sub(r'^port = "/dev/ttyUSB0"', f'port = "{port}"', lines, flags=re.MULTILINE))
    return config


class TestSerial:
    def test_a_base_on_the_port_of_the_console_is_found(self, tmp_path: Path) -> None:
        wired = replace(PI_4, links={"/dev/serial0": "ttyS0"})
        found = only(wired, tmp_path, "serial", a_base(tmp_path, "/dev/serial0"))
        assert (found.severity, found.remedy.split(",")[0]) == (WRONG, "`sudo raspi-config nonint do_serial_cons 1`")

    def test_programs_that_take_ports_matter_where_there_are_any(self, tmp_path: Path) -> None:
        taken = PC.printing("systemctl is-active ModemManager.service", "active\n")
        taken = replace(taken, files={**taken.files, "/usr/lib/udev/rules.d/85-brltty.rules": ""})
        assert examine(taken, tmp_path, "serial") == []
        (tmp_path / "dev").mkdir()
        (tmp_path / "dev/ttyUSB0").touch()
        assert [each.seen.split()[0] for each in examine(taken, tmp_path, "serial")] == ["ModemManager", "brltty"]
