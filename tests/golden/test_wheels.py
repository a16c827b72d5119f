"""How the wheels of each emulated base turn when something goes wrong while it follows a ball."""

from __future__ import annotations

from pathlib import Path
from statistics import fmean

import pytest

from scenario.prove.faults import PlannedFault
from scenario.prove.proof import FIRST_AT_S
from scenario.prove.staging import StagedConfiguration, stage
from scenario.prove.trial import run_trial
from scenario.prove.watch import MotionWatch
from stadimeter.config.loader import load_configuration
from support.golden import Golden
from support.ready_bases import follow_ball

BASES = (
    "gpio-motors", "pca9685", "ros-arduino-bridge", "waveshare-ugv", "roboclaw", "hoverboard", "roomba", "sabertooth",
)  # fmt: skip
QUICK = ("block-camera", "hang-loop", "unplug-base", "kill-process", "hide-target")
ON_PINS = ("gpio-motors", "pca9685")
EACH_S = 0.5
"""Wheels are told by their mean speed in each such time."""
SAME_MPS, SAME_ON_A_LINE_MPS = 0.001, 0.05
"""By how much a mean may differ. Bytes take their way through the kernel, which may hand them on 20 ms later: wheels
that stop from 0.34 m/s then have a mean that is 0.014 m/s larger. While the loop is slow, a late line delays the next
cycle too: 0.035 m/s were seen on a computer that does other things."""


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_wheels_of_one_base_turn_as_they_did(golden: Golden, monkeypatch: pytest.MonkeyPatch) -> None:
    _compare("wheels", "ros-arduino-bridge", QUICK, golden, monkeypatch)


@pytest.mark.long
@pytest.mark.parametrize("base", BASES)
def test_wheels_of_every_base_turn_as_they_did(base: str, golden: Golden, monkeypatch: pytest.MonkeyPatch) -> None:
    _compare(f"wheels-{base}", base, (), golden, monkeypatch)


def _compare(name: str, base: str, faults: tuple[str, ...], golden: Golden, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare what each fault, and none, does to the wheels of a base; all that it can suffer where none are named."""
    robot = Path("robot.toml")
    robot.write_text(follow_ball(base), encoding="utf-8")
    staged = stage(load_configuration(robot))
    turned: list[tuple[float, tuple[float, float]]] = []
    see = MotionWatch.see

    def see_and_keep(watch: MotionWatch, now_s: float, speeds: tuple[float, float]) -> None:
        turned.append((now_s, speeds))
        see(watch, now_s, speeds)

    monkeypatch.setattr(MotionWatch, "see", see_and_keep)
    limit_mps = SAME_MPS if base in ON_PINS else SAME_ON_A_LINE_MPS
    rows = dict(_turned(staged, fault, turned) for fault in ("", *(faults or staged.alphabet())))
    golden.compare(name, rows, lambda kept, now: _is_near(kept, now, limit_mps))


def _turned(
    staged: StagedConfiguration, fault: str, turned: list[tuple[float, tuple[float, float]]]
) -> tuple[str, str]:
    """Return what goes wrong in a trial, and the mean speeds of both wheels, such as ``0.301/0.303 0.11/0.109``."""
    turned.clear()
    result = run_trial(staged, (PlannedFault(FIRST_AT_S, fault),) if fault else ())
    part = (fault or "no fault") + (" (breaks a limit)" if result.violation else "")
    spans: dict[int, list[tuple[float, float]]] = {}
    for at_s, speeds in turned:
        spans.setdefault(int(at_s / EACH_S + 1e-6), []).append(speeds)
    means = [[round(fmean(wheel), 4) + 0.0 for wheel in zip(*each, strict=True)] for each in spans.values()]
    return part, " ".join("/".join(map(str, wheels)) for wheels in means[:-1])  # the last span is cut short


def _is_near(kept: str, now: str, limit_mps: float) -> bool:
    """Return whether wheels turned alike; a trial may be decided a little sooner or later."""
    one, other = ([tuple(map(float, each.split("/"))) for each in row.split(" ")] for row in (kept, now))
    alike = zip(one, other, strict=False)
    return abs(len(one) - len(other)) <= 1 and all(
        abs(wheel - as_well) <= limit_mps for pair in alike for wheel, as_well in zip(*pair, strict=True)
    )
