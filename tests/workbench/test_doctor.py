"""What `doctor` finds on computers that are given as captured texts."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from msgspec.structs import replace

from stadimeter.app.live.health import FAILED_UPGRADE
from stadimeter.workbench.doctor.checks import (
    IN_USE,
    INSTALLED,
    PROBE,
    Computer,
    Diagnosis,
    DiagnosisSeverity,
    Examined,
    filters_of,
    find_holder,
    run_command,
)
from support.captured_computers import (
    APT,
    IMX219,
    LOADED,
    OF_UNIT,
    PC,
    PI_4,
    PI_5,
    PLACES,
    SAFE_CHECK,
    STATUS,
    WEBCAM,
    ZERO_2,
    Captured,
    examine,
    library,
    only,
)
from support.ready_bases import follow_ball

CONFIG = Path(__file__).parents[2] / "config"
FINE, WARNING, WRONG, UNKNOWN = DiagnosisSeverity


def worst(found: list[Diagnosis]) -> dict[DiagnosisSeverity, list[str]]:
    return {severity: [each.seen for each in found if each.severity is severity] for severity in DiagnosisSeverity}


@pytest.mark.parametrize("captured", [PI_4, PI_5, PC])
def test_nothing_is_wrong_with_a_computer_that_is_set_up(captured: Captured, tmp_path: Path) -> None:
    found = worst(examine(captured, tmp_path))
    assert (found[WRONG], found[WARNING]) == ([], [])
    assert found[UNKNOWN] == [f"there is no {INSTALLED}"]


def test_everything_that_a_newcomer_forgot_is_found(tmp_path: Path) -> None:
    found = worst(examine(ZERO_2, tmp_path))
    assert [words.split(":")[0].split(",")[0] for words in found[WRONG]] == [
        "under-voltage and throttled now (vcgencmd get_throttled",
        "no camera is found",
    ]
    assert [words.split(",")[0] for words in found[WARNING]] == [
        "this user is not in the group dialout",
        "this user is not in the group video",
        "this user is not in the group gpio",
        "the library lgpio",
        "the board does not restart when the system hangs",
    ]


class TestSupply:
    @pytest.mark.parametrize(
        ("bits", "severity", "seen"),
        [
            ("0x0", FINE, "no under-voltage and no throttling"),
            ("0x50005", WRONG, "under-voltage and throttled now"),
            ("0xe0000", WARNING, "its clock is capped and throttled and slowed by heat since the start"),
        ],
    )
    def test_each_bit_of_the_firmware_has_its_words(
        self, tmp_path: Path, bits: str, severity: DiagnosisSeverity, seen: str
    ) -> None:
        found = only(PI_4.printing("vcgencmd get_throttled", f"throttled={bits}\n"), tmp_path, "supply")
        assert found.severity is severity
        assert found.seen.startswith(seen)


class TestDisk:
    @pytest.mark.parametrize(("free", "severity"), [(0.0, WRONG), (300e6, WARNING), (600e6, FINE)])
    def test_a_disk_that_is_full_or_almost_is_found(
        self, tmp_path: Path, free: float, severity: DiagnosisSeverity
    ) -> None:
        assert only(replace(PC, free_bytes=free), tmp_path, "disk").severity is severity

    @pytest.fixture
    def state(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "home"))
        folder = tmp_path / "home/stadimeter"
        folder.mkdir(parents=True)
        return folder

    @staticmethod
    def troubles(tmp_path: Path) -> list[Diagnosis]:
        found = examine(PC, tmp_path / "root", "disk", config=CONFIG / "demo.toml")
        return [each for each in found if each.severity is not FINE]

    @staticmethod
    def follow(found: Diagnosis) -> str:
        """Run the command of a remedy without `sudo`; return what it prints."""
        command = re.sub(r"\bsudo ", "", found.remedy.split("`")[1])
        return subprocess.run(["sh", "-c", command], check=True, capture_output=True, text=True).stdout

    @pytest.mark.skipif(os.geteuid() != 0, reason="gives a file to another user")
    def test_a_state_of_another_user_is_given_back_by_the_remedy(self, tmp_path: Path, state: Path) -> None:
        (state / "demo.sqlite3").touch()
        assert self.troubles(tmp_path) == []
        os.chown(state / "demo.sqlite3", 12345, 12345)
        (found,) = self.troubles(tmp_path)
        assert (found.severity, found.seen.split()[0]) == (WRONG, str(state / "demo.sqlite3"))
        self.follow(found)
        assert self.troubles(tmp_path) == []

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write every folder")
    def test_a_folder_that_is_not_ours_to_write_is_found(self, tmp_path: Path, state: Path) -> None:
        state.chmod(0o500)
        (found,) = self.troubles(tmp_path)
        assert (found.severity, f"chown -R $USER {state}`" in found.remedy) == (WRONG, True)

    @pytest.mark.skipif(os.geteuid() != 0, reason="mounts a file system")
    def test_a_disk_that_is_read_only_or_full_is_mended_by_the_remedy(self, tmp_path: Path, state: Path) -> None:
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "none", state], capture_output=True, check=False)
        if mounted.returncode:
            pytest.skip(f"no file system can be mounted here: {mounted.stderr.decode()}")
        try:
            (found,) = self.troubles(tmp_path)
            assert (found.severity, "is on a read-only disk" in found.seen) == (WRONG, True)
            self.follow(found)
            assert self.troubles(tmp_path) == []
            (state / "large.mcap").write_bytes(bytes(100_000))
            full = replace(PC, free_bytes=0)
            assert "large.mcap" in self.follow(only(full, tmp_path / "root", "disk", CONFIG / "demo.toml"))
        finally:
            subprocess.run(["umount", state], check=True)


def test_a_clock_that_is_not_set_is_wrong_where_rules_go_by_it(tmp_path: Path) -> None:
    off = replace(PC, is_clock_right=False)
    assert only(off, tmp_path, "clock").severity is WARNING
    config = tmp_path / "night.toml"
    night = '[rules.night]\nseverity = "info"\nwhen = { time = { between = ["22:00", "06:00"] } }\n'
    config.write_text(f"{(CONFIG / 'demo.toml').read_text()}\n{night}")
    assert only(off, tmp_path, "clock", config).severity is WRONG


class TestLibraries:
    ABI = (
        "numpy.dtype size changed, may indicate binary incompatibility. Expected 96 from C header, got 88 from PyObject"
    )

    @pytest.mark.parametrize(
        "error",
        [f"ValueError: {ABI}", "AttributeError: _ARRAY_API not found", "ImportError: numpy.core.multiarray failed"],
    )
    def test_a_library_for_another_numpy_is_named_with_both_versions(
        self, tmp_path: Path, error: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        imports = (library("numpy", "2.2.6"), *LOADED[1:4], library("picamera2", "", APT, error=error))
        found = only(replace(PI_4, imports=imports), tmp_path, "libraries")
        assert found.severity is WRONG
        assert found.seen.startswith("picamera2 does not load beside numpy 2.2.6: it was built for another numpy")
        assert found.remedy == f"{sys.executable} -m pip install 'numpy<2' 'opencv-python-headless<4.12'"
        of_pip = (*imports[:-1], library("simplejpeg", error=error))
        found = only(replace(PI_4, imports=of_pip), tmp_path, "libraries")
        assert found.remedy.endswith("-m pip install --force-reinstall simplejpeg")
        monkeypatch.setattr(sys, "prefix", "/opt/stadimeter/current")
        found = only(replace(PI_4, imports=imports), tmp_path, "libraries")
        assert found.remedy.startswith("`sudo apt install --reinstall ./stadimeter_")

    def test_picamera2_of_pip_lacks_what_only_apt_has(self, tmp_path: Path) -> None:
        of_pip = library("picamera2", error="ModuleNotFoundError: No module named 'libcamera'")
        found = only(replace(PI_4, imports=(*LOADED[:4], of_pip)), tmp_path, "libraries")
        assert found.remedy.startswith("`sudo apt install python3-picamera2 && python3 -m venv --system-site-packages")

    @pytest.mark.parametrize(("code", "how"), [(-11, "crashes Python"), (None, "takes too long")])
    def test_a_library_that_crashes_or_hangs_is_named(self, tmp_path: Path, code: int | None, how: str) -> None:
        imports = (LOADED[0], {"trying": "cv2"})
        found = only(replace(PI_4, imports=imports, imports_code=code), tmp_path, "libraries")
        assert (found.severity, found.seen) == (WRONG, f"importing cv2 {how}")

    @pytest.mark.parametrize("name", ["numpy", "cv2", "simplejpeg", "pydantic"])
    @pytest.mark.parametrize("fault", [{"missing": True}, {"error": "ImportError: it is damaged"}])
    def test_the_remedy_installs_the_package_that_brings_a_library(
        self, tmp_path: Path, name: str, fault: dict[str, object]
    ) -> None:
        imports = [library(name, **fault) if each["name"] == name else each for each in LOADED]
        found = only(replace(PI_4, imports=imports), tmp_path, "libraries")
        assert found.severity is WRONG
        *command, package = shlex.split(found.remedy)
        assert command == [sys.executable, "-m", "pip", "install", "--force-reinstall"]
        assert package in packages_distributions()[name]

    def test_the_libraries_of_this_python_load_together(self) -> None:
        (found,) = Examined(Computer()).libraries
        assert found.severity is FINE
        assert f"Python {sys.version.split()[0]} in {sys.prefix}; numpy " in found.seen

    def test_the_line_before_a_library_that_ends_python_is_the_last(self, tmp_path: Path) -> None:
        (tmp_path / "ends.py").write_text("import os\nos._exit(3)\n")
        answer = run_command(("env", f"PYTHONPATH={tmp_path}", sys.executable, "-c", PROBE, "json", "ends"))
        assert answer is not None
        assert answer.code == 3
        assert answer.output.splitlines()[-1] == '{"trying": "ends"}'


OVERRIDE = "/etc/systemd/system/stadimeter.service.d/override.conf"


class TestService:
    SHOW = f"systemctl show stadimeter.service --property={OF_UNIT}"
    MASKED = ": nothing starts it, and one that runs is ended as if it hung, and may leave outputs on"

    @pytest.mark.parametrize(
        ("changed", "severity", "seen"),
        [
            ({}, FINE, "the service runs, 0 restarts"),
            ({"NRestarts": "7"}, WARNING, "the service runs, after 7 restarts"),
            ({"ActiveState": "failed", "Result": "watchdog"}, WRONG, "the service has failed (watchdog), 0 restarts"),
            (
                {"SubState": "auto-restart", "Result": "exit-code"},
                WRONG,
                "the service has failed (exit-code), 0 restarts",
            ),
            ({"LoadState": "masked"}, WRONG, f"the service is masked{MASKED}"),
            (
                {"LoadState": "masked", "ActiveState": "failed", "Result": "watchdog"},
                WRONG,
                f"the service is masked and has failed (watchdog){MASKED}",
            ),
            (
                {"LoadState": "bad-setting", "ActiveState": "inactive", "DropInPaths": OVERRIDE},
                WRONG,
                f"the service cannot be started (bad-setting), changed by {OVERRIDE}",
            ),
            ({"DropInPaths": OVERRIDE}, FINE, f"the service runs, 0 restarts, changed by {OVERRIDE}"),
            ({"NeedDaemonReload": "yes"}, WARNING, "the service runs, and its unit was changed since"),
            ({"ActiveState": "activating"}, WARNING, "the service is activating, 0 restarts"),
            ({"LoadState": "not-found"}, FINE, "stadimeter is not installed as a service on this computer"),
        ],
    )
    def test_each_state_is_judged(
        self, tmp_path: Path, changed: dict[str, str], severity: DiagnosisSeverity, seen: str
    ) -> None:
        state = dict(line.split("=") for line in PI_4.commands[self.SHOW].splitlines()) | changed
        shown = "".join(f"{key}={value}\n" for key, value in state.items())
        found = only(PI_4.printing(self.SHOW, shown), tmp_path, "service")
        assert (found.severity, found.seen) == (severity, seen)

    def test_a_limit_of_starts_is_lifted_and_changes_are_taken_back_by_the_remedy(self, tmp_path: Path) -> None:
        changed = f"ActiveState=failed\nResult=start-limit-hit\nDropInPaths={OVERRIDE}\n"
        found = only(PI_4.printing(self.SHOW, f"{PI_4.commands[self.SHOW]}{changed}"), tmp_path, "service")
        assert "`sudo systemctl revert stadimeter.service`" in found.remedy
        assert found.remedy.endswith("; then `sudo systemctl reset-failed stadimeter.service`")

    @staticmethod
    def installed(captured: Captured) -> Captured:
        captured = captured.with_files(status=STATUS.format(uid=0, groups="0"))
        return replace(captured, files={**captured.files, INSTALLED: (CONFIG / "appliance.toml").read_text()})

    def test_an_upgrade_that_failed_is_found_with_its_reason(self, tmp_path: Path) -> None:
        why = "the upgrade to stadimeter 1.2 failed its self-test, and 1.1 stays: no numpy"
        captured = replace(PI_4, files={**PI_4.files, f"/{FAILED_UPGRADE}": f"{why}\n"})
        found = examine(captured, tmp_path, "service")[0]
        assert (found.severity, found.seen) == (WRONG, why)

    def test_without_systemd_nothing_is_known(self, tmp_path: Path) -> None:
        assert only(replace(PI_4, commands={}), tmp_path, "service").severity is UNKNOWN

    @pytest.mark.parametrize(
        ("lines", "severity"), [("pin 17 low\n", FINE), ("pin 17 high\n", WRONG), ("pin 18 low\n", WRONG), ("", WRONG)]
    )
    def test_the_safe_outputs_are_those_of_the_configuration(
        self, tmp_path: Path, lines: str, severity: DiagnosisSeverity
    ) -> None:
        captured = self.installed(PI_4).with_files(safe_conf=lines)
        found = only(captured, tmp_path, "safe-outputs")
        assert found.severity is severity

    @pytest.mark.parametrize(
        ("way", "severity", "seen"),
        [
            ("pinctrl", FINE, "outputs are switched off after the service, pins by pinctrl"),
            ("nothing", WRONG, "the pins cannot be switched off after the service"),
        ],
    )
    def test_that_pins_can_be_switched_off_is_tried_and_not_assumed(
        self, tmp_path: Path, way: str, severity: DiagnosisSeverity, seen: str
    ) -> None:
        captured = self.installed(PI_4).with_files(safe_conf="pin 17 low\n").printing(SAFE_CHECK, f"{way}\n")
        found = only(captured, tmp_path, "safe-outputs")
        assert found.severity is severity
        assert found.seen.startswith(seen)
        assert ("raspi-utils" in found.remedy) is (severity is WRONG)
        maker = captured.with_files(status=STATUS.format(uid=1000, groups="986"))
        assert only(maker, tmp_path, "safe-outputs").severity is UNKNOWN

    def test_a_line_that_switches_nothing_off_is_found(self, tmp_path: Path) -> None:
        captured = self.installed(PI_4).with_files(safe_conf="pin 17 low\n")
        captured = replace(captured, complaint="safe-outputs: pin '99': not the number of a GPIO\n")
        found = examine(captured, tmp_path, "safe-outputs")[0]
        assert found.severity is WRONG
        assert "pin '99': not the number of a GPIO" in found.seen

    @pytest.mark.parametrize(
        ("changed", "severity", "seen"),
        [
            ({}, FINE, "the page's service runs, 0 restarts"),
            ({"ActiveState": "failed", "Result": "exit-code"}, WRONG, "the page's service has failed (exit-code)"),
            ({"ActiveState": "inactive"}, WARNING, "the page's service is inactive"),
        ],
    )
    def test_the_service_of_the_page_is_judged(
        self, tmp_path: Path, changed: dict[str, str], severity: DiagnosisSeverity, seen: str
    ) -> None:
        state = dict(line.split("=") for line in PI_4.commands[self.SHOW].splitlines()) | changed
        shown = "".join(f"{key}={value}\n" for key, value in state.items())
        of_page = self.SHOW.replace("stadimeter.service", "stadimeter-web.service")
        found = examine(PI_4.printing(of_page, shown), tmp_path, "service")[1]
        assert found.severity is severity
        assert found.seen.startswith(seen)

    def test_watchdogs_that_are_off_are_found(self, tmp_path: Path) -> None:
        off = PI_4.printing("systemctl show --property=RuntimeWatchdogUSec", "RuntimeWatchdogUSec=0\n").printing(
            "systemctl show stadimeter.service --property=LoadState,WatchdogUSec", "LoadState=loaded\nWatchdogUSec=0\n"
        )
        assert [each.severity for each in examine(off, tmp_path, "watchdogs")] == [WARNING, WARNING]


class TestConfiguration:
    def test_the_first_error_is_shown_in_a_line(self, tmp_path: Path) -> None:
        config = tmp_path / "bad.toml"
        config.write_text("[camera]\ndriver = 'simulated'\nfast = 1\n[rules.x]\nwhen = 3\n")
        found = only(PC, tmp_path, "configuration", config)
        assert found.severity is WRONG
        assert "\n" not in found.seen
        assert "more" in found.seen

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
    def test_one_that_is_not_ours_to_read_is_not_known(self, tmp_path: Path) -> None:
        config = tmp_path / "mine.toml"
        config.write_text("")
        config.chmod(0)
        assert only(PC, tmp_path, "configuration", config).remedy == "call doctor with `sudo`"


class TestComputer:
    def test_a_command_that_takes_too_long_is_stopped(self) -> None:
        answer = run_command(("sh", "-c", "echo begun; exec sleep 60"), 1.0)
        assert answer is not None
        assert (answer.code, answer.output) == (None, "begun\n")


# What `doctor` finds on groups, cameras, pins and serial ports, on computers that are given as captured texts.

NOT_FREE = f"{IN_USE}: motion (412); close that one"


class TestGroups:
    def test_a_group_that_is_lacked_is_named_with_its_remedy(self, tmp_path: Path) -> None:
        none = PI_4.with_files(status=STATUS.format(uid=1000, groups="1000"))
        found = examine(none, tmp_path, "groups")
        assert [each.severity for each in found] == [WARNING] * 3
        assert "`sudo usermod -aG video $USER`, then log out and in again, or restart" in {
            each.remedy for each in found
        }

    def test_root_may_use_all(self, tmp_path: Path) -> None:
        root = PI_4.with_files(status=STATUS.format(uid=0, groups="0"))
        assert only(root, tmp_path, "groups").seen.startswith("root may use every device")


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

    def test_a_ribbon_camera_without_its_library_is_found(self, tmp_path: Path) -> None:
        bare = replace(PI_4, cameras=(), imports=(*LOADED[:4], library("picamera2", missing=True)))
        found = examine(bare, tmp_path, "cameras")[0]
        assert found.seen == "a ribbon camera is there, and this Python does not see the library picamera2"
        assert found.remedy.startswith("`sudo apt install python3-picamera2")
        assert "--system-site-packages" in found.remedy

    def test_a_configuration_without_such_a_camera_needs_none(self, tmp_path: Path) -> None:
        assert only(replace(PC, cameras=()), tmp_path, "cameras").severity is WRONG
        found = only(replace(PC, cameras=()), tmp_path, "cameras", CONFIG / "demo.toml")
        assert (found.severity, "needs none" in found.seen) == (FINE, True)

    def test_only_who_wants_a_ribbon_camera_lacks_one(self, tmp_path: Path) -> None:
        bare = replace(PI_4, cameras=()).without(PLACES["video0"])
        on_usb = only(bare, tmp_path / "usb", "cameras", CONFIG / "distance-alert.toml")
        assert on_usb.seen == "no camera is found"
        config = tmp_path / "ribbon.toml"
        lines = (CONFIG / "distance-alert.toml").read_text()
        config.write_text(lines.replace('driver = "opencv"\ndevice = 0', 'driver = "picamera2"'))
        with_webcam = replace(bare, cameras=(WEBCAM,))
        assert only(with_webcam, tmp_path / "none", "cameras").severity is FINE
        found = examine(with_webcam, tmp_path / "ribbon", "cameras", config=config)
        assert found[-1].seen.startswith("no ribbon camera is found")


class TestPins:
    def test_pins_of_a_configuration_need_a_pi(self, tmp_path: Path) -> None:
        assert examine(PC, tmp_path, "pins") == []
        assert only(PC, tmp_path, "configuration", CONFIG / "distance-alert.toml").severity is WRONG

    @staticmethod
    def taken(captured: Captured, folder: Path, gpio: int) -> list[Diagnosis]:
        config = folder / "pin.toml"
        config.write_text((CONFIG / "distance-alert.toml").read_text().replace("pin = 18", f"pin = {gpio}"))
        return [each for each in examine(captured, folder / "root", "pins", config=config) if each.severity is not FINE]

    @pytest.mark.parametrize(
        ("gpio", "line"),
        [
            (4, "dtoverlay=w1-gpio"),
            (17, "dtoverlay=w1-gpio,gpiopin=17"),
            (19, "dtoverlay=hifiberry-dacplus,24db_digital_gain"),
            (3, "dtoverlay=gpio-shutdown"),
            (24, "dtoverlay=gpio-shutdown,active_low=1,gpio_pin=24"),
            (12, "dtoverlay=gpio-fan,temp=60000"),
            (18, "dtoverlay=pwm"),
            (13, "dtoverlay=pwm-2chan,pin=12,func=4,pin2=13,func2=4"),
            (8, "dtparam=audio=on,spi=on"),
            (2, "dtparam=i2c_arm=on"),
            (15, "enable_uart=1"),
            (14, "dtoverlay=disable-bt"),
            (21, "dtoverlay=iqaudio-dacplus"),
            (17, "dtoverlay=rotary-encoder"),
            (9, "dtoverlay=spi0-1cs"),
        ],
    )
    def test_a_pin_that_config_txt_gives_away_is_found_with_its_line(
        self, tmp_path: Path, gpio: int, line: str
    ) -> None:
        lines = f"[all]\n{line}\n[cm4]\notg_mode=1\n"
        (found,) = self.taken(PI_4.with_files(config_txt=lines), tmp_path, gpio)
        assert (found.severity, f"`{line}` of /boot/firmware/config.txt" in found.seen) == (WRONG, True)
        assert found.remedy == "another pin for 'motor'; or put # before that line, and restart"
        assert self.taken(PI_4.with_files(config_txt=lines), tmp_path, 25) == []
        assert self.taken(PI_4.with_files(config_txt=lines.replace(line, f"#{line}")), tmp_path, gpio) == []

    @pytest.mark.parametrize(
        ("filtered", "is_ours"),
        [("pi4", True), ("pi400", False), ("pi5", False), ("none", False), ("all", True), ("gpio4=1", False)],
    )
    def test_a_line_for_another_board_takes_no_pin(self, tmp_path: Path, filtered: str, is_ours: bool) -> None:
        captured = replace(PI_4, files={**PI_4.files, "/boot/config.txt": f"[{filtered}]\ndtoverlay=w1-gpio\n"})
        assert bool(self.taken(captured, tmp_path, 4)) is is_ours

    def test_a_later_line_that_switches_it_off_frees_its_pins(self, tmp_path: Path) -> None:
        assert self.taken(PI_4.with_files(config_txt="dtparam=spi=on\ndtparam=spi=off\n"), tmp_path, 8) == []

    @pytest.mark.parametrize(
        ("lines", "gpios"),
        [
            ("dtoverlay=w1-gpio,gpiopin=17\ndtoverlay=w1-gpio,gpiopin=22", {17, 22}),
            ("dtoverlay=w1-gpio\ndtparam=gpiopin=17\ndtparam=i2c_arm=on", {17, 2, 3}),
            ("dtparam=i2c_arm=on\ndtparam=i2c=off", set()),
            ("dtparam=spi", {7, 8, 9, 10, 11}),
            ("include mine.txt\n[pi5]\ndtoverlay=dht11", {27}),
        ],
    )
    def test_lines_that_belong_together_are_read_together(self, tmp_path: Path, lines: str, gpios: set[int]) -> None:
        captured = PI_4.with_files(config_txt=f"{lines}\n")
        captured = replace(
            captured, files={**captured.files, "/boot/firmware/mine.txt": "dtoverlay=dht11,gpiopin=27\n"}
        )
        assert {gpio for gpio in range(2, 28) if self.taken(captured, tmp_path, gpio)} == gpios

    @pytest.mark.parametrize(
        ("model", "filters"),
        [
            ("Raspberry Pi Model B Plus Rev 1.2", {"[pi1]"}),
            ("Raspberry Pi 3 Model B Plus Rev 1.3", {"[pi3]", "[pi3+]"}),
            ("Raspberry Pi Zero 2 W Rev 1.0", {"[pi0]", "[pi0w]", "[pi02]"}),
            ("Raspberry Pi 500 Rev 1.0", {"[pi5]", "[pi500]"}),
            ("Raspberry Pi Compute Module 4 Rev 1.1", {"[pi4]", "[cm4]"}),
        ],
    )
    def test_each_board_has_its_filters(self, model: str, filters: set[str]) -> None:
        assert filters_of(model) - {"[all]", ""} == filters

    def test_a_pin_that_is_held_says_by_whom(self, tmp_path: Path) -> None:
        held = replace(PI_4, holders={18: "lg"})
        (found,) = self.taken(held, tmp_path, 18)
        assert (found.severity, found.seen) == (WRONG, "GPIO 18 of 'motor' is held by 'lg', as the kernel calls it")
        assert "`sudo fuser -v /dev/gpiochip0`" in found.remedy
        assert self.taken(held.printing("systemctl is-active stadimeter.service", "active\n"), tmp_path, 18) == []

    @pytest.mark.parametrize(
        ("name", "flags", "holder"), [(b"spi0 CS0", 3, "spi0 CS0"), (b"", 1, "a driver of the kernel"), (b"", 2, "")]
    )
    def test_the_kernel_is_asked_for_the_line(self, tmp_path: Path, name: bytes, flags: int, holder: str) -> None:
        (tmp_path / "gpiochip0").touch()

        def answer(_file: int, request: int, asked: bytes) -> bytes:
            assert (request, len(asked), asked[64:68]) == (0xC100B405, 256, b"\x11\0\0\0")
            return asked[:32] + name.ljust(32, b"\0") + asked[64:72] + flags.to_bytes(8, "little") + asked[80:]

        assert find_holder(tmp_path / "gpiochip0", 17, answer) == holder


def a_base(folder: Path, port: str) -> Path:
    config = folder / "base.toml"
    lines = follow_ball("ros-arduino-bridge")
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
