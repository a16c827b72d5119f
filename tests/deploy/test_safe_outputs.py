"""safe-outputs against a real pseudo-terminal and pretended pins.

There are pretended tools for pins wherever a list names one: on a Raspberry Pi, the kernel's way would drive real ones.
"""

from __future__ import annotations

import os
import select
import subprocess
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec import Struct


class Port(Struct, frozen=True):
    """A serial port whose other end we hold."""

    master: int
    slave: int
    path: str

    def received(self, *, is_expected: bool = True) -> bytes:
        """Return all that was written: the kernel takes a moment to move it on between its own buffers."""
        found = b""
        while select.select([self.master], [], [], 0.1 if found or not is_expected else 60.0)[0]:
            found += os.read(self.master, 4096)
        return found

    def fill(self) -> None:
        """Write until nothing more fits, as when a base has stopped reading."""
        os.set_blocking(self.slave, False)
        while select.select([], [self.slave], [], 0.05)[1]:  # the kernel moves bytes on between its own buffers
            try:
                os.write(self.slave, b"x")
            except BlockingIOError:
                continue


@pytest.fixture
def port() -> Iterator[Port]:
    master, slave = os.openpty()
    yield Port(master, slave, os.ttyname(slave))
    os.close(slave)
    os.close(master)


class Bench:
    """Runs safe-outputs with pretended pin programs that write down how they were called."""

    def __init__(self, script: Path, folder: Path) -> None:
        self._script = script
        self._folder = folder
        self._log = folder / "calls"
        (folder / "bin").mkdir()
        # The script gives Python 1.9 s, `-s KILL 1.9`. On a busy machine its start alone may take as long.
        patient = folder / "bin" / "timeout"
        patient.write_text('#!/bin/sh\nshift 3\nexec "$@"\n')
        patient.chmod(0o755)

    def add(self, tool: str, ends_with: int = 0) -> None:
        program = self._folder / "bin" / tool
        program.write_text(f'#!/bin/sh\necho "{tool} $*" >>"{self._log}"\ncat >/dev/null\nexit {ends_with}\n')
        program.chmod(0o755)

    def run(self, conf: str | bytes | None, *others: Path) -> str:
        """Run it and return what it complained about."""
        if conf is not None:
            self.file.write_bytes(conf.encode() if isinstance(conf, str) else conf)
        result = self._result(self.file, *others)
        assert (result.returncode, result.stdout) == (0, "")
        return result.stderr

    def check(self, conf: str) -> str:
        """Return what it would drive pins with."""
        self.file.write_text(conf)
        return self._result("--check", self.file).stdout.strip()

    @property
    def file(self) -> Path:
        return self._folder / "safe-outputs.conf"

    def _result(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        path = f"{self._folder / 'bin'}:{os.environ['PATH']}"
        command = ["sh", str(self._script), *map(str, arguments)]
        environment = {**os.environ, "PATH": path}
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)

    @property
    def calls(self) -> list[str]:
        return self._log.read_text().splitlines() if self._log.exists() else []


@pytest.fixture
def bench(deploy: Path, tmp_path: Path) -> Bench:
    return Bench(deploy / "safe-outputs", tmp_path)


def test_pins_are_driven_to_their_safe_level(bench):
    bench.add("pinctrl")
    assert bench.run("# the motor\npin 18\n\npin 5 high\npin 27 low") == ""
    assert bench.calls == ["pinctrl set 18,27 op dl", "pinctrl set 5 op dh"]


@pytest.mark.parametrize("pinctrl_is_there", [True, False])
def test_where_pinctrl_is_missing_or_fails_its_forerunner_is_used(bench, pinctrl_is_there):
    if pinctrl_is_there:
        bench.add("pinctrl", ends_with=1)
    bench.add("raspi-gpio")
    assert bench.run("pin 18\n") == ""
    assert bench.calls[-1] == "raspi-gpio set 18 op dl"


def test_a_base_is_sent_a_stop_at_its_speed(bench, port):
    assert bench.run(f"serial {port.path} 57600\n") == ""
    assert port.received() == b"\rm 0 0\r"
    assert termios.tcgetattr(port.slave)[4:6] == [termios.B57600, termios.B57600]


def test_the_stop_is_not_lost_in_a_command_that_was_cut_off(bench, port):
    os.write(port.slave, b"m 300 30")
    bench.run(f"serial {port.path} 57600\n")
    commands = port.received().split(b"\r")
    assert commands == [b"m 300 30", b"m 0 0", b""]


@pytest.mark.parametrize("lines", ["serial {0}", "serial {0} 57600\r\nserial {0}\r\n"])
def test_the_speed_of_a_base_may_be_left_out_and_the_last_line_may_be_unfinished(bench, port, lines):
    assert bench.run(lines.format(port.path)) == ""
    assert port.received() == b"\rm 0 0\r"


def test_a_line_that_fails_does_not_keep_the_others_from_being_tried(bench, port):
    bench.add("pinctrl")
    complaints = bench.run(
        "pin 99\npin x\npin\npin 18 sideways\nservo 3\n"
        f"serial /dev/no-such-port 57600\nserial {bench._folder} 57600\n"
        f"serial {port.path} fast\nserial {port.path} 57601\n"
        f"serial {port.path} 57600\npin 18\n"
    ).splitlines()
    assert bench.calls == ["pinctrl set 18 op dl"]
    assert port.received() == b"\rm 0 0\r"
    for part in ("'99'", "'x'", "''", "sideways", "servo 3", "/dev/no-such-port", "'fast'", "57601"):
        assert any(part in line for line in complaints), part
    assert all(line.startswith("safe-outputs: ") for line in complaints)


def test_a_port_that_is_full_holds_up_no_pin_and_takes_the_stop_before_what_it_held(bench, port):
    bench.add("pinctrl")
    port.fill()
    assert bench.run(f"serial {port.path} 57600\npin 18\n") == ""
    assert "pinctrl set 18 op dl" in bench.calls
    assert port.received().endswith(b"\rm 0 0\r")


@pytest.mark.parametrize(
    "conf",
    [
        b"# the motor\r\npin 18\r\npin 5 high\r\n",
        b"pin 18\rpin 5 high",
        b"\xef\xbb\xbfpin 18 # the motor\n\tpin  5\thigh\n",
        "pin 18\r\npin 5 high\r\n".encode("utf-16"),
    ],
    ids=["CRLF", "CR", "BOM", "UTF-16"],
)
def test_a_list_from_any_editor_is_read(bench, conf):
    bench.add("pinctrl")
    assert bench.run(conf) == ""
    assert bench.calls == ["pinctrl set 18 op dl", "pinctrl set 5 op dh"]


def test_however_many_lines_there_are_each_pin_is_driven_once_and_none_is_left_out(bench):
    bench.add("pinctrl")
    lines = [f"pin {number % 20}" for number in range(5000)]
    complaints = bench.run("\n".join([*lines, "pin 27 high", "nonsense\n" * 3000]))
    assert bench.calls == [f"pinctrl set {','.join(map(str, range(20)))} op dl", "pinctrl set 27 op dh"]
    assert len(complaints.splitlines()) == 21
    assert complaints.splitlines()[-1] == "safe-outputs: and so on, for 2980 more lines"


def test_two_stops_for_one_port_are_sent_one_after_the_other(bench, port):
    assert bench.run(f"serial {port.path} 57600 0d\nserial {port.path} 115200 0a\n") == ""
    assert port.received() == b"\r\n"


def test_of_two_lines_on_a_pin_the_last_counts_and_that_is_said(bench):
    bench.add("pinctrl")
    assert "pin 18: two levels; the last, high, counts" in bench.run("pin 18\npin 18 high\n")
    assert bench.calls == ["pinctrl set 18 op dh"]


def test_a_list_without_end_is_cut_at_a_line_and_that_is_said(bench):
    bench.add("pinctrl")
    assert "what is beyond them is NOT switched off" in bench.run("pin 5\n" + "# the garden\n" * 80_000 + "pin 18\n")
    assert bench.calls == ["pinctrl set 5 op dl"]


def test_of_a_list_with_too_many_ports_the_pins_and_the_first_ports_are_switched_off(bench, port):
    bench.add("pinctrl")
    lines = [f"serial {port.path} 57600", *(f"serial /dev/ttyUSB{number + 100}" for number in range(16)), "pin 18"]
    complaints = bench.run("\n".join(lines))
    assert "serial /dev/ttyUSB115: not stopped" in complaints
    assert bench.calls == ["pinctrl set 18 op dl"]
    assert port.received() == b"\rm 0 0\r"


def test_it_says_what_would_drive_the_pins_and_drives_none(bench):
    assert bench.check("serial /dev/ttyUSB0\n") == "no pins"
    bench.add("raspi-gpio")
    assert bench.check("pin 18\n") == "raspi-gpio"
    bench.add("pinctrl")
    assert bench.check("pin 18\npin 5 high\n") == "pinctrl"
    assert [call for call in bench.calls if " set " in call] == []


def test_without_a_configuration_it_says_that_nothing_was_done(bench):
    assert "nothing was switched off" in bench.run(None)


def test_a_run_may_say_which_bytes_stop_its_base(bench, port):
    assert bench.run(f"serial {port.path} 115200 005c25ff410a\n") == ""
    assert port.received() == b"\0\\%\xffA\n"


@pytest.mark.parametrize("frame", ["0d6", "0D", "zz", "0d" * 65, "$(id)", "-e"])
def test_what_are_no_bytes_is_refused(bench, port, frame):
    assert "hexadecimal" in bench.run(f"serial {port.path} 57600 {frame}\n")
    assert port.received(is_expected=False) == b""


def test_root_writes_to_serial_ports_only_whatever_link_the_service_made(bench, port):
    link = bench._folder / "link"
    link.symlink_to("/dev/null")
    complaints = bench.run(f"serial {link} 57600 0d\nserial /dev/null 57600 0d\nserial /dev/tty 57600 0d\n")
    assert complaints.count("there is no such port") == 3
    link.unlink()
    link.symlink_to(port.path)
    assert bench.run(f"serial {link} 57600 0d\n") == ""
    assert port.received() == b"\r"


def test_a_number_that_no_shell_can_count_is_no_pin(bench):
    bench.add("pinctrl")
    assert "not the number of a GPIO" in bench.run("pin 99999999999999999999\n")
    assert bench.calls == []


def test_the_lists_of_the_run_and_of_the_user_both_count(bench):
    bench.add("pinctrl")
    second = bench._folder / "mine.conf"
    second.write_text("pin 6 high\n")
    assert bench.run("pin 18 low\n", second) == ""
    assert bench.calls == ["pinctrl set 18 op dl", "pinctrl set 6 op dh"]


def test_a_list_that_is_no_file_is_not_waited_for(bench):
    os.mkfifo(bench._folder / "safe-outputs.conf")
    assert "nothing was switched off" in bench.run(None)


def test_without_the_code_it_says_that_nothing_was_switched_off(bench, deploy, tmp_path):
    alone = tmp_path / "alone" / "safe-outputs"
    alone.parent.mkdir()
    alone.write_bytes((deploy / "safe-outputs").read_bytes())
    bench._script = alone
    assert "outputs are NOT switched off" in bench.run("pin 18\n")
