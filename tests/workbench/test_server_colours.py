"""The range of colours of a run's ball on the page: its mask, what it gives, and saving it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.errors import ChangedMeanwhileError, ConfigError
from stadimeter.workbench.colour_aids import with_range
from stadimeter.workbench.saving import versions
from stadimeter.workbench.server.editing import saved_text, version_of
from stadimeter.workbench.server.operations import Desk, DeskReply, find_operation
from support.browser import STILL, Served, served

GREEN, RED = "29,86,6:64,255,255", "170,120,70:10,255,255"


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("still"), STILL) as serving:
        yield serving


@pytest.fixture
def desk(still: Served) -> Desk:
    (socket,) = Path(still.environment["XDG_RUNTIME_DIR"]).rglob("*.sock")
    still.configuration.write_text(STILL)
    return Desk(configuration=still.configuration, run_socket=socket)


def ask(desk: Desk, op: str, **args: object) -> DeskReply:
    return find_operation(f"colours.{op}")(desk, {"target": "ball", **args})


@pytest.mark.long
def test_the_saved_range_is_shown_with_what_the_ball_and_the_rest_give(desk: Desk) -> None:
    reply = ask(desk, "picture", width_px=320)
    values = reply.data
    assert values["colour"] == GREEN
    assert values["distance_m"] == pytest.approx(3.2, rel=0.05)
    given = values["range"]
    assert given["is_found"]
    assert given["ball_share"] > 0.8
    assert given["elsewhere_share"] < 0.01
    assert 0 < given["sigma_share"] < 0.05
    image = cv2.imdecode(np.frombuffer(reply.attached, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape[1] == 320


def test_a_range_is_saved_like_any_text_and_the_former_one_is_kept(desk: Desk) -> None:
    before = len(versions(desk.configuration))
    answer = ask(desk, "keep", range=RED, base_version=version_of(STILL)).data
    text = saved_text(desk)
    assert text == STILL.replace(GREEN, RED)
    assert answer["version"] == version_of(text)
    assert answer["needs"] == "restart"
    assert len(versions(desk.configuration)) == before + 1
    with pytest.raises(ChangedMeanwhileError):
        ask(desk, "keep", range=GREEN, base_version=version_of(STILL))


@pytest.mark.parametrize(
    "wrong", ["red", "1,2,3", "200,0,0:10,255,255", '29,86,6:64,255,255"\nport = "', "9,9,9:1,1,1"]
)
def test_a_range_that_is_none_changes_nothing(desk: Desk, wrong: str) -> None:
    with pytest.raises(ConfigError):
        ask(desk, "picture", range=wrong)
    with pytest.raises(ConfigError):
        ask(desk, "keep", range=wrong, base_version=version_of(STILL))
    assert saved_text(desk) == STILL


@pytest.mark.parametrize(
    "table",
    [
        '[targets.ball]\ndetector = "ball"\nhsv = "{}"  # in daylight\ndiameter = "20 cm"\n',
        "[targets.ball]\ndetector = 'ball'\nhsv='{}'\ndiameter = '20 cm'\n",
        '[targets]\nball = {{ detector = "ball", hsv = "{}", diameter = "20 cm" }}\n',
        'targets.ball.detector = "ball"\ntargets.ball.hsv = "{}"\ntargets.ball.diameter = "20 cm"\n',
    ],
)
def test_only_the_range_changes_however_it_is_written(tmp_path: Path, table: str) -> None:
    path = tmp_path / "stadimeter.toml"
    text = (
        table.format(GREEN) + '[camera]\ndriver = "simulated"\n[world]\npath = [{ at = "0 s", x = "2 m", y = "0 m" }]\n'
    )
    path.write_text(text)
    changed = with_range(text, load_configuration(path).spans, "ball", RED)
    assert changed.replace(RED, GREEN).replace('"', "'") == text.replace('"', "'")
    path.write_text(changed)
    assert str(load_configuration(path).targets[0].options.hsv) == RED  # type: ignore[attr-defined]
