"""What every command does with its streams, its configuration and its end."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import IO

import cv2
import numpy as np
import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from stadimeter.app.bootstrap import demo_configuration
from stadimeter.cli import exits
from stadimeter.cli.check import print_problems
from stadimeter.cli.exits import DONE, WRONG, plain_errors
from stadimeter.cli.main import app
from stadimeter.cli.run import _telling_of_threads
from stadimeter.config.findings import Finding, problems
from stadimeter.config.toml_lines import key_spans

# What ends a command: a good end, a line on standard error, or a defect.


def end_of(error):
    with pytest.raises((Exception, SystemExit)) as found, plain_errors():
        raise error
    return found.value


@pytest.mark.parametrize("number", [errno.EIO, errno.EPIPE])
def test_an_error_as_of_a_pipe_is_a_defect_while_somebody_reads(number):
    error = OSError(number, "the bus")
    end = end_of(error)
    assert isinstance(end, RuntimeError)
    assert end.__cause__ is error


@pytest.mark.parametrize("number", [errno.EIO, errno.EPIPE])
@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_it_is_a_good_end_when_the_reader_is_gone(monkeypatch, stream, number):
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "wb") as gone:
        monkeypatch.setattr(sys, stream, gone)
        monkeypatch.setattr(sys, "stdout", sys.stdout)  # put back after the test
        end = end_of(OSError(number, "gone"))
        sys.stdout.close()
    assert isinstance(end, typer.Exit)
    assert end.exit_code == DONE


def test_it_is_a_good_end_when_rich_finds_the_reader_gone():
    """It raises SystemExit in place of the error of the pipe, as `stadimeter doctor | head` shows."""
    script = "from rich.console import Console; from stadimeter.cli.exits import plain_errors\n"
    script += "with plain_errors():\n    for line in range(99999): Console().print(line)"
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "wb") as gone:
        done = subprocess.run(
            [sys.executable, "-c", script], stdout=gone, stderr=subprocess.PIPE, text=True, check=False
        )
    assert "asked for the end of the program" not in done.stderr
    assert done.stderr.splitlines()[-1].endswith("Exit: 0"), "what the command line ends quietly with"


def failed_allocation():
    try:
        cv2.resize(np.zeros((1, 1), np.uint8), (2**30, 2**30))
    except cv2.error as error:
        error.code = -4  # whichever OpenCV it is: that a size is too large has another code in some
        return error


@pytest.mark.parametrize(
    "error",
    [MemoryError(), OSError(errno.ENOMEM, "fork"), RuntimeError("can't start new thread"), failed_allocation()],
    ids=["python", "system", "thread", "opencv"],
)
def test_running_out_of_memory_is_a_line_however_it_is_said(capsys, error):
    end = end_of(error)
    assert isinstance(end, typer.Exit)
    assert end.exit_code == WRONG
    (line,) = capsys.readouterr().err.splitlines()
    assert "no more memory" in line


def test_a_library_that_asks_for_the_end_of_the_program_is_a_defect():
    error = SystemExit(0)
    end = end_of(error)
    assert isinstance(end, RuntimeError)
    assert end.__cause__ is error


def test_every_other_error_stays_what_it_is():
    error = OSError(errno.EACCES, "no")
    assert end_of(error) is error


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("error", [SystemExit(0), ZeroDivisionError("a defect")])
def test_a_thread_that_ends_by_an_error_during_a_run_is_reported(error):
    said = []
    loop = SimpleNamespace(services=SimpleNamespace(tell=said.append))
    before = threading.excepthook

    def fail():
        raise error

    with _telling_of_threads(loop):
        thread = threading.Thread(target=fail, name="mqtt")
        thread.start()
        thread.join()
    assert said == [f"warning: the thread 'mqtt' has ended: {type(error).__name__}: {error}"]
    assert threading.excepthook is before


# Standard streams that are closed, or go to a disk that is full, cost a line and never a traceback.

START = f'exec "{sys.executable}" -m stadimeter'


def run(command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["sh", "-c", f"{START} {command}"], capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize("closed", ["<&-", ">&-", "<&- >&- 2>&-"])
def test_a_stream_that_is_closed_is_as_one_to_nowhere(closed: str) -> None:
    done = run(f"--version {closed}")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("stadimeter ") == (">&-" not in closed)


def test_questions_without_a_standard_input_are_refused_as_those_without_a_terminal() -> None:
    done = run("init x.toml <&-")
    assert done.returncode == 2
    assert done.stderr.startswith("error: init asks questions, and there is no terminal here")


def test_what_is_typed_and_is_no_text_is_refused_in_a_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "stadimeter", "web", str(tmp_path / "r.toml"), "--set-password"]
    env = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}  # as with the languages of most people
    done = subprocess.run(command, input=b"b\xe4d\n" * 2, capture_output=True, check=False, timeout=120, env=env)
    assert done.returncode == 2
    assert done.stderr.decode().splitlines()[-1] == "error: a password has 8 to 500 characters"


@pytest.mark.parametrize("command", ["--version", "help", "check none.toml --json"])
def test_a_disk_that_is_full_is_said_in_a_line(command: str) -> None:
    done = run(f"{command} >/dev/full")
    assert done.returncode == 2
    assert done.stderr == "error: what is printed cannot be written: no space left on device\n"
    assert run(f"{command} >/dev/full 2>&1").returncode == 2


def test_what_is_opened_first_does_not_become_standard_output() -> None:
    code = (
        "from stadimeter.__main__ import open_standard_streams as o; o(); import os; os._exit(os.open('/dev/null', 0))"
    )
    done = subprocess.run(["sh", "-c", f'exec "{sys.executable}" -c "{code}" <&- >&- 2>&-'], check=False)
    assert done.returncode > 2


# Long work says that it goes on: a moving line in a terminal, one line elsewhere, nothing for what is done at once.


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exits, "FIRST_AFTER_S", 0.0)
    monkeypatch.delenv(exits.SWITCH)


@pytest.fixture
def ends() -> Iterator[list[int]]:
    kept: list[int] = []
    yield kept
    for each in kept:
        os.close(each)


def shown_while_working(monkeypatch: pytest.MonkeyPatch, reading: int, writing: IO[str]) -> str:
    """Return what comes first at the other end of standard error."""
    monkeypatch.setattr(sys, "stderr", writing)
    with exits.working("counting sheep"):
        return os.read(reading, 4096).decode() + (os.read(reading, 4096).decode() if writing.isatty() else "")


@pytest.mark.usefixtures("at_once")
def test_in_a_terminal_a_moving_line_says_so(monkeypatch: pytest.MonkeyPatch, ends: list[int]) -> None:
    monkeypatch.setenv("TERM", "xterm")
    reading, writing = os.openpty()
    ends.append(reading)
    with os.fdopen(writing, "w", buffering=1) as stream:
        assert "counting sheep" in shown_while_working(monkeypatch, reading, stream)


def test_what_is_done_at_once_is_not_announced(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(exits.count_items("abc", "counting", 3)) == ["a", "b", "c"]
    assert capsys.readouterr() == ("", "")


# The line that a problem is about is shown, and no secret with it.


def shown(tmp_path: Path, text: str, key: str, line: int) -> str:
    file = tmp_path / "run.toml"
    file.write_text(text)
    console = Console(width=120)
    with console.capture() as capture:
        found = problems([Finding(tuple(key.split(".")), "it is wrong")], str(file), key_spans(text))
        assert [each.line for each in found] == [line]
        print_problems(console, found, "error")
    return capture.get()


def test_an_address_is_covered_and_the_rest_of_its_line_is_not(tmp_path: Path) -> None:
    text = '[notifiers]\nphone = { driver = "apprise", url = "tgram://123:token/4", url_file = 1 }\n'
    said = shown(tmp_path, text, "notifiers.phone.url_file", 2)
    line, underline = said.splitlines()[-2:]
    assert "token" not in said
    assert f'url = "tgram://{"…" * len("123:token/4")}", url_file = 1' in line
    assert line.index("url_file") == underline.index("^")


# Without CONFIG, a command takes the configuration that is in this folder, and says so.

COMMANDS = (("check",), ("test",), ("run", "--frames", "2", "--speed", "0"))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_without_a_name_the_configuration_in_this_folder_is_used_and_named(
    command: tuple[str, ...], folder: Path
) -> None:
    shutil.copy(demo_configuration().path, folder / "stadimeter.toml")
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0
    assert result.stderr.splitlines()[0] == "using stadimeter.toml"


def test_without_a_configuration_it_says_what_makes_one() -> None:
    for command in [*COMMANDS, ("wiring",)]:
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 2
        assert "there is no stadimeter.toml in this folder. `stadimeter init` writes one" in result.stderr
