"""What ends a command: a good end, a line on standard error, or a defect."""

import errno
import os
import sys
import threading
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import typer

from stadimeter.cli.exits import DONE, WRONG, plain_errors
from stadimeter.cli.run import _telling_of_threads


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
