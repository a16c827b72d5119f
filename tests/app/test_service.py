"""What systemd is told, on a clock that is stepped and through a real socket."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.service import (
    MAX_PATIENCE_S,
    PROVEN_S,
    CameraWait,
    FailedStarts,
    NotifySocket,
    Service,
    patience_s,
    pause_s,
    service,
)
from stadimeter.config.loader import load_configuration
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError
from stadimeter.testing.rig import ManualClock
from support.each_case import each_case
from support.simulated_run import SIMULATED_BALL


class System:
    """The side of systemd: receives what the program sends."""

    def __init__(self, address: str) -> None:
        self.address = address.replace("\0", "@")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)
        self._socket.setblocking(False)

    def heard(self) -> list[str]:
        """Return every line that has come since the last call."""
        lines: list[str] = []
        while True:
            try:
                lines += self._socket.recv(65536).decode().split("\n")
            except BlockingIOError:
                return lines

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def system(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[System]:
    is_abstract = getattr(request, "param", "a path") != "a path"
    system = System(f"\0stadimeter-test-{os.getpid()}-{id(request)}" if is_abstract else str(tmp_path / "notify"))
    yield system
    system.close()


@pytest.fixture(scope="module")
def cycles(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[CycleRecord, Frame | None]]:
    """Return the first cycles of a run that sees a ball at 2 m."""
    path = tmp_path_factory.mktemp("run") / "run.toml"
    path.write_text(
        SIMULATED_BALL + '[rules.near]\nactuator = "motor"\nwhen = { below = "3 m" }\n'
        '[world]\npath = [{ at = "0 s", x = "2 m", y = "0 m" }]\n'
    )
    loop = Loop(build(load_configuration(path), speed=None))
    found: list[tuple[CycleRecord, Frame | None]] = []
    loop.listeners.append(lambda record, frame: found.append((record, frame)))
    loop.run(Limits(frames=10))
    return found


class Rig:
    def __init__(self, system: System, cycle: tuple[CycleRecord, Frame | None], **options: object) -> None:
        self.clock = ManualClock()
        self.cycle = cycle
        self.service = Service(NotifySocket(system.address), clock=self.clock.now_s, **options)  # type: ignore[arg-type]

    def run(self, seconds: float, *, has_frame: bool = True, every_s: float = 0.05) -> None:
        record, frame = self.cycle
        for _ in range(round(seconds / every_s)):
            self.clock.sleep_until_s(self.clock.now_s() + every_s)
            self.service(record, frame if has_frame else None)


@pytest.fixture
def seen(cycles: list[tuple[CycleRecord, Frame | None]]) -> tuple[CycleRecord, Frame | None]:
    return cycles[-1]


@pytest.mark.parametrize("system", ["a path", "an abstract name"], indirect=True)
def test_it_is_ready_with_the_first_cycle_and_not_before(system, seen):
    rig = Rig(system, seen, watchdog_s=2.0)
    assert system.heard() == []
    rig.run(0.05)
    assert system.heard() == ["READY=1", "WATCHDOG_USEC=2000000", "WATCHDOG=1", "STATUS=ball 2.00 m"]
    rig.run(0.05)
    assert system.heard() == []


def test_the_watchdog_is_fed_by_cycles_four_times_a_period_and_by_nothing_else(system, seen):
    rig = Rig(system, seen, watchdog_s=2.0)
    rig.run(4.0)
    assert 7 <= system.heard().count("WATCHDOG=1") <= 9
    rig.clock.sleep_until_s(60.0)  # the loop hangs
    assert system.heard() == []


def test_the_status_is_told_once_a_second_at_most_and_only_when_it_changes(system, seen):
    rig = Rig(system, seen)
    rig.run(10.0)
    status = [line for line in system.heard() if line.startswith("STATUS=")]
    assert status == ["STATUS=ball 2.00 m", "STATUS=ball 2.00 m, 20 fps"]
    rig.service.trouble = lambda: "the broker\nWATCHDOG=1 is away"
    rig.run(1.1)
    assert system.heard() == ["STATUS=ball 2.00 m, 20 fps; the broker WATCHDOG=1 is away"]


def test_what_systemd_was_too_busy_to_take_is_sent_again(system, seen):
    other = NotifySocket(system.address)
    while other.send("STATUS=from another"):
        pass
    rig = Rig(system, seen)
    rig.run(0.05)
    assert "READY=1" not in system.heard()
    rig.run(0.05)
    assert "READY=1" in system.heard()


def test_a_camera_without_pictures_feeds_the_watchdog_until_only_a_new_process_can_help(system, seen):
    rig = Rig(system, seen, watchdog_s=2.0)
    rig.run(1.0)
    rig.service.trouble = lambda: "there is no camera"
    heard = system.heard()
    for _ in range(int(patience_s(0, is_hung=False)) - 1):
        rig.run(1.0, has_frame=False, every_s=0.2)
        heard += system.heard()
    assert heard.count("WATCHDOG=1") > patience_s(0, is_hung=False)
    with pytest.raises(CaptureTimeoutError, match=r"no new picture for 300 s \(there is no camera\).*after 600 s"):
        rig.run(3.0, has_frame=False)


def test_a_driver_that_hangs_is_given_less_time(system, seen):
    rig = Rig(system, seen, hung=lambda: "libcamera hangs")
    rig.run(patience_s(0, is_hung=True) - 1.0, has_frame=False)
    with pytest.raises(CaptureTimeoutError, match="libcamera hangs"):
        rig.run(3.0, has_frame=False)


@each_case(
    ("failed", "pause", "hung_s", "silent_s"),
    [
        (0, 0, 30, 300),
        (1, 0, 60, 600),
        (2, 1, 120, 1200),
        (3, 2, 240, 2400),
        (7, 30, 3600, 3600),
        (999, 30, 3600, 3600),
    ],
)
def test_waits_grow_with_each_start_in_a_row(failed, pause, hung_s, silent_s):
    waits = (pause_s(failed), patience_s(failed, is_hung=True), patience_s(failed, is_hung=False))
    assert waits == (pause, hung_s, silent_s)


class TestCameraWait:
    def test_a_while_of_pictures_makes_the_next_restart_the_first_again(self):
        wait = CameraWait(failed=5)
        now_s = 0.0
        while now_s < PROVEN_S + 1:
            assert not wait.is_over(now_s, has_frame=True)
            now_s += 1.0
        assert wait.is_proven(now_s)
        assert wait.is_over(now_s + patience_s(0, is_hung=False) + 1, has_frame=False)

    def test_pictures_with_gaps_prove_nothing(self):
        wait = CameraWait(failed=5)
        for now_s in range(0, int(2 * PROVEN_S), 5):
            assert not wait.is_over(now_s, has_frame=True)
        assert not wait.is_proven(2 * PROVEN_S)
        assert not wait.is_over(2 * PROVEN_S + MAX_PATIENCE_S - 10, has_frame=False)

    def test_one_that_never_gave_a_picture_is_waited_for_from_the_first_cycle_on(self):
        wait = CameraWait(failed=0)
        assert not wait.is_over(1000.0, has_frame=False)
        assert not wait.is_over(1299.0, has_frame=False)
        assert wait.is_over(1301.0, has_frame=False)


class TestFailedStarts:
    @pytest.fixture
    def configuration(self, tmp_path: Path) -> Path:
        path = tmp_path / "run.toml"
        path.write_text("# first")
        return path

    def test_each_start_counts_until_one_was_good(self, tmp_path, configuration):
        assert [FailedStarts(tmp_path, configuration).begin() for _ in range(3)] == [0, 1, 2]
        FailedStarts(tmp_path, configuration).forget()
        assert FailedStarts(tmp_path, configuration).begin() == 0

    def test_a_configuration_that_was_edited_begins_anew(self, tmp_path, configuration):
        assert [FailedStarts(tmp_path, configuration).begin() for _ in range(3)] == [0, 1, 2]
        os.utime(configuration, (1, 1))
        assert FailedStarts(tmp_path, configuration).begin() == 0

    @pytest.mark.parametrize("text", ["", "x", "1", "1 2 3", "9 \0"])
    def test_a_damaged_count_is_none(self, tmp_path, configuration, text):
        (tmp_path / "failed-starts").write_text(text)
        assert FailedStarts(tmp_path, configuration).begin() == 0

    def test_a_good_start_is_forgotten_while_it_runs(self, system, seen, tmp_path, configuration):
        starts = FailedStarts(tmp_path, configuration)
        starts.begin()
        rig = Rig(system, seen, starts=starts)
        rig.run(PROVEN_S - 1, every_s=0.5)
        assert FailedStarts(tmp_path, configuration).begin() == 2
        rig.run(2, every_s=0.5)
        assert FailedStarts(tmp_path, configuration).begin() == 0


def test_it_waits_before_it_opens_anything_and_says_so(system, tmp_path):
    environ = {"NOTIFY_SOCKET": system.address, "RUNTIME_DIRECTORY": str(tmp_path)}
    slept: list[float] = []
    for _ in range(5):
        service(tmp_path / "run.toml", environ).pause(slept.append)
    assert slept == [1.0, 2.0, 4.0]
    assert system.heard()[-1] == "STATUS=4 starts in a row failed: waiting 4 s"


def test_a_watchdog_that_is_meant_for_another_process_is_not_fed(system, seen):
    environ = {"NOTIFY_SOCKET": system.address, "WATCHDOG_USEC": "2000000"}
    for process, is_fed in ((str(os.getpid()), True), ("1", False), ("", True)):
        service(Path("run.toml"), {**environ, "WATCHDOG_PID": process})(*seen)
        assert ("WATCHDOG=1" in system.heard()) is is_fed
