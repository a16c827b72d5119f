"""Cuts: a save that is killed at each of its system calls in turn, as a power cut or the kernel's OOM killer would.

`strace` does the killing. It counts each system call by its name, so the calls of a whole save are listed first. Each
save runs in a process of its own, forked from one that has imported everything.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest
from msgspec import Struct

from support.programs import needs, path_of
from support.saves import SAVINGS

TRACED = (
    "openat,write,writev,pwrite64,pwritev,fsync,fdatasync,ftruncate,fallocate,fchmod,fchown,flock,close,link,linkat,"
    "mkdir,mkdirat,rename,renameat,renameat2,unlink,unlinkat,utimensat"
)
"""What a save does to a disk. Between two of these calls, nothing on the disk changes."""

_LINE = re.compile(r"^\d+ +(?P<name>\w+)\((?P<arguments>.*)\) += (?P<result>-?\d+)")
_QUOTED = re.compile(r'"([^"]*)"')
_OPEN_FILE = re.compile(r"^\d+<([^>]*)>")


class Call(Struct, frozen=True):
    """A system call: its name, how often it had been made by then, and the files that it was about."""

    name: str
    nth: int
    files: tuple[Path, ...]


def needs_strace() -> pytest.MarkDecorator:
    """Skip a test where there is no strace, or where it may trace nothing."""
    if path_of("strace") is None:
        return needs("strace")
    traced = subprocess.run(["strace", "-qq", "true"], capture_output=True, check=False)
    return pytest.mark.skipif(traced.returncode != 0, reason="strace may not trace here")


class Savers:
    """Runs the saves of `SAVINGS`, each in a process of its own. A context manager."""

    def __enter__(self) -> Self:
        command = [sys.executable, "-m", __name__]
        self._server = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._server.communicate()

    def calls_of(self, name: str, folder: Path) -> list[Call]:
        """Save, and return the system calls about files in the folder that this took."""
        log = folder.with_name(f"{folder.name}.strace")
        assert self._run(name, folder, "-o", str(log)) == 0
        counts: Counter[str] = Counter()
        calls = []
        for line in log.read_text().splitlines():
            if (found := _LINE.match(line)) is None:
                continue
            call, arguments = found["name"], found["arguments"]
            counts[call] += 1
            opened = _OPEN_FILE.match(arguments)
            files = tuple(map(Path, [opened[1]] if opened else _QUOTED.findall(arguments)))
            if any(file.is_relative_to(folder) for file in files):
                calls.append(Call(call, counts[call], files))
        return calls

    def cut(self, name: str, folder: Path, call: Call) -> None:
        """Save, and be killed right before a system call."""
        code = self._run(name, folder, "-o", os.devnull, "-e", f"inject={call.name}:signal=SIGKILL:when={call.nth}")
        assert code == -signal.SIGKILL, f"{call} was not made this time"

    def _run(self, name: str, folder: Path, *options: str) -> int:
        to_server, from_server = self._server.stdin, self._server.stdout
        assert to_server is not None
        assert from_server is not None
        print(json.dumps([name, str(folder)]), file=to_server, flush=True)
        process = int(from_server.readline())
        command = ["strace", "-f", "-y", "-s", "256", "-e", f"trace={TRACED}", *options, "-p", str(process)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as strace:
            assert strace.stderr is not None
            line = strace.stderr.readline()
            assert "attached" in line, line
            print(file=to_server, flush=True)
            strace.stderr.read()
        return int(from_server.readline())


def _serve() -> None:
    while request := os.read(0, 4096):
        if (child := os.fork()) == 0:
            _save(*json.loads(request))
        _, status = os.waitpid(child, 0)
        os.write(1, b"%d\n" % os.waitstatus_to_exitcode(status))


def _save(name: str, folder: str) -> None:
    os.write(1, b"%d\n" % os.getpid())
    os.read(0, 1)
    try:
        for _step in SAVINGS[name].save(Path(folder)):
            pass
        os._exit(0)
    finally:
        os._exit(1)


if __name__ == "__main__":
    _serve()
