"""The camera's pose in a run: found in each frame, kept by journals, published and shown; and the command locate."""

import json
import math

import cv2
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from stadimeter.app.bootstrap import build
from stadimeter.app.live.health import Board, live_health
from stadimeter.app.loop import Loop
from stadimeter.app.messages import Reporter
from stadimeter.app.recordings.journal import JournalWriter, read_journal, to_be_recorded
from stadimeter.cli.main import app
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_pose import CameraPose
from support.scenes.placed import CAMERA, placed_scene
from support.scenes.render import render

SCENE = placed_scene(11)
POSE = CameraPose(
    captured_at_s=0.0,
    position_m=(1.0, -2.0, 0.5),
    orientation=(0.0, 0.0, math.sin(0.4), math.cos(0.4)),
    covariance=tuple(1e-4 * (row == column) for row in range(6) for column in range(6)),
    tags=(3, 5),
)


def configuration_text(tags):
    entries = "".join(
        f'[[landmarks.tags]]\nid = {tag.number}\nfacing = "{tag.facing_rad} rad"\nat = ["{x} m", "{y} m", "{z} m"]\n'
        for tag in tags
        for x, y, z in (tag.position_m,)
    )
    lens = (
        f"[camera.model]\nwidth_px = {CAMERA.width_px}\nheight_px = {CAMERA.height_px}\nfx_px = {CAMERA.fx_px}\n"
        f"fy_px = {CAMERA.fy_px}\ncx_px = {CAMERA.cx_px}\ncy_px = {CAMERA.cy_px}\n"
    )
    camera = '[camera]\ndriver = "images"\npaths = ["room.png", "empty.png"]\nrate = "10 Hz"\n'
    target = '[targets.sign]\ndetector = "tag"\nside = "10 cm"\nid = 10\n'
    return f'{camera}{lens}{target}[landmarks]\ntag_size = "10 cm"\n{entries}'


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    image = render(SCENE.scene).image
    cv2.imwrite(str(folder / "room.png"), image)
    image[:] = 128
    cv2.imwrite(str(folder / "empty.png"), image)
    (folder / "room.toml").write_text(configuration_text(SCENE.landmarks.tags))
    return folder


@pytest.mark.long
def test_a_run_finds_its_pose_and_its_journal_gives_the_same_one_again(room, tmp_path):
    configuration = load_configuration(room / "room.toml")
    writer = JournalWriter(tmp_path / "run.jsonl", to_be_recorded(configuration))
    loop = Loop(build(configuration, speed=None), [writer.write])
    records = []
    loop.listeners.append(lambda record, _frame: records.append(record))
    loop.run()
    writer.close()
    with_frames = [record.observation for record in records if record.observation.frame is not None]
    known, unknown = (each.camera_pose for each in with_frames[:2])
    assert math.dist(known.position_m, SCENE.position_m) < 0.01
    assert (unknown.position_m, unknown.reason) == (None, "no tag of a known place is in sight")
    kept = [cycle.observation() for cycle in read_journal(tmp_path / "run.jsonl").cycles()]
    assert kept == [record.observation for record in records]
    note = next(each for each in live_health(loop.history, Board(), "", "").notes if each.what == "place")
    assert (note.words, note.is_good) == (unknown.reason, False)


def told(poses, step_s=0.1):
    reports = Reporter("boot")
    return [
        (number * step_s, json.loads(each.payload))
        for number, pose in enumerate(poses)
        for each in reports.pose(number * step_s, lambda: "noon", pose)
    ]


def test_a_pose_is_told_when_it_has_moved_and_every_five_seconds():
    still, gone = [POSE] * 60, [replace(POSE, position_m=(1.2, -2.0, 0.5))] * 60
    assert [at_s for at_s, _ in told(still)] == pytest.approx([0.0, 5.0])
    assert [at_s for at_s, _ in told([*still, *gone])] == pytest.approx([0.0, 5.0, 6.0, 11.0])


def test_where_a_picture_was_taken_is_json_and_goes_on_after_a_bad_picture(room):
    files = [str(room / name) for name in ("room.png", "empty.png", "missing.png")]
    result = CliRunner().invoke(app, ["measure", *files, "--where", "--config", str(room / "room.toml"), "--json"])
    assert result.exit_code == 2
    known, unknown = map(json.loads, result.stdout.splitlines())
    assert known["x_m"] == pytest.approx(SCENE.position_m[0], abs=0.01)
    assert (unknown["x_m"], unknown["reason"]) == (None, "no tag of a known place is in sight")
    assert "missing.png" in result.stderr


def test_a_configuration_without_tags_says_what_to_write(room):
    (room / "plain.toml").write_text((room / "room.toml").read_text().partition("[landmarks]")[0])
    result = CliRunner().invoke(
        app, ["measure", str(room / "room.png"), "--where", "--config", str(room / "plain.toml")]
    )
    assert result.exit_code == 2
    assert "there is no section [landmarks]" in result.stderr
