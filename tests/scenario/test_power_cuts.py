"""A save that is cut at any of its system calls leaves what was there before or after one of its steps."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from itertools import groupby, pairwise
from pathlib import Path

import pytest

from support.cuts import Call, Savers, needs_strace
from support.saves import MEMORIES, SAVINGS, Saving

pytestmark = [needs_strace(), pytest.mark.timeout(600)]

ATOMIC = [name for name in SAVINGS if not {"state", "journal", "recording", "log"} & set(name.split())]


@pytest.fixture(scope="module")
def savers() -> Iterator[Savers]:
    with Savers() as savers:
        yield savers


def found(saving: Saving, folder: Path) -> object:
    """Return what the program reads there, from a copy: reading may mend things."""
    copy = folder.with_name(f"{folder.name}-read")
    shutil.copytree(folder, copy, symlinks=True)
    try:
        return saving.read(copy)
    finally:
        shutil.rmtree(copy)


def prepared(saving: Saving, folder: Path) -> Path:
    folder.mkdir()
    saving.prepare(folder)
    return folder


def apart(calls: list[Call]) -> list[Call]:
    """Leave out calls between others like them: a cut in a hundred writes to one log does what one in six does."""
    runs = (list(run) for _, run in groupby(calls, key=lambda call: (call.name, call.files)))
    return [call for run in runs for call in (run[:3] + run[max(3, len(run) - 3) :])]


@pytest.mark.long
@pytest.mark.parametrize("name", SAVINGS)
def test_a_save_that_is_cut_anywhere_leaves_what_a_step_before_or_after_had_left(
    savers: Savers, name: str, tmp_path: Path
) -> None:
    saving = SAVINGS[name]
    folder = prepared(saving, tmp_path / "whole")
    steps = [found(saving, folder)]
    steps += [found(saving, folder) for _ in saving.save(folder)]
    calls = apart(savers.calls_of(name, prepared(saving, tmp_path / "traced")))
    reached = []
    for number, call in enumerate(calls):
        folder = prepared(saving, tmp_path / str(number))
        savers.cut(name, folder, call)
        reached.append(steps.index(found(saving, folder)))
        shutil.rmtree(folder)
    print(f"{len(calls)} cuts of {name}")
    assert reached == sorted(reached), "what a step has saved is lost by no later one"
    assert steps[reached[-1]] == steps[-1], "and every step was cut"


@pytest.mark.long
@pytest.mark.parametrize("name", ATOMIC)
def test_bytes_are_on_the_disk_before_they_get_their_name_and_the_name_before_the_save_is_done(
    savers: Savers, name: str, tmp_path: Path
) -> None:
    """A cut of the power loses what was not flushed, in any order, unlike the end of the program alone."""
    calls = savers.calls_of(name, prepared(SAVINGS[name], tmp_path / "traced"))
    renames = [number for number, call in enumerate(calls) if call.name == "rename"]
    assert renames
    for begin, end in pairwise([*renames, len(calls)]):
        temporary, file = calls[begin].files
        before = [call.name for call in calls[:begin] if call.files == (temporary,) and call.name != "close"]
        assert before[-2:] == ["write", "fsync"]
        assert "fsync" in [call.name for call in calls[begin:end] if call.files == (file.parent,)]


def test_what_alarms_remember_is_on_the_disk_when_it_was_flushed(savers: Savers, tmp_path: Path) -> None:
    calls = savers.calls_of("a new state file", prepared(SAVINGS["a new state file"], tmp_path / "traced"))
    log = tmp_path / "traced" / "state" / "run.sqlite3-wal"
    about_log = [call.name for call in calls if (call.files == (log,) and "write" in call.name) or "sync" in call.name]
    runs = [name for name, _ in groupby(about_log)]
    assert runs.count("fsync") >= len(MEMORIES), "each flush is one of the log"
    assert runs[-1] != "pwrite64"
    made = next(number for number, call in enumerate(calls) if call.files == (log,))
    assert "fdatasync" in [call.name for call in calls[made:] if call.files == (log.parent,)], "its name is there, too"
