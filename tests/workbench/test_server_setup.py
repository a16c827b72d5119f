"""The set-up through the operations that the page asks: a simulated room, a double of a device, and a run."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stadimeter.app.control.client import find
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import ConfigError, ControlError, DeviceOpenError, StadimeterError
from stadimeter.testing.rig import eventually
from stadimeter.web.routes import PAGE_OPERATIONS
from stadimeter.workbench.server.operations import Desk, DeskReply, find_operation
from support.browser import ROOM
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.v4l2_double import V4l2Double

pytestmark = pytest.mark.vision

LENS = CameraModel.with_focal_length(600.0, 640, 480)
BALL_AT = [320.0, 240.0]


OPERATION_OF = {
    each.path.removeprefix("/api/v1/setup").strip("/").partition(".")[0] or "state": each.op
    for each in PAGE_OPERATIONS
    if each.path.startswith("/api/v1/setup")
}


class Setup:
    """A workbench process's set-up, without the pipe."""

    def __init__(self, configuration: Path) -> None:
        self.desk = Desk(configuration=configuration, run_socket=configuration.parent / "no-run.sock")

    def __call__(self, name: str, **args: object) -> Any:
        """Return the data of an operation."""
        return self.reply(name, **args).data

    def reply(self, name: str, **args: object) -> DeskReply:
        """Return the whole reply."""
        return find_operation(OPERATION_OF[name])(self.desk, args)

    def question(self) -> str:
        """Return the kind of the question that is next; empty for none."""
        question = self("state")["question"]
        return question["kind"] if question else ""

    def close(self) -> None:
        """Close the camera."""
        for each in self.desk.at_end:
            each()


@pytest.fixture
def setup(tmp_path: Path) -> Any:
    made = Setup(tmp_path / "stadimeter.toml")
    yield made
    made.close()


@pytest.fixture
def in_room(setup: Setup) -> Setup:
    """Return a set-up before the simulated room, up to the colour."""
    setup("begin")
    for answer in ("simulated", "ball", "20 cm"):
        setup("answer", answer=answer)
    return setup


@pytest.fixture(scope="module")
def answered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a set-up before the simulated room, answered up to what shall happen."""
    made = Setup(tmp_path_factory.mktemp("answered") / "stadimeter.toml")
    made("begin")
    for answer in ("simulated", "ball", "20 cm"):
        made("answer", answer=answer)
    made("picture", draw="plain")
    made("answer", answer=made("colour", clicks=[BALL_AT])["range"])
    made("answer", answer="1 m ± 5 mm")
    made.close()
    return made.desk.configuration.parent


@pytest.fixture
def calibrated(setup: Setup, answered: Path) -> Setup:
    """Return a set-up that has taken these answers up again."""
    shutil.copytree(answered, setup.desk.configuration.parent, dirs_exist_ok=True)
    setup("begin")
    return setup


@pytest.mark.long
def test_an_answer_that_cannot_be_kept_is_not_gone_on_from(setup: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    def fsync(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    setup("begin")
    setup("answer", answer="simulated")
    with monkeypatch.context() as full:
        full.setattr(os, "fsync", fsync)
        with pytest.raises(ConfigError, match="no space left"):
            setup("answer", answer="ball")
    assert setup.question() == "target"
    setup("answer", answer="ball")
    assert setup.question() == "size"


def test_a_choice_has_what_each_of_its_options_leaves_open_and_the_room_says_where_its_ball_is(
    calibrated: Setup,
) -> None:
    calibrated("picture")
    calibrated("world", x_m=2.4)
    state = calibrated("state")
    assert state["room"]["x_m"] == 2.4
    blanks = {option["answer"]: option["blanks"] for option in state["question"]["options"]}
    assert [(each["key"], each["ready"]) for each in blanks["far"]] == [("far_from", "2 m"), ("far_to", "4 m")]
    calibrated("answer", answer="far")
    calibrated("answer", answer="1 m")
    assert calibrated.question() == "blank"
    calibrated("back")
    again = calibrated("back")
    assert again["question"]["ready"] == "far"
    (far,) = [option["blanks"] for option in again["question"]["options"] if option["answer"] == "far"]
    assert [each["ready"] for each in far] == ["1 m", "4 m"], "what was given is ready when it is asked again"


@pytest.mark.long
def test_from_nothing_to_files_that_can_be_used(calibrated: Setup) -> None:
    assert calibrated.question() == "recipe"
    calibrated("answer", answer="near")
    calibrated("answer", answer="80 cm")
    assert calibrated.question() == "output"
    with pytest.raises(ConfigError, match="questions left"):
        calibrated("files")
    assert calibrated("answer", answer="screen")["done"]
    made = calibrated("files")
    assert [file["name"] for file in made["files"]] == ["stadimeter.toml", "camera.toml"]
    assert made["findings"] == []
    assert all(test["ok"] for test in made["tests"])
    text, camera = (file["text"] for file in made["files"])
    saved = find_operation("editing.save")(
        calibrated.desk, {"text": text, "files": {"camera.toml": camera}, "base_version": ""}
    )
    configuration = load_configuration(calibrated.desk.configuration)
    assert saved.data["version"]
    assert configuration.camera_model is not None
    assert configuration.camera_model.fx_px == pytest.approx(600, rel=0.01)


@pytest.mark.long
def test_bad_clicks_and_ranges_are_refused_in_a_sentence(in_room: Setup) -> None:
    for args, words in (
        ({"clicks": [[-1, 5]]}, "is not in the picture"),
        ({"clicks": [[1, None]]}, r"Expected `float`, got `null` - at `\$.clicks\[0\]\[1\]`"),
        ({"range": "green"}, "limits"),
    ):
        with pytest.raises(ConfigError, match=words):
            in_room("colour", **args)


@pytest.mark.long
def test_a_device_is_opened_once_and_held_until_the_set_up_is_left(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = BallTarget(position_m=(0.0, 0.0, 1.1), diameter_m=0.2)
    picture = render(Scene(camera=LENS, target=ball, seed=1, backdrop=PlainBackdrop())).image
    device = V4l2Double.plugged_in(tmp_path / "video0", picture, monkeypatch)
    camera = f"opencv,device={device.node}"
    setup("begin")
    offered = setup("camera", camera=camera, exposure="10 ms")
    assert offered["answer"] == f"{camera},exposure=10 ms"
    assert offered["is_locked"]
    setup("answer", answer=offered["answer"])
    monkeypatch.setattr(cv2, "VideoCapture", _never)
    for _ in range(3):
        assert setup("picture", draw="plain")["width_px"] == 640
    setup("leave")
    assert not device.isOpened()


def _never(*_args: object) -> None:
    raise AssertionError("the camera is open already")


def test_a_camera_that_another_program_has_is_told_and_can_be_tried_again(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = V4l2Double.plugged_in(tmp_path / "video0", np.full((480, 640, 3), 128, np.uint8), monkeypatch)
    device.is_busy = True
    setup("begin")
    with pytest.raises(DeviceOpenError):
        setup("camera", camera=f"opencv,device={device.node}")
    with monkeypatch.context() as busy:
        busy.setattr("stadimeter.cameras.opencv_device.is_in_use", lambda _node: True)
        with pytest.raises(DeviceOpenError, match="another program is using it"):
            setup("camera", camera="opencv,device=/dev/null")
    device.is_busy = False
    assert setup("camera", camera=f"opencv,device={device.node}")["width_px"] == 640


@pytest.mark.long
def test_the_camera_of_a_run_is_seen_through_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    configuration = tmp_path / "room.toml"
    configuration.write_text(ROOM)
    (tmp_path / "sockets").mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "sockets"))
    command = [sys.executable, "-m", "stadimeter", "run", str(configuration)]
    run = subprocess.Popen(command, env=os.environ, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    setup = Setup(configuration)
    setup.desk.run_socket = _listening(configuration, run)
    try:
        setup("begin")
        offered = setup("camera", camera="simulated")
        assert "a run has this camera open" in offered["settings"][0].lower()
        assert setup("picture", draw="plain")["width_px"] == 640
        with pytest.raises(ConfigError, match="no simulated room"):
            setup("world", x_m=1.0)
    finally:
        run.terminate()
        run.wait(timeout=120)
    with pytest.raises(StadimeterError):
        setup("picture", draw="plain")
    assert setup("picture", draw="plain")["width_px"] == 640  # the run is gone: the camera is ours
    setup.close()


def _listening(configuration: Path, run: subprocess.Popen[bytes]) -> Path:
    def found() -> Path | None:
        assert run.poll() is None, "the run did not begin to listen"
        with suppress(ControlError):
            return find(configuration)
        return None

    return eventually(found)
