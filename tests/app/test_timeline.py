"""The timeline of a run, on a clock that is stepped, in real files."""

from __future__ import annotations

import errno
import math
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.app import timeline
from stadimeter.app.timeline import (
    CYCLES_MAX,
    HIGH,
    LOW,
    MEAN,
    SEEN,
    STATES,
    Names,
    TimelineKeeper,
    merge_rows,
    read_rows,
)
from stadimeter.core.decision import RuleStatus, RuleTrace
from stadimeter.core.measurement import Track, TrackStatus

NOON_S = 1_782_907_200
"""2026-07-01 12:00 UTC."""

DAY_S = 86400


class Rig:
    """A timeline whose clock we hold. The thread that writes is played by `write`."""

    def __init__(self, folder: Path, keep_s: float = 7 * DAY_S) -> None:
        self.folder = folder
        self.now_s = float(NOON_S)
        self.keeper = TimelineKeeper(folder, keep_s, lambda: self.now_s)

    def see(
        self, distance_m: float | None, status: RuleStatus = RuleStatus.IDLE, for_s: float = 0.5, **also: float
    ) -> None:
        tracks = [
            Track(
                target=name,
                status=TrackStatus.TRACKING if metres is not None else TrackStatus.LOST,
                distance_m=metres,
                sigma_m=0.02,
            )
            for name, metres in {"ball": distance_m, **also}.items()
        ]
        decision = SimpleNamespace(tracks=tuple(tracks), rules=(RuleTrace(rule="near", status=status),))
        observation = SimpleNamespace(now_s=self.now_s)
        self.keeper(SimpleNamespace(decision=decision, observation=observation))  # type: ignore[arg-type]
        self.now_s += for_s

    def read(self, step_s: int = 1, from_s: float = 0, to_s: float = 2**32) -> list[tuple[Names, np.ndarray]]:
        return list(read_rows(self.folder, from_s, to_s, step_s))

    def rows(self, step_s: int = 1, from_s: float = 0, to_s: float = 2**32) -> np.ndarray:
        ((_, rows),) = self.read(step_s, from_s, to_s)
        return rows


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path / "timeline" / "room")


def test_a_second_keeps_mean_extremes_and_the_state_that_matters_most(rig):
    rig.see(1.0, for_s=0.25)
    rig.see(0.4, RuleStatus.ACTIVE, for_s=0.25)
    rig.see(1.6, for_s=0.25)
    rig.see(None, for_s=0.25)
    rig.keeper.close()
    (row,) = rig.rows()
    assert row["unix_s"] == NOON_S
    assert row["figures"][0] == pytest.approx([1.0, 0.02, 0.4, 1.6, 0.75])
    assert STATES[row["states"][0]] == RuleStatus.ACTIVE


def test_the_loop_writes_nothing_and_the_thread_once_a_minute(rig, monkeypatch):
    writes: list[str] = []
    append = timeline.append_whole

    def note(path: Path, data: bytes, *, is_lasting: bool) -> None:
        writes.append(path.suffix)
        append(path, data, is_lasting=is_lasting)

    monkeypatch.setattr(timeline, "append_whole", note)
    rig.see(1.0)
    assert not rig.folder.exists()
    for number in range(1199):
        rig.see(1.0 + number)
        rig.keeper.step()
    assert writes == [".1"] * 10
    for number in range(120):
        rig.see(1.0 + number)
        rig.keeper.step()
    assert writes == [".1"] * 11


def test_a_day_of_a_target_and_three_rules_takes_three_megabytes():
    assert Names(("ball",), ("near", "close", "gone")).row.itemsize * DAY_S == pytest.approx(3.0e6, rel=0.05)


def test_a_night_is_read_in_steps_of_any_length_and_a_glimpse_of_a_second_is_in_all(rig):
    for second in range(4000):
        rig.see(0.3 if second == 2000 else 2.0, RuleStatus.ACTIVE if second == 2000 else RuleStatus.IDLE, for_s=1.0)
        rig.keeper.step()
    rig.keeper.finish()
    for step_s in (1, 60, 10, 30, 600, 3600):
        rows = rig.rows(step_s)
        assert len(rows) == math.ceil(4000 / step_s)
        assert rows["figures"][:, 0, LOW].min() == pytest.approx(0.3), step_s
        assert (rows["states"] == STATES.index(RuleStatus.ACTIVE)).sum() == 1, step_s
        assert (np.diff(rows["unix_s"].astype(int)) == step_s).all()
    assert len(rig.rows(60, NOON_S + 600, NOON_S + 1200)) == 10


def test_a_run_that_was_killed_lacks_a_minute_and_nothing_before_it(rig):
    for _ in range(1000):
        rig.see(2.0, for_s=1.0)
        rig.keeper.step()
    assert 1000 - 60 <= len(rig.rows(1)) < 1000
    assert rig.rows(60)["unix_s"][-1] == rig.rows(1)["unix_s"][-1] // 60 * 60


@given(cut=st.integers(0, 400))
def test_a_file_that_a_power_cut_shortened_is_read_up_to_there(tmp_path_factory, cut):
    rig = Rig(tmp_path_factory.mktemp("cut"))
    for number in range(10):
        rig.see(1.0 + number, for_s=1.0)
    rig.keeper.close()
    (file,) = rig.folder.glob("*.1")
    data = file.read_bytes()
    file.write_bytes(data[:cut])
    head, row = len(Names(("ball",), ("near",)).head), Names(("ball",), ("near",)).row.itemsize
    expected = max(0, min(10, (cut - head) // row))
    found = rig.read()
    assert sum(len(rows) for _, rows in found) == expected
    assert all((rows["figures"][:, 0, MEAN] == np.arange(1, 1 + expected)).all() for _, rows in found)


@pytest.mark.parametrize("jump_s", [-3600.0, 0.0, DAY_S])
def test_another_target_a_new_day_or_a_clock_that_is_set_back_begins_a_segment(rig, jump_s):
    rig.see(1.0, for_s=1.0)
    rig.now_s += jump_s
    if not jump_s:
        rig.keeper.note_reload(0.0, None)  # type: ignore[arg-type]
        rig.see(1.0, for_s=1.0, box=3.0)
    else:
        rig.see(1.0, for_s=1.0)
    rig.keeper.close()
    assert len(list(rig.folder.glob("*.1"))) == 2
    assert [len(rows) for _, rows in rig.read()] == [1, 1]


def test_a_full_disk_is_said_and_what_it_did_not_take_is_written_later(rig, monkeypatch):
    append = timeline.append_whole

    def refuse(path: Path, _data: bytes, **_: bool) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", path)

    monkeypatch.setattr(timeline, "append_whole", refuse)
    for _ in range(100):
        rig.see(1.0, for_s=1.0)
        rig.keeper.step()
    assert "No space left" in rig.keeper.trouble()
    monkeypatch.setattr(timeline, "append_whole", append)
    rig.keeper.close()
    assert rig.keeper.trouble() == ""
    assert len(rig.rows()) == 100


def test_a_disk_that_hangs_costs_the_oldest_and_not_the_memory(rig):
    for _ in range(CYCLES_MAX + 100):
        rig.see(1.0, for_s=1.0)
    rig.keeper.close()
    assert list(rig.rows()["unix_s"]) == list(range(NOON_S + 100, NOON_S + 100 + CYCLES_MAX))


def test_what_is_too_old_goes_when_a_segment_begins(rig):
    rig.see(1.0, for_s=1.0)
    rig.keeper.close()
    for file in rig.folder.iterdir():
        os.utime(file, (0, 0))
    later = Rig(rig.folder)
    later.now_s += 5.0
    later.see(2.0, for_s=1.0)
    later.keeper.close()
    assert later.rows()["figures"][0, 0, MEAN] == 2.0


def test_a_file_of_something_else_is_passed_over(rig):
    rig.see(1.0, for_s=1.0)
    rig.keeper.close()
    (rig.folder / "mine.1").write_text("no timeline\n")
    (rig.folder / "folder.1").mkdir()
    (rig.folder / "byte.1").write_bytes(Names(("x",), ()).head.replace(b"x", b"\xff"))
    (rig.folder / "odd.1").write_bytes(Names(("x",) * 3, ()).head + b"half a row")
    assert len(rig.read()) == 1


SECONDS = st.tuples(
    st.integers(1, 50), st.one_of(st.none(), st.floats(0.125, 50.0, width=32)), st.integers(1, len(STATES) - 1)
)


@given(seconds=st.lists(SECONDS, min_size=1, max_size=80))
def test_merging_loses_no_extreme_and_no_state_and_keeps_means_between(seconds):
    rows = np.zeros(len(seconds), Names(("ball",), ("near",)).row)
    rows["unix_s"] = NOON_S + np.cumsum([gap for gap, _, _ in seconds])
    for row, (_, metres, state) in zip(rows, seconds, strict=True):
        row["figures"] = [[math.nan] * 4 + [0.0]] if metres is None else [[metres, 0.1, metres, metres, 1.0]]
        row["states"] = state
    seen = [metres for _, metres, _ in seconds if metres is not None]
    by_tens = merge_rows(rows, 10)
    for merged in (merge_rows(rows, 600), merge_rows(by_tens, 600)):
        assert merged["states"].max() == max(state for *_, state in seconds)
        if seen:
            assert np.nanmin(merged["figures"][:, 0, LOW]) == np.float32(min(seen))
            assert np.nanmax(merged["figures"][:, 0, HIGH]) == np.float32(max(seen))
            means = merged["figures"][:, 0, MEAN]
            known = ~np.isnan(means)
            assert (means[known] >= merged["figures"][known, 0, LOW] - 1e-3).all()
            assert (means[known] <= merged["figures"][known, 0, HIGH] + 1e-3).all()
        else:
            assert np.isnan(merged["figures"][..., :SEEN]).all()
