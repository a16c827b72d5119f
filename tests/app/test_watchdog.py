"""What a run tells its watchdog process, and what becomes of its outputs when that is gone."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator

import pytest

from stadimeter.app import watchdog
from stadimeter.app.guard import LeasedOutput
from stadimeter.app.watchdog import WatchdogLink
from stadimeter.core.command import LevelCommand
from stadimeter.errors import DriverError
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from stadimeter.testing.rig import ManualClock, eventually
from stadimeter.watchdog.__main__ import RunWatch
from support.recording_doubles import RecordingActuator

SAFE = LevelCommand(output="motor", level=0.0)
RELEASE = OperatorCommand(id="1", action=OperatorAction.RELEASE_OUTPUTS, by="zoe")


class Run:
    """An output with its link; `told` is what was written to the watchdog process."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = ManualClock(start_s=128.0)
        self.output = LeasedOutput(RecordingActuator(self.clock, "motor"), SAFE, lease_s=0.25, clock=self.clock)
        self.output.open()
        self.link = WatchdogLink([], [self.output], 1.0, self.clock.now_s, lambda _words: None)
        self.told: list[str] = []
        write = self.link._write

        def remember(words: str) -> None:
            self.told.append(words)
            write(words)

        monkeypatch.setattr(self.link, "_write", remember)

    def act(self) -> None:
        self.output.apply(LevelCommand(output="motor", level=1.0, captured_at_s=self.clock.now_s()))

    @property
    def last(self) -> list[str]:
        """The words of the newest line, without its number and times of this computer's clock."""
        words = self.told[-1].split() if self.told else []
        return [words[0], *words[3:]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Iterator[Run]:
    run = Run(monkeypatch)
    yield run
    run.link.close(is_safe=True)


def test_a_cycle_tells_how_old_the_data_is_that_an_output_acts_on(run):
    run.link.note_cycle()
    assert run.told == []
    run.act()
    run.clock.advance_s(0.125)
    run.link.note_cycle()
    assert run.last == ["acts", "0.125"]


def test_a_lease_that_runs_out_tells_that_the_output_rests_and_nothing_but_a_cycle_that_it_acts(run):
    run.act()
    run.link.note_cycle()
    run.clock.advance_s(0.5)
    run.output.check(run.clock.now_s())
    assert run.last == ["rests"]
    run.output.check(run.clock.now_s())
    run.act()
    assert len(run.told) == 2


def test_a_command_that_ends_the_motion_tells_so_before_its_cycle_is_over(run):
    run.act()
    run.link.note_cycle()
    run.output.apply(SAFE)
    assert run.last == ["rests"]


@pytest.fixture
def heard(run: Run, monkeypatch: pytest.MonkeyPatch) -> Iterator[RunWatch]:
    """What the watchdog process makes of what is written, in the order in which it arrives."""
    watch = RunWatch(os.getpid(), answers=os.open(os.devnull, os.O_WRONLY))
    watch._take("limit 0.95")
    monkeypatch.setattr(run.link, "_write", lambda words: watch._take(words.rstrip()))
    yield watch
    os.close(watch._process)
    os.close(watch._answers)


def delay(run: Run, monkeypatch: pytest.MonkeyPatch, word: str, meanwhile: Callable[[], None]) -> None:
    """Let something happen between the look at the outputs that the next such report is made of, and its writing."""
    write = run.link._write

    def write_late(words: str) -> None:
        if words.startswith(word):
            monkeypatch.setattr(run.link, "_write", write)
            meanwhile()
        write(words)

    monkeypatch.setattr(run.link, "_write", write_late)


def test_an_output_whose_lease_ends_while_a_cycle_reports_it_is_known_to_rest(run, heard, monkeypatch):
    def end_lease() -> None:
        run.clock.advance_s(0.4)
        run.output.check(run.clock.now_s())

    run.act()
    delay(run, monkeypatch, "acts", end_lease)
    run.link.note_cycle()
    assert run.output.acts_since_s() is None
    assert heard._due_s is None, "it would be killed, and nothing would tell again that its outputs rest"


def test_an_output_that_acts_again_while_its_rest_is_reported_is_watched(run, heard, monkeypatch):
    def act_again() -> None:
        run.act()
        run.link.note_cycle()

    run.act()
    run.link.note_cycle()
    run.clock.advance_s(0.4)
    delay(run, monkeypatch, "rests", act_again)
    run.output.check(run.clock.now_s())
    assert run.output.acts_since_s() is not None
    assert heard._due_s is not None


def test_a_signal_that_stops_the_outputs_within_a_cycle_s_report_leaves_them_known_to_rest(run, heard, monkeypatch):
    run.act()
    delay(run, monkeypatch, "acts", run.output.make_safe)
    run.link.note_cycle()
    assert heard._due_s is None


def test_every_answer_is_counted_though_another_thread_reads_them(run):
    run.link.start()
    for _ in range(300):
        run.act()
        run.link.note_cycle()
    assert eventually(lambda: run.link._answered == 300)


@pytest.mark.parametrize("stop", ["make_safe", "retire"])
def test_a_stop_from_outside_the_loop_tells_that_the_output_rests(run, stop):
    run.act()
    run.link.note_cycle()
    getattr(run.output, stop)()
    assert run.last == ["rests"]


def test_when_the_process_is_gone_nothing_moves_until_a_release_has_started_a_new_one(run):
    run.link.start()
    run.act()
    first = run.link.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    assert eventually(lambda: run.output.acts_since_s() is None)
    run.act()
    assert run.output.acts_since_s() is None
    (stop,) = run.link.with_stop(())
    assert isinstance(stop, OperatorCommand)
    assert (stop.action, stop.said) == (OperatorAction.STOP_OUTPUTS, "by the watchdog: the watchdog process has ended")
    assert run.link.with_stop(()) == ()
    assert run.link.with_stop((RELEASE,)) == (RELEASE,)
    assert run.link.pid not in {first, None}
    run.act()
    assert run.output.acts_since_s() is not None


def test_a_release_that_can_start_none_is_followed_by_another_stop(run, monkeypatch):
    run.link.start()
    os.kill(run.link.pid or 0, signal.SIGKILL)
    assert eventually(lambda: run.output.is_held)
    assert len(run.link.with_stop(())) == 1
    monkeypatch.setattr(watchdog.sys, "executable", "/nowhere/python")
    _, stop = run.link.with_stop((RELEASE,))
    assert "cannot be started: No such file or directory" in stop.said
    assert run.output.is_held


def test_a_process_that_answers_nothing_is_as_good_as_gone(run, monkeypatch):
    run.link.start()
    os.kill(run.link.pid or 0, signal.SIGSTOP)
    monkeypatch.setattr(watchdog, "ANSWERS_WITHIN_S", 0.05)

    def is_lost() -> bool:
        run.act()
        run.link.note_cycle()
        return bool(run.link.lost)

    assert eventually(is_lost)
    assert "has not answered" in run.link.lost
    assert run.output.acts_since_s() is None


def test_a_run_does_not_begin_without_it(run, monkeypatch, tmp_path):
    program = tmp_path / "silent.py"
    program.write_text("")
    monkeypatch.setattr(watchdog, "PROGRAM", str(program))
    with pytest.raises(DriverError, match="does not answer"):
        run.link.start()


def test_an_output_that_was_not_stopped_is_left_to_the_process(run, monkeypatch):
    monkeypatch.setattr(watchdog, "ENDS_WITHIN_S", 60.0)  # else one that a busy machine lets end late is killed
    run.link.start()
    run.link.close(is_safe=False)
    assert run.link._process is not None
    assert run.link._process.poll() is None
    run.link.close(is_safe=True)
    assert run.link._process.poll() == 0
