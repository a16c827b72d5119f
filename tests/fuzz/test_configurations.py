"""Whatever a configuration or a camera file holds, it is used, or refused with its file, line and key."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.recordings.journal import to_be_recorded
from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.config.describe import describe
from stadimeter.config.loader import load_camera_choice, load_configuration
from stadimeter.core.camera_model import CameraModel, Provenance
from stadimeter.errors import ConfigError, Problem

TESTS = Path(__file__).parents[1]
CONFIGURATIONS = sorted((TESTS.parent / "config").glob("*.toml")) + sorted((TESTS / "config/analysis").glob("*.toml"))
OF_THE_TEXT = {"unreadable", "syntax", "too-deep"}
"""The codes of what is wrong with a text of which no key is known."""

SOME, ALL, PARTS = 60, 5000, 10


def lens() -> CameraModel:
    return CameraModel(
        width_px=640, height_px=480, fx_px=600.5, fy_px=601.5, cx_px=319.5, cy_px=239.5,
        distortion=(-0.1, 0.01, 0.0, 0.0, 0.001), edge_bias_px=0.2, focal_relative_sigma=0.01,
        provenance=Provenance(method="by hand", date="2026-01-01", notes=("one", "two")),
    )  # fmt: skip


def check(problems: tuple[Problem, ...], file: Path) -> None:
    text = file.read_bytes().decode("utf-8", "replace")
    assert problems
    for problem in problems:
        assert problem.message
        assert problem.code
        assert problem.file
        assert problem.key or problem.code in OF_THE_TEXT, problem
        assert len(problem.message) + len(problem.hint) < 1500
        str(problem).encode("utf-8")
        # Only what is missing from the top of a file has no line.
        is_absent = problem.key.partition(".")[0] not in text or "is missing" in problem.message
        assert (
            problem.line
            or is_absent
            or problem.code in {"unreadable", "too-deep"}
            or "there is no target" in problem.message
        )


def load_everything(file: Path) -> None:
    try:
        loaded = load_configuration(file)
    except ConfigError as error:
        check(error.problems, file)
    else:
        assert describe(loaded)
        assert all(warning.key for warning in (*loaded.warnings, *feasibility_warnings(loaded)))
        assert to_be_recorded(loaded).text
    try:
        load_camera_choice(file)
    except ConfigError as error:
        check(error.problems, file)


def load_lens(file: Path) -> None:
    try:
        load_camera_model(file)
    except ConfigError as error:
        check(error.problems, file)


def many(*values: int) -> object:
    """Return a case that takes long."""
    return pytest.param(*values, marks=[pytest.mark.long, pytest.mark.timeout(300)])


@pytest.mark.parametrize(("seed", "count"), [(0, SOME), *(many(1 + part, ALL // PARTS) for part in range(PARTS))])
def test_many_mutations_of_configurations_are_no_tracebacks(tmp_path: Path, mutate, seed: int, count: int) -> None:
    rng = random.Random(seed)  # noqa: S311
    file = tmp_path / "configuration.toml"
    save_camera_model(tmp_path / "camera.toml", lens())
    for _ in range(count):
        file.write_bytes(mutate(rng, rng.choice(CONFIGURATIONS).read_bytes()))
        load_everything(file)


@pytest.mark.parametrize(("seed", "count"), [(0, 5 * SOME), many(1, ALL)])
def test_many_mutations_of_a_camera_file_are_no_tracebacks(tmp_path: Path, mutate, seed: int, count: int) -> None:
    rng = random.Random(seed)  # noqa: S311
    file = tmp_path / "camera.toml"
    save_camera_model(file, lens())
    sound = file.read_bytes()
    for _ in range(count):
        file.write_bytes(mutate(rng, sound))
        load_lens(file)
