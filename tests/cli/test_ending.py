"""The end of a run, whatever is pending: a real process that drives emulated wheels over a real pseudo-terminal."""

import fcntl
import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import termios
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from stadimeter.app import ending
from stadimeter.app.clock import MonotonicClock
from stadimeter.app.ending import END_WITHIN_S, LAST_RESORT_S, LAST_WORDS_S
from stadimeter.messaging.apprise_notifier import PATIENCE
from stadimeter.messaging.protocol import Patience
from stadimeter.simulation.emulated_base import EmulatedPort
from stadimeter.simulation.firmware import RosArduinoFirmware
from stadimeter.testing.rig import eventually
from support.processes import is_suspended
from support.simulated_run import SIMULATED_BALL
from support.webhook_listener import HOST, WebhookListener

HANGS_S = 120.0
"""A process that has not ended by then hangs. How long it takes is measured elsewhere: machines are busy at times."""

START_S = 60.0
"""A busy machine takes as long to load the libraries and to begin."""

FOLLOW = """
[base]
driver = "ros-arduino-bridge"
port = "{port}"
wheel_diameter = "6.5 cm"
ticks_per_turn = 800
track_width = "20 cm"
boot_wait = "500 ms"
[rules.follow]
actuator = "base"
follow = {{ distance = "1 m" }}
[rules.seen]
when = {{ below = "3 m" }}
on_delay = "0 s"
{do}
[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]
loop = false
"""

PATIENT = """
from stadimeter.app import ending
ending.END_WITHIN_S, ending.LAST_RESORT_S = 6.0, 9.0
from stadimeter.cli.main import main
main()
"""
"""A run whose end may take longer: of most tests it is no concern how busy the machine is."""

AS_SHIPPED = ("-m", "stadimeter")

HANGING = """
import ctypes, pathlib, sys
from {module} import {name}

def hang(*_):
    "Stay in a call of C that no signal ends, as a call to a disk or a camera may."
    lock = ctypes.create_string_buffer(256)
    pathlib.Path({hangs!r}).touch()
    while True:
        ctypes.CDLL(None).pthread_mutex_lock(lock)

calls = []
real = {name}.{method}

def method(*args, **options):
    calls.append(args)
    return hang() if len(calls) > {after} else real(*args, **options)

{name}.{method} = method
from stadimeter.cli.main import main
main()
"""
"""A run in which one call hangs after some that did not."""


RAISING = """
import errno
from {module} import {name}

calls = []
real = {name}.{method}

def method(*args, **options):
    calls.append(args)
    if len(calls) > 60:
        raise {error}
    return real(*args, **options)

{name}.{method} = method
from stadimeter.cli.main import main
main()
"""
"""A run in which one call raises an error after some that did not."""

USUAL_WARNINGS = (  # the emulated port is reached by a link elsewhere, which stays while its cable is out
    "warning: base: nothing but itself stops it if this process is killed: its driver gives no bytes that do, or its "
    "port is not below /dev\nwarning: a recording or simulation drives real outputs: base\n"
)
SIMULATED_CAMERA = ("stadimeter.simulation.camera", "SimulatedCamera", "read")
BASE = ("stadimeter.bases.serial_base", "SerialBase")
DETECTOR = ("stadimeter.simulation.ideal_detector", "IdealDetector", "detect")
ACTUATOR = ("stadimeter.simulation.devices", "SimulatedActuator", "tick")


class Board(RosArduinoFirmware):
    """Tells a stop that was commanded from one that it makes by itself, when nothing has come for two seconds."""

    stops_commanded = stops_by_itself = 0

    def step(self, now_s):
        was_moving = self._moving
        super().step(now_s)
        self.stops_by_itself += was_moving and not self._moving

    def _set_motor_speeds(self, left, right):
        self.stops_commanded += left == right == 0
        return super()._set_motor_speeds(left, right)


class Robot:
    """Wheels, the board that turns them, and the process that drives."""

    def __init__(self, folder):
        self.folder = folder
        self.board = Board(time.monotonic())
        self.port = EmulatedPort(self.board, MonotonicClock())
        self.process = None
        self.config = folder / "follow.toml"
        self.write()

    def write(self, extra="", do="", port=""):
        self.config.write_text(SIMULATED_BALL + extra + FOLLOW.format(port=port or self.port.path, do=do))

    def start(self, *words, program=("-c", PATIENT), until_driving=True, **options):
        environ = {**os.environ, "XDG_RUNTIME_DIR": str(self.folder / "r"), "NO_COLOR": "1"}
        command = [sys.executable, *program, "run", str(self.config), *map(str, words)]
        options = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
        self.process = subprocess.Popen(command, env=environ, **options)
        if until_driving:
            assert eventually(lambda: self.drives() or self.process.poll() is not None, START_S)
            assert self.process.poll() is None, self.process.stderr and self.process.stderr.read()

    def drives(self):
        return self.board.left.driven_mps > 0

    def end(self, number=signal.SIGTERM):
        """Ask for the end; return the exit code and what was said on standard error."""
        began_s = time.monotonic()
        self.process.send_signal(number)
        said = self.ended()
        print(f"ended {time.monotonic() - began_s:.2f} s after {number.name}, exit code {self.process.returncode}")
        return said

    def ended(self):
        self.process.wait(HANGS_S)
        assert not self.drives()
        said = self.process.stderr.read().decode() if self.process.stderr else ""
        assert "Traceback" not in said
        return self.process.returncode, said

    def close(self):
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            for stream in (self.process.stdout, self.process.stderr):
                if stream is not None:
                    stream.close()
        self.port.close()


@pytest.fixture
def robot(tmp_path_factory):
    robot = Robot(tmp_path_factory.mktemp("t"))
    yield robot
    robot.close()


@contextmanager
def blocked_pipe():
    """Yield the write end of a pipe that nobody reads, and a function that fills it."""
    ours, theirs = os.pipe()
    fcntl.fcntl(theirs, fcntl.F_SETPIPE_SZ, 4096)

    def fill():
        mine = os.open(f"/proc/self/fd/{theirs}", os.O_WRONLY | os.O_NONBLOCK)
        with suppress(BlockingIOError):
            while True:
                os.write(mine, b"\n")
        os.close(mine)

    yield theirs, fill
    os.close(theirs)
    os.close(ours)


@pytest.mark.parametrize("streams", [("stdout",), pytest.param(("stdout", "stderr"), marks=pytest.mark.long)])
def test_a_terminal_that_takes_no_more_lines_does_not_keep_it_from_ending(robot, streams):
    with blocked_pipe() as (pipe, fill):
        robot.start(program=AS_SHIPPED, **dict.fromkeys(streams, pipe))
        fill()
        time.sleep(1.2)  # a line is printed every second
        code, said = robot.end()
    assert code == 128 + signal.SIGTERM
    if "stderr" not in streams:
        assert "SIGTERM: ended after" in said


def test_a_notification_that_hangs_is_given_up_and_counted(robot):
    pytest.importorskip("apprise")
    with WebhookListener() as service:
        service.is_free.clear()
        notifier = f'[notifiers.phone]\ndriver = "apprise"\nurl = "json://{HOST}:{service.port}"\n'
        robot.write(notifier, 'escalation = [{ notify = "phone" }]')
        robot.start()
        assert service.asked.wait(120)
        code, said = robot.end()
    assert code == 0
    assert "given up: 1 notification for phone" in said


def test_a_broker_that_says_nothing_does_not_keep_it_from_ending(robot):
    with socket.create_server((HOST, 0)) as broker:
        robot.write(f'[messenger]\ndriver = "mqtt"\nhost = "{HOST}"\nport = {broker.getsockname()[1]}\n')
        robot.start()
        code, _ = robot.end()
    assert code == 0


def test_a_client_that_never_reads_does_not_keep_it_from_ending(robot):
    robot.start()
    (path,) = (robot.folder / "r" / "stadimeter").iterdir()
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))
        client.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                client.send(b'{"op": "status"}\n')
        time.sleep(0.5)
        code, _ = robot.end()
    assert code == 0
    assert not path.exists()


HANGS = {
    "camera": ("stadimeter.simulation.camera", "SimulatedCamera", "read", 60),
    "detector": ("stadimeter.simulation.ideal_detector", "IdealDetector", "detect", 60),
}


@pytest.mark.parametrize("what", ["detector", pytest.param("camera", marks=pytest.mark.long)])
def test_a_call_that_never_comes_back_in_the_loop_does_not_keep_it_from_ending(robot, what):
    """Not even the handler of the signal runs then. The watch on stalls has stopped the wheels before."""
    module, name, method, after = HANGS[what]
    state = robot.folder / "state.sqlite3"
    script = HANGING.format(hangs=str(robot.folder / "hangs"), module=module, name=name, method=method, after=after)
    robot.start("--state", state, program=("-c", script))
    # On a busy computer the wheels may stand still earlier, for a late picture; then the signal would find no call.
    assert eventually(lambda: (robot.folder / "hangs").exists() and not robot.drives())
    code, said = robot.end()
    assert code == 128 + signal.SIGTERM
    assert re.search(r"SIGTERM: ended after .* this hangs: \S+ in .*stadimeter", said)
    assert state.exists()


def test_a_disk_that_does_not_take_the_state_does_not_keep_it_from_ending(robot):
    script = HANGING.format(
        hangs=str(robot.folder / "hangs"),
        module="stadimeter.app.persistence.alarm_store",
        name="AlarmStore",
        method="write",
        after=0,
    )
    robot.start("--state", robot.folder / "state.sqlite3", program=("-c", script))
    code, said = robot.end()
    assert code == 0
    assert "the state of the alarms: it did not end in time, and was left behind" in said


@pytest.mark.long
def test_a_recording_that_the_disk_does_not_take_is_cut_short_and_said_so(robot):
    pytest.importorskip("mcap")
    script = HANGING.format(
        hangs=str(robot.folder / "hangs"),
        module="stadimeter.app.recordings.recording",
        name="RecordingWriter",
        method="close",
        after=0,
    )
    robot.start("--record", robot.folder / "run.mcap", program=("-c", script))
    code, said = robot.end()
    assert code == 0
    assert "the disk does not answer; the end of the recording is missing" in said


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_a_second_signal_ends_it_at_once(robot, number):
    with blocked_pipe() as (pipe, fill):
        robot.start(stdout=pipe)
        fill()
        time.sleep(1.2)
        robot.process.send_signal(number)
        time.sleep(0.2)
        code, _ = robot.end(number)
    assert code == 128 + number


def test_the_parts_of_the_end_fit_into_what_systemd_waits_for():
    unit = Path(__file__).resolve().parents[2] / "deploy" / "stadimeter.service"
    (patience_s,) = re.findall(r"^TimeoutStopSec=(\d+)s$", unit.read_text(), re.MULTILINE)
    assert END_WITHIN_S < LAST_RESORT_S < LAST_RESORT_S + LAST_WORDS_S < float(patience_s)
    assert max(PATIENCE.goodbye_s, 2 * Patience().goodbye_s) < END_WITHIN_S - 0.3


class Terminal:
    """A terminal that can be closed; what starts in it has it for its controlling terminal."""

    def __init__(self):
        self.ours, self.theirs = pty.openpty()

    def take(self):
        os.setsid()
        fcntl.ioctl(self.theirs, termios.TIOCSCTTY, 0)

    def close(self):
        for end in (self.theirs, self.ours):
            with suppress(OSError):
                os.close(end)


@pytest.fixture
def terminal():
    terminal = Terminal()
    yield terminal
    terminal.close()


@pytest.mark.parametrize("output", ["terminal", "file"])
def test_a_terminal_that_goes_ends_the_run_wherever_its_input_comes_from(robot, terminal, output):
    """As when a window is closed, an ssh connection drops or tmux ends: the kernel sends SIGHUP."""
    with (robot.folder / "out").open("w") as file:
        stream = file if output == "file" else terminal.theirs
        robot.start(preexec_fn=terminal.take, stdout=stream, stderr=stream)
    terminal.close()
    assert robot.ended()[0] == 0
    if output == "file":
        assert "Ended: SIGHUP." in (robot.folder / "out").read_text()


def test_a_run_in_a_terminal_never_takes_a_hangup_for_a_reload(robot, terminal):
    robot.start(preexec_fn=terminal.take)
    assert robot.end(signal.SIGHUP)[0] == 0


def test_nohup_outlives_its_terminal_because_that_was_asked_for(robot, terminal):
    def take_and_ignore():
        terminal.take()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    robot.start(preexec_fn=take_and_ignore)
    terminal.close()
    robot.process.send_signal(signal.SIGHUP)
    time.sleep(0.5)
    assert robot.process.poll() is None
    assert eventually(robot.drives)  # a stall of a busy machine stops it for a moment
    assert robot.end() == (0, USUAL_WARNINGS)


def test_without_a_terminal_a_hangup_has_it_read_its_file_again_and_it_drives_on(robot):
    robot.start("--json", start_new_session=True)
    robot.process.send_signal(signal.SIGHUP)
    line = b"".join(robot.process.stderr.readline() for _ in range(3))  # two warnings come first
    assert b"the configuration was reloaded" in line
    assert eventually(robot.drives)
    robot.end()
    assert json.loads(robot.process.stdout.read())["ended"] == "SIGTERM"


def test_each_signal_of_the_system_is_in_the_table_once():
    table = [*ending.ASKING, signal.SIGHUP, *ending.UNASKED, *ending.SUSPENDING, *ending.HARMLESS, *ending.BEYOND_US]
    assert sorted(table) == sorted(signal.valid_signals())


LONG = pytest.mark.long
USUALLY_SENT = {signal.SIGQUIT, signal.SIGUSR1, signal.SIGALRM, signal.SIGXCPU}


@pytest.mark.parametrize(
    "number", [pytest.param(each, marks=() if each in USUALLY_SENT else LONG) for each in ending.UNASKED]
)
def test_a_signal_that_would_kill_it_stops_the_wheels_first(robot, number):
    robot.start()
    before = robot.board.stops_commanded
    robot.process.send_signal(number)
    code, said = robot.ended()
    assert (code, said) == (0, USUAL_WARNINGS)
    assert robot.board.stops_commanded > before
    assert robot.board.stops_by_itself == 0


@pytest.mark.parametrize(
    "number", [signal.SIGTSTP, *(pytest.param(each, marks=LONG) for each in ending.SUSPENDING[1:])]
)
def test_a_run_that_is_suspended_stops_the_wheels_first_and_drives_on_when_it_is_continued(robot, number):
    robot.start(process_group=0)  # a job of its own, as a shell makes one
    before = robot.board.stops_commanded
    for _ in range(2):
        assert eventually(robot.drives)
        robot.process.send_signal(number)
        assert eventually(lambda: is_suspended(robot.process.pid))
        assert not robot.drives()
        assert robot.board.stops_commanded > before
        robot.process.send_signal(signal.SIGCONT)
    assert eventually(robot.drives)
    assert robot.board.stops_by_itself == 0
    assert robot.end()[0] == 0


def raises(robot, where, error):
    """Run with a call that raises; return the exit code and what was said."""
    module, name, method = where
    robot.start(
        program=("-c", RAISING.format(module=module, name=name, method=method, error=error)), until_driving=False
    )
    robot.process.wait(START_S + HANGS_S)
    return robot.process.returncode, robot.process.stderr.read().decode()


@pytest.mark.parametrize(
    ("where", "error"),
    [
        ((*BASE, "tick"), "SystemExit(0)"),
        ((*BASE, "tick"), "KeyboardInterrupt"),
        ((*BASE, "apply"), "SystemExit(0)"),
        pytest.param((*BASE, "apply"), "KeyboardInterrupt", marks=LONG),
        pytest.param(SIMULATED_CAMERA, "SystemExit(0)", marks=LONG),
        pytest.param(DETECTOR, "SystemExit(0)", marks=LONG),
        pytest.param(ACTUATOR, "SystemExit(0)", marks=LONG),
    ],
)
def test_a_driver_that_asks_for_the_end_of_the_program_stops_everything_and_is_reported(robot, where, error):
    code, said = raises(robot, where, error)
    assert code not in {0, 128 + signal.SIGINT}
    assert "asked for the end" in said or "ended the run" in said
    assert error.partition("(")[0] in said
    assert not robot.drives()
    assert robot.board.stops_commanded > 0
    assert robot.board.stops_by_itself == 0


@pytest.mark.parametrize("name", ["EIO", "EPIPE"])
def test_a_camera_that_fails_as_a_pipe_without_a_reader_does_is_no_good_end(robot, name):
    code, said = raises(robot, SIMULATED_CAMERA, f"OSError(errno.{name}, 'the bus')")
    assert code == 1
    assert "the bus" in said
    assert not robot.drives()
    assert robot.board.stops_by_itself == 0


@pytest.mark.parametrize("where", [DETECTOR, pytest.param((*BASE, "tick"), marks=LONG)])
def test_running_out_of_memory_stops_everything_and_is_said_in_a_line(robot, where):
    code, said = raises(robot, where, "MemoryError('2 GB')")
    assert code == 2
    assert said.splitlines()[-1] == "error: this computer, or a limit set for us, has no more memory: 2 GB"
    assert "Traceback" not in said
    assert not robot.drives()
    assert robot.board.stops_by_itself == 0


def _watchdogs(process):
    """Return the processes that a run has started, by their process ids."""
    return [int(each) for each in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]


def test_the_wheels_are_stopped_when_the_process_is_killed(robot):
    """By the watchdog process: the board itself would only do so two seconds after the last command."""
    robot.write(port=Path(robot.port.path).resolve())  # below /dev, as a real one
    robot.start()
    robot.process.kill()
    robot.process.wait()
    assert eventually(lambda: not robot.drives())
    assert robot.board.stops_by_itself == 0


def test_a_process_that_is_stopped_while_its_wheels_turn_is_killed_and_they_are_stopped(robot):
    robot.write(port=Path(robot.port.path).resolve())  # below /dev, as a real one
    robot.start()
    robot.process.send_signal(signal.SIGSTOP)
    assert robot.process.wait(HANGS_S) == -signal.SIGKILL
    assert eventually(lambda: not robot.drives())


def test_without_its_watchdog_process_the_wheels_stand_until_a_release_which_starts_a_new_one(robot):
    robot.write(port=Path(robot.port.path).resolve())  # below /dev, as a real one
    robot.start()
    (watchdog,) = _watchdogs(robot.process)
    os.kill(watchdog, signal.SIGKILL)
    assert eventually(lambda: not robot.drives())
    time.sleep(0.5)
    assert not robot.drives()
    assert robot.board.stops_by_itself == 0
    environ = {**os.environ, "XDG_RUNTIME_DIR": str(robot.folder / "r")}
    release = [sys.executable, "-m", "stadimeter", "outputs", "release", str(robot.config)]
    said = subprocess.run(release, env=environ, capture_output=True, text=True, check=True).stdout
    assert "by the watchdog: the watchdog process has ended" in said
    assert eventually(robot.drives)
    assert len(_watchdogs(robot.process)) == 1
    assert watchdog not in _watchdogs(robot.process)
    code, _ = robot.end()
    assert code == 0
