"""The watchdog process as it is, the lists that it takes, and how it makes pins, buses and ports safe.

Pipes, signals and ends of processes are real, and waited for by what they lead to; no test asserts how soon.
"""

from __future__ import annotations

import errno
import os
import select
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path

import pytest

from stadimeter.app.watchdog import PROGRAM
from stadimeter.testing.rig import eventually
from stadimeter.watchdog import __main__ as program
from stadimeter.watchdog import gpio, stops
from stadimeter.watchdog.__main__ import RunWatch
from stadimeter.watchdog.plan import SafePlan
from support.each_case import each_case
from support.processes import is_suspended
from support.programs import require

# The watchdog process as it is: a real process that watches over a real one, with a pretended tool for pins.

PARENT = """
import os, signal, subprocess, sys
program, lines = sys.argv[1:]
signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
child = subprocess.Popen([sys.executable, "-I", "-S", program, "hold", str(os.getpid())],
                         stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
signal.pthread_sigmask(signal.SIG_UNBLOCK, signal.valid_signals())
child.stdin.write(lines.encode())
child.stdin.flush()
child.stdout.readline()
print(child.pid, flush=True)
for line in sys.stdin:
    if line == "close\\n":
        child.stdin.close()
    else:
        child.stdin.write(line.replace(";", "\\n").encode())
        child.stdin.flush()
    if line.startswith("acts"):
        child.stdout.read(1)
    print("passed on", flush=True)
"""
"""Starts a watchdog process as a run does, and passes on what it reads."""

HANGS_S = 60.0


class Run:
    """A process that stands in for a run, its watchdog process, and the pins that this drives."""

    def __init__(self, folder: Path, lines: str = "pin 18\nlimit 600\n") -> None:
        self._log = folder / "pins"
        self._numbers = count(10)
        self._errors = folder / "errors"
        tools = folder / "bin"
        tools.mkdir()
        (tools / "pinctrl").write_text(f'#!/bin/sh\necho "$*" >>"{self._log}"\n')
        (tools / "pinctrl").chmod(0o755)
        with self._errors.open("wb") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-c", PARENT, PROGRAM, lines],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env={**os.environ, "PATH": f"{tools}:{os.environ['PATH']}"},
            )
        assert self.process.stdout
        self.watchdog = int(self.process.stdout.readline())

    def tell(self, line: str) -> None:
        assert self.process.stdin
        assert self.process.stdout
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "passed on\n"

    def acts(self, age_s: float = 0.0) -> None:
        self.tell(f"acts {next(self._numbers)} {time.monotonic()} {age_s}")

    @property
    def pins(self) -> list[str]:
        return self._log.read_text().splitlines() if self._log.exists() else []

    @property
    def said(self) -> str:
        return self._errors.read_text()

    def ended(self) -> bool:
        """Return whether the watchdog process has ended: with its parent gone, the system has taken it away too."""
        try:
            state = Path(f"/proc/{self.watchdog}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        return state == "Z"

    def close(self) -> None:
        for stream in (self.process.stdin, self.process.stdout):
            assert stream
            with suppress(BrokenPipeError):
                stream.close()
        self.process.kill()
        self.process.wait()


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    run = Run(tmp_path)
    yield run
    run.close()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT, signal.SIGTERM])
def test_whatever_signal_ends_a_run_its_outputs_are_made_safe(run: Run, number: signal.Signals) -> None:
    run.process.send_signal(number)
    assert eventually(run.ended, HANGS_S)
    assert set(run.pins) == {"set 18 op dl"}
    assert run.said == ("watchdog: the program has ended without stopping its outputs: its outputs were made safe\n")


def test_a_run_that_acts_and_hangs_is_killed_first(run: Run) -> None:
    run.tell("limit 0.5")
    with suppress(AssertionError):  # on a slow computer it is killed before it says that it passed this on
        run.acts()
    run.process.send_signal(signal.SIGSTOP)
    assert run.process.wait(HANGS_S) == -signal.SIGKILL
    assert eventually(run.ended, HANGS_S)
    assert set(run.pins) == {"set 18 op dl"}
    assert "acting on data older than 0.5 s, and was killed" in run.said


def test_data_that_is_too_old_ends_a_run_however_often_it_says_so(run: Run) -> None:
    run.tell("limit 0.5")
    with suppress(BrokenPipeError, AssertionError):
        for _ in range(100_000):
            run.acts(age_s=0.7)
    assert run.process.wait(HANGS_S) == -signal.SIGKILL
    assert eventually(run.ended, HANGS_S)
    assert set(run.pins) == {"set 18 op dl"}


def test_a_run_whose_outputs_rest_may_be_stopped_for_as_long_as_anyone_likes(run: Run) -> None:
    run.tell("limit 0.5")
    run.tell(f"acts 1 {time.monotonic()} 0;rests 2")  # at once, however slow this computer is
    run.process.send_signal(signal.SIGSTOP)
    assert eventually(lambda: is_suspended(run.process.pid))
    time.sleep(1.0)  # twice the limit
    run.process.send_signal(signal.SIGCONT)
    run.tell("limit 600")
    run.acts()
    assert run.process.poll() is None
    assert run.pins == []


def test_a_longer_limit_counts_from_when_it_is_told(run: Run) -> None:
    run.tell("limit 0.5")
    run.tell("limit 600")
    run.acts(age_s=2.0)
    time.sleep(1.0)
    assert run.process.poll() is None


def test_a_run_that_has_stopped_its_outputs_itself_has_nothing_done_for_it(run: Run) -> None:
    run.acts()
    run.tell("done")
    assert eventually(run.ended, HANGS_S)
    run.process.kill()
    assert run.pins == []
    assert run.said == ""


def test_signals_to_all_processes_of_a_service_do_not_end_it_before_the_run(run: Run) -> None:
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT, signal.SIGXCPU):
        os.kill(run.watchdog, number)
    run.acts()
    assert not run.ended()
    run.process.kill()
    assert eventually(run.ended, HANGS_S)
    assert set(run.pins) == {"set 18 op dl"}


def test_a_pipe_that_is_closed_while_the_run_lives_makes_its_outputs_safe_too(run: Run) -> None:
    run.tell("close")
    assert eventually(run.ended, HANGS_S)
    assert run.process.poll() is None
    assert run.pins == ["set 18 op dl"] * 2


def test_a_stop_waits_for_no_process_that_is_slow_to_die_and_is_sent_again_after_it(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    happened: list[str] = []

    class SlowToDie(RunWatch):
        def run(self) -> str:
            return "it hung"

        def waits_until_gone(self, within_s: float) -> bool:
            happened.append(f"waited {within_s} s")
            return within_s > 0.0

    def stop(_plan: SafePlan) -> list[str]:
        happened.append("stopped")
        return []

    monkeypatch.setattr(program, "RunWatch", SlowToDie)
    monkeypatch.setattr(program, "make_safe", stop)
    program.hold(run.process.pid)
    assert happened == ["waited 0.0 s", "stopped", "waited 1.0 s", "stopped"]


def test_what_could_not_be_made_safe_is_said(tmp_path: Path) -> None:
    run = Run(tmp_path, "serial /dev/ttyNone 57600 0d\npin 99\nlimit 1\n")
    run.process.kill()
    assert eventually(run.ended, HANGS_S)
    assert run.said.splitlines() == [
        "watchdog: the program has ended without stopping its outputs: its outputs are NOT all safe",
        "watchdog: pin '99': not the number of a GPIO, 0 to 27",
        "watchdog: serial /dev/ttyNone: there is no such port",
    ]
    run.close()


def test_it_is_small_and_loads_nothing_but_a_few_modules_of_the_standard_library(run: Run) -> None:
    run.acts()
    status = dict(
        line.split(":", 1) for line in Path(f"/proc/{run.watchdog}/status").read_text().splitlines() if ":" in line
    )
    print("resident:", status["VmHWM"].strip())
    assert int(status["VmRSS"].split()[0]) < 16_000, "kB; 10 MB with Debian's Python, whose libraries others share"
    maps = Path(f"/proc/{run.watchdog}/maps").read_text()
    assert "numpy" not in maps
    assert "cv2" not in maps


# Lists of what makes outputs safe, which may come from another user.


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


# I2C devices that are pretended, and ports that are real pseudo-terminals.


class Buses:
    """A kernel with I2C buses: /dev/null stands in for their files, and every write is remembered."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *buses: str) -> None:
        self.written: list[tuple[str, int, bytes]] = []
        self.silent: set[int] = set()
        self.held_for_writes = 0  # something holds the bus for so many
        self._open: dict[int, str] = {}
        self._address: dict[int, int] = {}
        self._buses = buses
        self._real = os.open, os.write
        monkeypatch.setattr(stops.os, "open", self.open)
        monkeypatch.setattr(stops.os, "write", self.write)
        monkeypatch.setattr(stops.fcntl, "ioctl", self.ioctl)

    def open(self, path: str, flags: int) -> int:
        if not path.startswith("/dev/i2c-"):
            return self._real[0](path, flags)
        if path not in self._buses:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
        descriptor = self._real[0]("/dev/null", flags)
        self._open[descriptor] = path
        return descriptor

    def ioctl(self, descriptor: int, request: int, address: int) -> int:
        if request == 0x0703:
            self._address[descriptor] = address
        return 0

    def write(self, descriptor: int, data: bytes) -> int:
        if descriptor not in self._open:
            return self._real[1](descriptor, data)
        address = self._address[descriptor]
        if self.held_for_writes:
            self.held_for_writes -= 1
            raise TimeoutError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
        if address in self.silent:
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        self.written.append((self._open[descriptor], address, data))
        return len(data)


def test_each_device_gets_its_writes_and_one_that_is_silent_keeps_no_other_from_its(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    buses = Buses(monkeypatch, "/dev/i2c-1")
    monkeypatch.setattr(stops, "TRIED_FOR_S", 0.1)
    buses.silent = {0x60}
    lines = ["i2c 1 0x60 fd10", "i2c 1 0x40 fd10,0001", "i2c 7 0x40 00"]
    said = stops.make_safe(SafePlan(lines))
    assert buses.written == [("/dev/i2c-1", 0x40, b"\xfd\x10"), ("/dev/i2c-1", 0x40, b"\0\x01")]
    assert sorted(said) == [
        "i2c 1 0x60: not stopped: Remote I/O error",
        "i2c 7 0x40: not stopped: No such file or directory",
    ]


def test_a_device_on_a_bus_that_is_held_for_a_moment_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    buses = Buses(monkeypatch, "/dev/i2c-1")
    monkeypatch.setattr(stops, "TRIED_EVERY_S", 0.0)
    buses.held_for_writes = 5
    assert stops.make_safe(SafePlan(["i2c 1 0x60 fd10", "i2c 1 0x40 fd10"])) == []
    assert {address for _, address, _ in buses.written} == {0x60, 0x40}


def test_a_part_that_hangs_or_has_a_defect_is_named_and_the_others_are_made_safe(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = os.openpty()
    free = os.pipe()
    monkeypatch.setattr(stops, "stop_bus", lambda *_: os.read(free[0], 1))
    monkeypatch.setattr(stops, "drive_pins", lambda *_: {}["no"])
    said = stops.make_safe(SafePlan(["i2c 1 0x40 00", "pin 4", f"serial {os.ttyname(theirs)} 115200 00ff"]), 1.0)
    assert said == ["pins: KeyError: 'no'", "i2c 1: hangs"]
    assert select.select([ours], [], [], 60)[0]
    assert os.read(ours, 100) == b"\0\xff"
    os.write(free[1], b"x")
    for each in (ours, theirs, free[1]):
        os.close(each)


@pytest.mark.parametrize("baud", [57600, 115200, 460800])
def test_the_speeds_of_bases_are_set(baud: int) -> None:
    ours, theirs = os.openpty()
    assert stops.make_safe(SafePlan([f"serial {os.ttyname(theirs)} {baud} 00"])) == []
    assert stops.termios.tcgetattr(theirs)[5] == getattr(stops.termios, f"B{baud}")
    os.close(ours)
    os.close(theirs)


# The writer of pins against what the kernel's header says, and against a kernel that is pretended.

HEADER = """
#include <stdio.h>
#include <stddef.h>
#include <linux/gpio.h>
int main(void) {
    struct gpio_v2_line_request request = {0};
    request.offsets[0] = 18;
    request.config.flags = GPIO_V2_LINE_FLAG_OUTPUT;
    request.config.num_attrs = 1;
    request.config.attrs[0].attr.id = GPIO_V2_LINE_ATTR_ID_OUTPUT_VALUES;
    request.config.attrs[0].attr.values = 1;
    request.config.attrs[0].mask = 1;
    request.num_lines = 1;
    printf("%zu %zu %zu ", sizeof(struct gpiochip_info), sizeof(struct gpio_v2_line_info), sizeof request);
    printf("%lu %lu %lu ", (unsigned long)GPIO_GET_CHIPINFO_IOCTL, (unsigned long)GPIO_V2_GET_LINEINFO_IOCTL,
           (unsigned long)GPIO_V2_GET_LINE_IOCTL);
    printf("%zu ", offsetof(struct gpio_v2_line_info, offset));
    for (size_t i = 0; i < sizeof request; i++) printf("%02x", ((unsigned char *)&request)[i]);
}
"""


class Kernel:
    """A kernel with chips that are files, by their labels, and pins of which one may be busy."""

    def __init__(self, folder: Path, *labels: str) -> None:
        self._labels = {f"gpiochip{number}": label for number, label in enumerate(labels)}
        for name in self._labels:
            (folder / name).touch()
        self.busy: set[int] = set()
        self.driven: list[tuple[str, int, int]] = []
        self.requests: list[bytes] = []

    def __call__(self, descriptor: int, request: int, answer: bytearray) -> int:
        chip = Path(f"/proc/self/fd/{descriptor}").readlink().name
        if request == gpio.GET_CHIP_INFO:
            answer[:] = gpio.CHIP_INFO.pack(chip.encode(), self._labels[chip].encode(), 54)
        elif request == gpio.GET_LINE:
            self.requests.append(bytes(answer))
            pin, value = struct.unpack_from("I", answer)[0], struct.unpack_from("Q", answer, 328)[0]
            if pin in self.busy:
                raise OSError(errno.EBUSY, "Device or resource busy")
            self.driven.append((chip, pin, value))
            struct.pack_into("i", answer, 588, os.open("/dev/null", os.O_RDONLY))
        return 0


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kernel:
    kernel = Kernel(tmp_path, "gpio-brcmstb@107d508500", "pinctrl-rp1")
    monkeypatch.setattr(gpio.fcntl, "ioctl", kernel)
    monkeypatch.setattr(gpio, "TOOLS", ())
    return kernel


def test_what_it_asks_of_the_kernel_is_what_the_kernels_header_says(kernel: Kernel, tmp_path: Path) -> None:
    require("gcc")
    if not Path("/usr/include/linux/gpio.h").exists():
        pytest.skip("not installed: linux/gpio.h; sudo apt install linux-libc-dev")
    (tmp_path / "header.c").write_text(HEADER)
    subprocess.run(["gcc", "-o", tmp_path / "header", tmp_path / "header.c"], check=True)
    said = subprocess.check_output([tmp_path / "header"], text=True).split()
    sizes = [gpio.CHIP_INFO.size, gpio.LINE_INFO.size, gpio.LINE_REQUEST.size]
    assert said[:7] == [*map(str, sizes), *map(str, (gpio.GET_CHIP_INFO, gpio.GET_LINE_INFO, gpio.GET_LINE)), "64"]
    assert gpio.drive_pins({18: True}, [], folder=str(tmp_path)) == gpio.KERNEL
    (request,) = kernel.requests
    assert request[:256].hex() + bytes(32).hex() + request[288:].hex() == said[7]


def test_each_pin_is_driven_on_the_chip_of_the_header_whatever_its_number(kernel: Kernel, tmp_path: Path) -> None:
    assert gpio.drive_pins({18: False, 27: False, 5: True}, [], folder=str(tmp_path)) == gpio.KERNEL
    assert kernel.driven == [("gpiochip1", 5, 1), ("gpiochip1", 18, 0), ("gpiochip1", 27, 0)]


def test_a_pin_that_another_program_holds_does_not_keep_the_others_from_being_driven(
    kernel: Kernel, tmp_path: Path
) -> None:
    kernel.busy = {18}
    said: list[str] = []
    assert gpio.drive_pins({18: False, 27: False}, said, folder=str(tmp_path)) == gpio.NOTHING
    assert kernel.driven == [("gpiochip1", 27, 0)]
    assert said[0] == "pin 18: not driven low: Device or resource busy"
    assert "pins low: 18,27 are NOT driven" in said[1]


def test_a_check_drives_nothing_and_says_the_way(kernel: Kernel, tmp_path: Path) -> None:
    assert gpio.drive_pins({18: False}, [], is_check=True, folder=str(tmp_path)) == gpio.KERNEL
    assert kernel.driven == []


def test_without_the_header_of_a_pi_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpio, "TOOLS", ())
    said: list[str] = []
    assert gpio.drive_pins({18: False, 5: True}, said, folder=str(tmp_path)) == gpio.NOTHING
    assert said[0].startswith("no ")
    assert "pins low: 18 high: 5 are NOT driven" in said[1]
    assert gpio.drive_pins({18: False}, [], is_check=True, folder=str(tmp_path)) == gpio.NOTHING


def test_a_tool_that_hangs_is_killed_and_the_kernels_way_taken(
    kernel: Kernel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool = tmp_path / "pinctrl"
    tool.write_text("#!/bin/sh\nexec sleep 600\n")
    tool.chmod(0o755)
    monkeypatch.setattr(gpio, "TOOLS", (str(tool),))
    assert gpio.drive_pins({18: False}, [], folder=str(tmp_path)) == gpio.KERNEL
    assert kernel.driven == [("gpiochip1", 18, 0)]
