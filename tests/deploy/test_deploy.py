"""The files of deploy/ do what they say, each tried with the real program that reads it."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from packaging.requirements import Requirement

from stadimeter.app.places import socket_path
from stadimeter.app.service import MAX_PAUSE_S
from stadimeter.config.models import WebTable
from stadimeter.web import passwords
from support.programs import require

SCRIPTS = (
    "safe-outputs",
    "debian/preinst",
    "debian/postinst",
    "debian/prerm",
    "debian/postrm",
    "mosquitto/make-certificates",
)


def installed(program: str) -> str:
    require(program)
    return program


def run(*command: str | Path, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        **options,  # type: ignore[call-overload]
    )


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_scripts_are_executable_shell(deploy, script):
    assert os.access(deploy / script, os.X_OK)
    assert run("sh", "-n", deploy / script).stderr == ""


@pytest.mark.parametrize("script", SCRIPTS)
def test_shellcheck_finds_nothing(deploy, script):
    result = run(installed("shellcheck"), deploy / script)
    assert result.returncode == 0, result.stdout


UNITS = ("stadimeter.service", "stadimeter-web.service")


@pytest.fixture(params=UNITS)
def unit(request: pytest.FixtureRequest, deploy: Path, tmp_path: Path) -> Path:
    """Return a unit with programs that exist on any machine in place of ours."""
    text = (deploy / request.param).read_text()
    for program in ("/opt/stadimeter/bin/stadimeter", "/usr/lib/stadimeter/safe-outputs"):
        text = text.replace(program, "/bin/true")
    unit = tmp_path / request.param
    unit.write_text(text)
    return unit


def test_systemd_accepts_each_unit_without_a_warning(unit):
    result = run(installed("systemd-analyze"), "verify", "--man=no", unit)
    assert (result.returncode, result.stderr) == (0, "")


def test_each_unit_is_as_closed_as_what_serves_a_network_can_be(unit):
    result = run(installed("systemd-analyze"), "security", "--offline=yes", "--no-pager", unit)
    found = re.search(r"Overall exposure level for \S+: (\d+\.\d+)", result.stdout)
    if found is None:
        pytest.skip(f"systemd-analyze cannot judge a unit that is not running: {result.stderr.strip()}")
    assert float(found[1]) <= 1.8


def test_without_memory_the_kernel_ends_what_the_page_computes_and_the_run_last(deploy):
    run, page = ((deploy / unit).read_text().splitlines() for unit in UNITS)
    assert "OOMScoreAdjust=-500" in run
    assert not [line for line in run if line.startswith("MemoryMax")], "a limit would end the run"
    assert {"OOMScoreAdjust=500", "OOMPolicy=continue", "MemoryMax=50%"} <= set(page)


class TestUnitOfThePage:
    def test_it_holds_no_pin_and_no_base(self, deploy):
        lines = (deploy / "stadimeter-web.service").read_text().splitlines()
        allowed = {line.split("=")[1].split()[0] for line in lines if line.startswith("DeviceAllow=")}
        assert allowed == {"char-video4linux", "char-media", "char-dma_heap"}
        assert "SupplementaryGroups=video" in lines

    def test_its_options_are_those_of_the_command_and_its_passwords_where_the_command_sets_them(self, deploy):
        text = (deploy / "stadimeter-web.service").read_text()
        (words,) = re.findall("^ExecStart=(.*)$", text, re.MULTILINE)
        _, command, configuration, option, file = words.split()
        assert (command, configuration) == ("web", "/etc/stadimeter/appliance.toml")
        assert (option, Path(file)) == ("--password-file", passwords.SERVICE_FOLDER / "page.passwords")

    def test_avahi_tells_of_the_port_that_it_listens_at(self, deploy):
        (service,) = ET.parse(deploy / "avahi/stadimeter.service").iter("service")  # noqa: S314 - our own
        port = WebTable.model_fields["port"].default
        assert (service.findtext("type"), service.findtext("port")) == ("_http._tcp", str(port))

    def test_avahi_tells_of_it_only_if_it_has_a_password_and_so_can_be_reached(self, deploy, tmp_path):
        text = (deploy / "stadimeter-web.service").read_text()
        (script,) = re.findall("^ExecStartPost=-[+]/usr/bin/sh -c '(.*)'$", text, re.MULTILINE)
        (tmp_path / "avahi.service").write_text("told")
        places = {"/usr/share/stadimeter": tmp_path, "/var/lib/stadimeter": tmp_path, "/etc/avahi/services": tmp_path}
        for place, ours in places.items():
            assert place in script
            script = script.replace(place, str(ours))
        run("sh", "-c", script)
        assert not (tmp_path / "stadimeter.service").exists()
        (tmp_path / "page.passwords").write_text("{}")
        run("sh", "-c", script)
        assert (tmp_path / "stadimeter.service").read_text() == "told"


class TestUnit:
    def test_it_is_watched_and_has_time_for_the_longest_wait_before_devices_are_opened(self, deploy):
        lines = (deploy / "stadimeter.service").read_text().splitlines()
        assert {"Type=notify", "WatchdogSec=3s", "RuntimeDirectoryPreserve=restart", "Restart=always"} <= set(lines)
        assert "TimeoutStartSec=2min" in lines
        assert MAX_PAUSE_S <= 120 / 2, "a small Pi needs the rest for loading and for its camera"

    def test_safe_outputs_may_use_the_devices_it_needs(self, deploy):
        lines = (deploy / "stadimeter.service").read_text().splitlines()
        assert "ExecStopPost=+/usr/lib/stadimeter/safe-outputs" in lines
        allowed = {line.split("=")[1].split()[0] for line in lines if line.startswith("DeviceAllow=")}
        assert {"char-*gpiomem*", "char-gpiochip", "char-ttyUSB", "char-ttyACM", "char-video4linux"} <= allowed

    def test_it_may_use_motor_boards_and_range_sensors_on_i2c_whose_module_is_there_when_it_starts(self, deploy):
        lines = (deploy / "stadimeter.service").read_text().splitlines()
        groups = next(line.split("=")[1].split() for line in lines if line.startswith("SupplementaryGroups="))
        assert ("DeviceAllow=char-i2c rw" in lines, "i2c" in groups) == (True, True)
        assert "i2c_dev" in (deploy / "modules-load.conf").read_text().splitlines()

    def test_a_reload_asks_the_program_that_runs_and_state_and_socket_have_their_folders(self, deploy):
        lines = (deploy / "stadimeter.service").read_text().splitlines()
        assert "ExecReload=/opt/stadimeter/bin/stadimeter reload --socket /run/stadimeter/appliance.sock" in lines
        assert {"StateDirectory=stadimeter", "RuntimeDirectory=stadimeter"} <= set(lines)
        run_it = next(line for line in lines if line.startswith("ExecStart="))
        assert socket_path(Path(run_it.split()[-1]), Path("/run/stadimeter")) == Path("/run/stadimeter/appliance.sock")

    def test_what_gpiozero_reads_to_recognise_the_pi_is_not_hidden(self, deploy):
        assert "\nProcSubset" not in (deploy / "stadimeter.service").read_text()


def test_the_udev_rules_name_a_tty_by_vendor_and_product(deploy):
    rule = re.compile(
        r'SUBSYSTEM=="tty", ATTRS\{idVendor\}=="[0-9a-f]{4}", ATTRS\{idProduct\}=="[0-9a-f]{4}", '
        r'SYMLINK\+="robot-base", TAG\+="systemd", ENV\{ID_MM_DEVICE_IGNORE\}="1"'
    )
    lines = (deploy / "99-stadimeter.rules").read_text().splitlines()
    rules = [line for line in lines if line and not line.startswith("#")]
    assert rules
    assert [line for line in rules if not rule.fullmatch(line)] == []


def test_the_module_list_names_the_drivers_of_cameras_and_of_serial_adapters(deploy):
    lines = (deploy / "modules-load.conf").read_text().splitlines()
    modules = [line for line in lines if line and not line.startswith("#")]
    assert {"uvcvideo", "cdc_acm", "ch341"} <= set(modules)
    assert all(re.fullmatch(r"\w+", module) for module in modules)


@pytest.mark.parametrize("release", ["deb12", "deb13"])
def test_the_lock_of_the_package_is_within_the_ranges_of_the_project(deploy, release):
    project = tomllib.loads((deploy.parent / "pyproject.toml").read_text())["project"]
    locked = dict(re.findall(r"^([\w-]+)==(\S+)", (deploy / f"debian/{release}.lock").read_text(), re.MULTILINE))
    extras = ("metrics", "record", "sun", "web")
    ranges = [*project["dependencies"], *(each for extra in extras for each in project["optional-dependencies"][extra])]
    for wanted in map(Requirement, ranges):
        assert locked[wanted.name] in wanted.specifier, f"{wanted}: run make lock"
