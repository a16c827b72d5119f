"""The set-up through the operations that the page asks: a simulated room, a double of a device, and a run."""

from __future__ import annotations

import errno
import math
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stadimeter.app.control.client import find
from stadimeter.config.loader import DEMONSTRATION, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.errors import CalibrationError, ConfigError, ControlError, DeviceOpenError, StadimeterError
from stadimeter.web.routes import PAGE_OPERATIONS
from stadimeter.workbench.server.operations import Desk, DeskReply, find_operation
from stadimeter.workbench.server.process import error_fields
from stadimeter.workbench.server.setup_operations import setup_of
from stadimeter.workbench.setup.calibration_steps import parse_distance
from stadimeter.workbench.setup.camera_step import with_settings
from support.browser import ROOM
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.v4l2_double import V4l2Double

pytestmark = pytest.mark.vision

LENS = CameraModel.with_focal_length(600.0, 640, 480)
SKY = [320.0, 20.0]
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
        for each in self.desk.at_rest:
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
    made("take", distance="1 m", sigma="5 mm")
    made("world", x_m=3.1)
    _moved(made, 3.1)
    made("take", distance="3 m", sigma="1 cm")
    made.close()
    return made.desk.configuration.parent


@pytest.fixture
def calibrated(setup: Setup, answered: Path) -> Setup:
    """Return a set-up that has taken these answers up again."""
    shutil.copytree(answered, setup.desk.configuration.parent, dirs_exist_ok=True)
    setup("begin")
    return setup


def _moved(setup: Setup, distance_m: float) -> None:
    """Wait until the picture shows the ball where it was put."""
    for _ in range(100):
        if abs((setup("picture")["distance_m"] or 0.0) / distance_m - 1) < 0.02:
            return
    raise AssertionError("the ball never came there")


def test_every_operation_of_the_table_is_there() -> None:
    for each in PAGE_OPERATIONS:
        if each.to == "workbench":
            assert callable(find_operation(each.op))


@pytest.mark.long
def test_an_answer_is_given_to_the_question_that_it_names_and_to_no_other(setup: Setup) -> None:
    setup("begin")
    setup("answer", question="camera", answer="simulated")
    with pytest.raises(ConfigError, match="on another device"):
        setup("answer", question="camera", answer="ball")
    assert setup.question() == "target"


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


@pytest.mark.long
def test_from_nothing_to_files_that_can_be_used(calibrated: Setup) -> None:
    assert calibrated.question() == "wish"
    calibrated("answer", answer="near")
    tried = calibrated("try", answers={"near_near": "80 cm"})
    (lane,) = tried["made_up"]["rules"]
    assert lane["rule"] == "near"
    assert len(lane["active"]) == 1
    assert all(test["ok"] for test in tried["tests"])
    calibrated("answer", answer="80 cm")
    assert calibrated.question() == "output"
    with pytest.raises(ConfigError, match="questions left"):
        calibrated("files")
    assert calibrated("answer", answer="screen")["done"]
    made = calibrated("files")
    assert [file["name"] for file in made["files"]] == ["stadimeter.toml", "camera.toml"]
    assert made["findings"] == []
    text, camera = (file["text"] for file in made["files"])
    saved = find_operation("editing.save")(
        calibrated.desk, {"text": text, "files": {"camera.toml": camera}, "base_version": ""}
    )
    configuration = load_configuration(calibrated.desk.configuration)
    assert saved.data["version"]
    assert configuration.camera_model is not None
    assert configuration.camera_model.fx_px == pytest.approx(600, rel=0.01)


@pytest.mark.long
def test_a_set_up_that_was_left_goes_on_with_its_answers(in_room: Setup) -> None:
    left = in_room("leave")
    assert (left["begun"], left["left"]) == (False, True)
    assert [each["answer"] for each in left["answers"]] == ["simulated", "ball", "20 cm"]
    assert in_room("begin")["question"]["kind"] == "colour"
    assert in_room("begin", anew=True)["question"]["kind"] == "camera"
    in_room("answer", answer="simulated")
    assert in_room("back")["question"]["ready"] == "simulated"
    with pytest.raises(ConfigError, match="first question"):
        in_room("back")


@pytest.mark.long
def test_a_click_beside_the_ball_does_not_spoil_the_one_on_it(in_room: Setup) -> None:
    in_room("picture", draw="plain")
    assert in_room("colour")["range"] == ""
    beside = in_room("colour", clicks=[SKY])
    assert not beside["found"]
    on_it = in_room("colour", clicks=[BALL_AT])
    assert on_it["found"]
    assert on_it["others"] == []
    again = in_room("colour", clicks=[SKY])
    assert not again["found"]
    assert again["range"] == on_it["range"]


@pytest.mark.long
def test_a_click_is_taken_back_by_itself_and_the_others_still_count(in_room: Setup) -> None:
    in_room("picture", draw="plain")
    first = in_room("colour", clicks=[BALL_AT])
    both = in_room("colour", clicks=[[BALL_AT[0] - 4, BALL_AT[1] - 6]])
    assert both["clicks"] == [BALL_AT, [BALL_AT[0] - 4, BALL_AT[1] - 6]]
    with pytest.raises(ConfigError, match="not there any more"):
        in_room("colour", forget=2)
    left = in_room("colour", forget=1)
    assert left["clicks"] == [BALL_AT]
    assert left["range"] == first["range"]
    none = in_room("colour", forget=0)
    assert none["clicks"] == []
    assert none["range"] == ""


@pytest.mark.long
def test_what_stands_out_is_tried_without_a_click(in_room: Setup) -> None:
    in_room("picture", draw="plain")
    found = in_room("colour", look=True)
    assert found["found"]
    assert found["centre_px"] == pytest.approx(BALL_AT, abs=5)


@pytest.mark.long
def test_a_wider_range_lights_more_of_the_mask_and_the_picture_says_what_it_gives(in_room: Setup) -> None:
    in_room("picture", draw="plain")
    fitted = in_room("colour", clicks=[BALL_AT])["range"]
    shown = {}
    for colour in ("30,200,120:50,255,255", fitted, "0,0,0:179,255,255"):
        in_room("colour", range=colour)
        shown[colour] = in_room.reply("picture", draw="mask")
    lit = [_lit(each.attached) for each in shown.values()]
    assert lit == sorted(lit)
    given = [each.data["range"] for each in shown.values()]
    assert given[1]["is_found"]
    assert given[1]["ball_share"] > 0.8
    assert given[1]["elsewhere_share"] < 0.02
    assert given[2]["ball_share"] == given[2]["elsewhere_share"] == 1.0


@pytest.mark.long
def test_where_a_range_finds_no_ball_the_last_one_that_did_says_where_it_is(in_room: Setup) -> None:
    in_room("picture", draw="plain")
    in_room("colour", clicks=[BALL_AT])
    assert in_room.reply("picture", draw="mask").data["range"]["is_found"]
    in_room("colour", range="100,100,100:120,255,255")
    given = in_room.reply("picture", draw="mask").data["range"]
    assert not given["is_found"]
    assert given["ball_share"] < 0.1


def _lit(jpeg: bytes) -> float:
    """Return the share of a mask's picture that is not darkened."""
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return float(np.mean(image.max(axis=2) > 100))


@pytest.mark.long
@pytest.mark.parametrize(
    ("args", "words"),
    [
        ({"clicks": [[-1, 5]]}, "outside the picture"),
        ({"clicks": "all"}, r"Expected `array`, got `str` - at `\$.clicks`"),
        ({"clicks": [[1, None]]}, r"Expected `float`, got `null` - at `\$.clicks\[0\]\[1\]`"),
        ({"range": "green"}, "limits"),
    ],
)
def test_bad_clicks_and_ranges_are_refused_in_a_sentence(in_room: Setup, args: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        in_room("colour", **args)


@pytest.mark.long
def test_the_same_distance_twice_is_refused_and_nothing_is_lost(calibrated: Setup) -> None:
    calibrated("back")
    assert calibrated.question() == "proof"
    calibrated("world", x_m=3.1)
    with pytest.raises(CalibrationError, match="proves nothing"):
        calibrated("take", distance="1.2 m")
    with pytest.raises(CalibrationError, match="contradict"):
        calibrated("take", distance="6 m")
    assert calibrated.question() == "proof"
    taken = calibrated("take", distance="3 m")
    assert taken["focal_px"] == pytest.approx(600, rel=0.01)
    assert 0 < taken["focal_sigma_px"] < 10


@pytest.mark.long
def test_sizes_of_nothing_and_cameras_that_are_not_there_are_refused_in_a_sentence(setup: Setup) -> None:
    setup("begin")
    for camera in ("/dev/video99", "simulated,exposure=3 ms", "opencv,device=0,colour=red"):
        with pytest.raises(StadimeterError):
            setup("camera", camera=camera)
    for answer in ("simulated", "ball"):
        setup("answer", answer=answer)
    for size in ("0", "0 cm", "-3 cm", "nan cm", "600 m", ""):
        with pytest.raises(ConfigError):
            setup("answer", answer=size)
    assert setup.question() == "size"
    with pytest.raises(ConfigError, match="8 m"):
        setup("world", x_m=1e9)


@pytest.mark.long
def test_the_table_of_distances_begins_where_the_target_fills_the_picture(
    calibrated: Setup,
) -> None:
    table = calibrated("outlook")
    rows = table["rows"]
    assert rows[0]["distance_m"] == table["nearest_m"]
    assert rows[-1]["distance_m"] == table["farthest_m"]
    assert rows[0]["width_px"] == pytest.approx(0.9 * 480, rel=0.01)
    assert [row["sigma_m"] for row in rows] == sorted(row["sigma_m"] for row in rows)


@pytest.mark.long
def test_a_wish_that_counts_names_a_time_or_compares_is_shown_acting_on_what_is_made_up(calibrated: Setup) -> None:
    for wish in ("often", "daily", "visits", "night", "dark", "mute", "side", "order", "closer", "permit"):
        calibrated("answer", answer=wish)
        tried = calibrated("try")
        assert {lane["rule"] for lane in tried["made_up"]["rules"] if lane["active"]} >= {wish}
        assert all(test["ok"] for test in tried["tests"]), wish
        assert tried["problems"] == []
        calibrated("back")


@pytest.mark.long
def test_the_pin_of_a_button_is_taken_on_the_header(calibrated: Setup) -> None:
    for answer in ("mute", "2 m", "30 cm", "22", "10 min"):
        calibrated("answer", answer=answer)
    pins = {pin["gpio"]: pin for pin in calibrated.reply("wiring", output="buzzer 23").data["pins"]}
    assert pins[22]["taken_by"] == ["button"]
    with pytest.raises(ConfigError, match="pin 22 is taken by 'button 22'"):
        calibrated("answer", answer="buzzer 22")


@pytest.mark.long
def test_what_the_camera_saw_is_tried_with_a_wish(calibrated: Setup) -> None:
    seen = setup_of(calibrated.desk)
    for number in range(300):  # from 2 m to 0.6 m and back, twice
        distance_m = 1.3 + 0.7 * math.cos(2 * math.pi * number / 150)
        measured = Measurement(
            target="ball",
            status=MeasurementStatus.MEASURED,
            captured_at_s=100 + number / 15,
            distance_m=distance_m,
            depth_m=distance_m,
            sigma_m=0.01,
            noise_m=0.01,
            bearing_rad=0.0,
            elevation_rad=0.0,
        )
        seen.remember(measured)
    calibrated("answer", answer="near")
    (lane,) = calibrated("try", answers={"near_near": "1 m"})["seen"]["rules"]
    assert len(lane["active"]) == 2


@pytest.mark.long
def test_pins_are_named_with_what_takes_them_and_the_circuit_is_drawn(calibrated: Setup) -> None:
    reply = calibrated.reply("wiring", output="vibration-motor 18")
    pins = {pin["gpio"]: pin for pin in reply.data["pins"] if pin["gpio"] is not None}
    assert len(reply.data["pins"]) == 40
    assert pins[18]["taken_by"] == ["vibration-motor"]
    assert pins[2]["warning"]
    assert reply.attached.startswith(b"<svg")
    with pytest.raises(ConfigError):
        calibrated("wiring", output="laser 18")


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


def test_a_resolution_takes_the_place_of_another_and_words_are_refused() -> None:
    assert with_settings("/dev/video0,width_px=64,rate=30 Hz,height_px=48", resolution="1280 × 720") == (
        "/dev/video0,rate=30 Hz,width_px=1280,height_px=720"
    )
    with pytest.raises(ConfigError, match="write it such as"):
        with_settings("/dev/video0", resolution="large")


def test_an_exposure_takes_the_place_of_another() -> None:
    assert with_settings("opencv,device=0,exposure=3 ms,rate=30 Hz", exposure="5 ms") == (
        "opencv,device=0,rate=30 Hz,exposure=5 ms"
    )


@pytest.mark.parametrize(("text", "share"), [("1 m", 0.01), ("1 m ± 5 mm", 0.005), ("2 m +- 1 cm", 0.005)])
def test_a_distance_may_say_how_well_it_is_known(text: str, share: float) -> None:
    assert parse_distance(text)[1] == pytest.approx(share)


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
    until_s = time.monotonic() + 30
    while time.monotonic() < until_s and run.poll() is None:
        try:
            return find(configuration)
        except ControlError:
            time.sleep(0.05)
    raise AssertionError("the run did not begin to listen")


@pytest.mark.long
def test_a_real_chessboard_moved_before_the_camera_gives_its_lens(
    setup: Setup, tmp_path: Path, real_pictures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures = [cv2.imread(str(path)) for path in sorted((real_pictures / "chessboard").glob("left[0-9]*.jpg"))][::2]
    device = V4l2Double.plugged_in(tmp_path / "video0", pictures[0], monkeypatch)
    setup("begin")
    for answer in (f"opencv,device={device.node}", "ball", "20 cm", "20,60,40:50,255,255"):
        setup("answer", answer=answer, confirm=False)
    with pytest.raises(ConfigError, match="which board"):
        setup("board")
    with pytest.raises(ConfigError, match="columns and rows"):
        setup("board", do="start", columns=0, rows=6, square="25 mm")
    setup("board", do="start", columns=9, rows=6, square="25 mm")
    with pytest.raises(CalibrationError, match="still missing"):
        setup("board", do="finish")
    for picture in pictures:
        device.show(picture)
        setup("board")
        looked = setup("board")
        assert len(looked["corners_px"]) in {0, 54}
    assert looked["views"] >= 5
    assert looked["coverage"] > 0.3
    taken = setup("board", do="finish")
    assert taken["focal_px"] == pytest.approx(534, rel=0.03)
    assert setup.question() == "wish"
    setup("answer", answer="near")
    setup("answer", answer="1 m", confirm=False)
    setup("answer", answer="screen")
    assert [file["name"] for file in setup("files")["files"]] == ["stadimeter.toml", "camera.toml"]


@pytest.fixture
def pictures(setup: Setup) -> tuple[str, ...]:
    """Return the names of three pictures of a ball in a folder, at 0.8 m, 1.2 m and 2 m."""
    folder = setup.desk.configuration.parent / "my shots"
    folder.mkdir()
    names = []
    for distance_m in (0.8, 1.2, 2.0):
        ball = BallTarget(diameter_m=0.2, position_m=(0.0, 0.0, distance_m), bgr=(60, 200, 180))
        image = render(Scene(camera=LENS, target=ball, seed=1, backdrop=PlainBackdrop())).image
        names.append(f"my shots/{distance_m:g}.png")
        cv2.imwrite(str(folder.parent / names[-1]), image)
    return tuple(names)


def test_a_folder_is_shown_picture_by_picture_and_says_how_it_is_played(setup: Setup, pictures: Any) -> None:
    setup("begin")
    told = setup("camera", camera="'my shots'")
    assert tuple(told["pictures"]) == pictures
    assert told["played"] == {"rate": "5 Hz", "dwell": "2 s", "loop": True}
    thumbnail = setup.reply("picture", draw="plain", width_px=160, file=pictures[2])
    assert cv2.imdecode(np.frombuffer(thumbnail.attached, np.uint8), cv2.IMREAD_COLOR).shape == (120, 160, 3)
    told = setup("camera", camera="'my shots'", played={"rate": "10 Hz", "dwell": "1 s", "loop": "no"})
    assert told["answer"] == "'my shots' rate=10Hz dwell=1s loop=no"
    assert told["played"] == {"rate": "10Hz", "dwell": "1s", "loop": False}
    setup("answer", answer=told["answer"])
    assert tuple(setup("state")["pictures"]) == pictures


@pytest.mark.parametrize("name", ["stadimeter.toml", "../0.8.png", "/etc/passwd", "3.png"])
def test_no_other_file_than_one_of_its_pictures_is_shown(setup: Setup, pictures: Any, name: str) -> None:
    setup("begin")
    setup("camera", camera="'my shots'")
    with pytest.raises(StadimeterError, match="none of the camera's pictures"):
        setup("picture", file=name)


@pytest.mark.long
def test_a_set_up_with_a_folder_ends_in_a_run_that_goes_on(setup: Setup, pictures: Any) -> None:
    setup("begin")
    for answer in ("'my shots'", "ball", "20 cm"):
        setup("answer", answer=answer)
    setup("picture", draw="plain")
    setup("answer", answer=setup("colour", clicks=[BALL_AT])["range"])
    places = f"'{pictures[1]}@1.2 m'"
    setup("answer", answer=places)
    setup("leave")
    setup("begin")  # its answers are read as they were written, spaces and all
    seen = setup("picture", file=pictures[0])
    assert seen["distance_m"] == pytest.approx(0.8, rel=0.02)
    assert setup.question() == "wish"
    for answer in ("near", "1 m", "screen"):
        setup("answer", answer=answer)
    configuration = setup.desk.configuration
    for each in setup("files")["files"]:
        (configuration.parent / each["name"]).write_text(each["text"])
    command = [sys.executable, "-m", "stadimeter", "run", str(configuration), "--frames", "40", "--speed", "0"]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=configuration.parent, check=False)
    assert "40 frames" in ended.stdout, ended.stdout + ended.stderr
    assert ended.returncode == 0


def test_a_folder_that_is_gone_leaves_the_set_up_at_its_question(setup: Setup, pictures: Any) -> None:
    setup("begin")
    setup("answer", answer="'my shots'")
    shutil.rmtree(setup.desk.configuration.parent / "my shots")
    assert setup("state")["pictures"] == []


def test_the_demonstration_is_refused_with_a_code_that_a_page_knows() -> None:
    desk = Desk(configuration=DEMONSTRATION, run_socket=Path("/nonexistent.sock"))
    with pytest.raises(ConfigError) as refused:
        find_operation("setup_operations.begin")(desk, {})
    assert error_fields(refused.value)["code"] == "demonstration"
