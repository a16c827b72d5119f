"""Editing on the page: text, versions and colours; and the process that answers."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import ChangedMeanwhileError, ConfigError, DriverError, StadimeterError
from stadimeter.web.routes import PAGE_OPERATIONS
from stadimeter.workbench import saving
from stadimeter.workbench.saving import versions
from stadimeter.workbench.server.colours import with_range
from stadimeter.workbench.server.editing import saved_text, version_of
from stadimeter.workbench.server.operations import Desk, DeskReply, find_operation
from stadimeter.workbench.server.process import serve
from support.browser import STILL, Served, served
from support.saves import CONFIGURATION

pytestmark = pytest.mark.vision


# Editing on the page: what is found while typing, saving, versions, and two who save at once.

HERE = CONFIGURATION.format(below="1 m")
THERE = CONFIGURATION.format(below="50 cm")
LENS = camera_file_text(CameraModel.with_focal_length(600.0, 640, 480))
OTHER_LENS = camera_file_text(CameraModel.with_focal_length(700.0, 640, 480))


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    (tmp_path / "camera.toml").write_text(LENS)
    (tmp_path / "stadimeter.toml").write_text(HERE)
    return Desk(configuration=tmp_path / "stadimeter.toml", run_socket=tmp_path / "none.sock")


def ask(desk: Desk, op: str, **args: object) -> Any:
    return find_operation(f"editing.{op}")(desk, args).data


def version(desk: Desk) -> str:
    return str(ask(desk, "configuration")["version"])


def test_a_configuration_that_is_not_there_yet_can_be_written(tmp_path: Path) -> None:
    desk = Desk(configuration=tmp_path / "new" / "stadimeter.toml")
    before = ask(desk, "configuration")
    assert (before["text"], before["version"], before["exists"]) == ("", "", False)
    saved = ask(desk, "save", text=HERE, base_version="", files={"camera.toml": LENS})
    assert saved == {"version": version(desk), "kept": None, "needs": "start"}
    assert ask(desk, "check", text=HERE)["problems"] == []


def test_the_demonstration_stays_as_it_is_and_nothing_is_written_beside_it(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stadimeter.config.loader.DEMONSTRATION", desk.configuration)
    before = {path: path.read_bytes() for path in desk.configuration.parent.iterdir()}
    for name, args in (
        ("editing.save", {"text": THERE, "base_version": version(desk)}),
        ("setup_operations.begin", {}),
    ):
        with pytest.raises(ConfigError, match=r"in a folder of yours"):
            find_operation(name)(desk, args)
    assert {path: path.read_bytes() for path in desk.configuration.parent.iterdir()} == before


def test_a_text_is_checked_with_a_camera_file_that_is_not_saved_and_nothing_is_written(desk: Desk) -> None:
    folder = desk.configuration.parent
    (folder / "camera.toml").unlink()
    assert "camera file" in ask(desk, "check", text=HERE)["problems"][0]["message"]
    assert ask(desk, "check", text=HERE, files={"camera.toml": LENS})["problems"] == []
    wrong = ask(desk, "check", text=HERE, files={"camera.toml": "width_px = -1\n"})["problems"]
    assert Path(wrong[0]["file"]).name == "camera.toml"
    assert [each.name for each in folder.iterdir()] == ["stadimeter.toml"]


def test_tests_are_run_on_request_and_say_what_they_got(desk: Desk) -> None:
    text = HERE + '\n[[tests]]\nname = "never"\ninput = { hover = { at = "50 cm", for = "2 s" } }\n'
    text += "expect.near = { raised = 0 }\n"
    assert ask(desk, "check", text=text)["tests"] == []
    (told,) = ask(desk, "check", text=text, tests=True)["tests"]
    assert (told["name"], told["ok"], told["line"]) == ("never", False, HERE.count("\n") + 2)
    assert "near.raised: expected 0" in told["words"]


def test_a_save_keeps_what_was_there_and_brings_it_back(desk: Desk) -> None:
    first = ask(desk, "save", text=THERE, base_version=version(desk), files={"camera.toml": OTHER_LENS})
    (former,) = ask(desk, "configuration")["versions"]
    assert former["id"] == first["kept"]
    assert ask(desk, "version", id=former["id"])["text"] == HERE
    ask(desk, "restore", id=former["id"], base_version=first["version"])
    assert desk.configuration.read_text() == HERE
    assert (desk.configuration.parent / "camera.toml").read_text() == LENS
    assert len(ask(desk, "configuration")["versions"]) == 2, "what was restored over is kept, too"


def test_the_second_of_two_savers_is_told_what_the_first_one_changed(desk: Desk) -> None:
    both_read = version(desk)
    ask(desk, "save", text=THERE, base_version=both_read)
    with pytest.raises(ChangedMeanwhileError, match="changed by another") as refused:
        ask(desk, "save", text=HERE + "# mine\n", base_version=both_read)
    assert refused.value.code == "conflict"
    assert desk.configuration.read_text() == THERE


def test_two_who_save_the_same_text_do_not_disturb_each_other(desk: Desk) -> None:
    both_read = version(desk)
    ask(desk, "save", text=THERE, base_version=both_read)
    assert ask(desk, "save", text=THERE, base_version=both_read)["kept"] is None


def test_a_folder_that_vanished_is_told_and_the_text_can_be_saved_anew(desk: Desk) -> None:
    base = version(desk)
    desk.configuration.unlink()
    with pytest.raises(ChangedMeanwhileError, match="not there any more"):
        ask(desk, "save", text=THERE, base_version=base)
    ask(desk, "save", text=THERE, base_version="")
    assert desk.configuration.read_text() == THERE


def test_a_configuration_with_errors_is_saved_on_request_only(desk: Desk) -> None:
    wrong = HERE.replace("below", "bellow")
    with pytest.raises(ConfigError, match="bellow"):
        ask(desk, "save", text=wrong, base_version=version(desk))
    assert desk.configuration.read_text() == HERE
    ask(desk, "save", text=wrong, base_version=version(desk), even_if_wrong=True)
    assert desk.configuration.read_text() == wrong


@pytest.mark.parametrize("name", ["../outside.toml", "/etc/passwd", "a/../../b", ".hidden", "", "a//b", "a\0b"])
def test_no_file_beside_it_leaves_the_folder(desk: Desk, name: str) -> None:
    with pytest.raises(ConfigError):
        ask(desk, "save", text=THERE, base_version=version(desk), files={name: "x"}, even_if_wrong=True)
    assert desk.configuration.read_text() == HERE


def test_nothing_is_saved_over_a_file_that_is_no_text_and_its_reason_is_said_as_it_is(desk: Desk) -> None:
    desk.configuration.write_bytes(b"# f\xfcr den Ball\n")
    with pytest.raises(
        StadimeterError,
        match=rf"^{desk.configuration}:1: it is not UTF-8 text \(it has the byte 0xFC, in Windows-1252 ü\)$",
    ):
        ask(desk, "save", text=THERE, base_version="")
    assert desk.configuration.read_bytes() == b"# f\xfcr den Ball\n"


def test_a_disk_that_is_full_at_the_second_file_leaves_both_as_they_were(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []

    def fsync(descriptor: int) -> None:
        synced.append(descriptor)
        if len(synced) == 6:  # two kept, each with its folder; the camera file; the configuration
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(ConfigError, match="no space left"):
        ask(desk, "save", text=THERE, base_version=version(desk), files={"camera.toml": OTHER_LENS})
    assert len(synced) == 6
    assert desk.configuration.read_text() == HERE
    assert (desk.configuration.parent / "camera.toml").read_text() == LENS
    assert not list(desk.configuration.parent.glob(".*"))


STRANGE = (
    *(None, 1, True, [], {}, "\ud800", "\0", "a" * 1_000_000),
    *({"text": 1}, [[1]], 1e308, "../../x", {"a\ud800.toml": "x"}),
)


@pytest.mark.parametrize(
    "op", [each.op for each in PAGE_OPERATIONS if each.to == "workbench" and "setup" not in each.op]
)
def test_whatever_a_browser_sends_is_answered_or_refused_in_a_sentence(desk: Desk, op: str) -> None:
    """Everything is of the wrong type once; a defect would come out as another kind of error."""
    keys = ("text", "files", "base_version", "id", "name", "at_s", "for_s", "tests", "even_if_wrong", "draw")
    sound = {"text": HERE, "base_version": version(desk), "name": "a.mcap", "id": "0001-20260101T000000Z"}
    refused = 0
    for key in keys:
        for strange in STRANGE:
            try:
                json.dumps(find_operation(op)(desk, {**sound, key: strange}).data, allow_nan=False)
            except StadimeterError:
                refused += 1
    if op not in {"editing.configuration", "recordings.recordings"}:
        assert refused > 10
    assert load_configuration(desk.configuration).rules


def test_a_save_that_failed_half_way_keeps_what_it_has_replaced(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera file has its new name; then the disk fails."""
    whole, calls = Path.replace, []

    def replace(path: Path, target: Path) -> Path:
        calls.append(target.name)
        if calls.count("stadimeter.toml") == 2:  # the first is that of the kept one
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return whole(path, target)

    monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises(ConfigError, match="input/output error"):
        ask(desk, "save", text=THERE, base_version=version(desk), files={"camera.toml": OTHER_LENS})
    (former,) = saving.versions(desk.configuration)
    assert (former.folder / "camera.toml").read_text() == LENS


def test_the_oldest_versions_go_and_the_newest_stay(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(saving, "KEPT_MAX", 3)
    monkeypatch.setattr(os, "fsync", lambda _: None)
    for number in range(6):
        ask(desk, "save", text=f"{HERE}# {number}\n", base_version=version(desk))
    numbers = [int(each["id"].partition("-")[0]) for each in ask(desk, "configuration")["versions"]]
    assert numbers == [6, 5, 4]


def test_a_kept_version_can_be_read_by_those_only_who_could_read_the_file(desk: Desk) -> None:
    desk.configuration.chmod(0o640)
    kept = ask(desk, "save", text=THERE, base_version=version(desk))["kept"]
    file = desk.configuration.parent / saving.VERSIONS / kept / desk.configuration.name
    assert file.stat().st_mode & 0o777 == 0o640


# The range of colours of a run's ball on the page: its mask, what it gives, and saving it.

GREEN, RED = "29,86,6:64,255,255", "170,120,70:10,255,255"


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("still"), STILL) as serving:
        yield serving


@pytest.fixture
def desk_of_run(still: Served) -> Desk:
    (socket,) = Path(still.environment["XDG_RUNTIME_DIR"]).rglob("*.sock")
    still.configuration.write_text(STILL)
    return Desk(configuration=still.configuration, run_socket=socket)


def ask_colours(desk_of_run: Desk, op: str, **args: object) -> DeskReply:
    return find_operation(f"colours.{op}")(desk_of_run, {"target": "ball", **args})


@pytest.mark.long
def test_the_saved_range_is_shown_with_what_the_ball_and_the_rest_give(desk_of_run: Desk) -> None:
    reply = ask_colours(desk_of_run, "picture", width_px=320)
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


def test_a_range_is_saved_like_any_text_and_the_former_one_is_kept(desk_of_run: Desk) -> None:
    before = len(versions(desk_of_run.configuration))
    answer = ask_colours(desk_of_run, "keep", range=RED, base_version=version_of(STILL)).data
    text = saved_text(desk_of_run)
    assert text == STILL.replace(GREEN, RED)
    assert answer["version"] == version_of(text)
    assert answer["needs"] == "restart"
    assert len(versions(desk_of_run.configuration)) == before + 1
    with pytest.raises(ChangedMeanwhileError):
        ask_colours(desk_of_run, "keep", range=GREEN, base_version=version_of(STILL))


@pytest.mark.parametrize(
    "wrong", ["red", "1,2,3", "200,0,0:10,255,255", '29,86,6:64,255,255"\nport = "', "9,9,9:1,1,1"]
)
def test_a_range_that_is_none_changes_nothing(desk_of_run: Desk, wrong: str) -> None:
    with pytest.raises(ConfigError):
        ask_colours(desk_of_run, "picture", range=wrong)
    with pytest.raises(ConfigError):
        ask_colours(desk_of_run, "keep", range=wrong, base_version=version_of(STILL))
    assert saved_text(desk_of_run) == STILL


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
    changed = with_range(text, "ball", RED)
    assert changed.replace(RED, GREEN).replace('"', "'") == text.replace('"', "'")
    path.write_text(changed)
    assert str(load_configuration(path).targets[0].options.hsv) == RED  # type: ignore[attr-defined]


# What the workbench process answers on a pipe. The page's tests ask the whole process.


def _exchanged(desk: Desk, *lines: bytes) -> list[dict[str, Any]]:
    """Return the answers of `serve` to lines; a file holds more of them than a pipe that nobody reads yet."""
    asked = desk.configuration.with_name("requests")
    asked.write_bytes(b"".join(line + b"\n" for line in lines))
    answers = BytesIO()
    with asked.open("rb") as requests:
        serve(desk, requests, answers)
    return [json.loads(line) for line in answers.getvalue().splitlines()]


def test_what_is_no_request_is_refused_and_the_next_is_answered(tmp_path: Path) -> None:
    bad = (b"", b"{", b"[]", b'{"op": 1}', b'{"op": "nothing"}', b"[" * 100_000)
    *refused, answered = _exchanged(Desk(configuration=tmp_path / "a.toml"), *bad, b'{"op": "setup_operations.state"}')
    assert [each["status"] for each in refused] == ["error"] * len(bad)
    assert answered["data"]["question"] is None


def test_a_defect_in_an_operation_is_told_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def divide(_desk: Desk, _args: object) -> DeskReply:
        return DeskReply(data=1 / 0)

    def fine(_desk: Desk, _args: object) -> DeskReply:
        return DeskReply(data="fine")

    monkeypatch.setattr(
        "stadimeter.workbench.server.process.find_operation", {"divide": divide, "fine": fine}.__getitem__
    )
    first, second = _exchanged(Desk(configuration=tmp_path / "a.toml"), b'{"op": "divide"}', b'{"op": "fine"}')
    assert first["status"] == "error"
    assert first["code"] == "defect"
    assert "ZeroDivisionError" in capfd.readouterr().err
    assert second["data"] == "fine"


def test_the_desk_is_tidied_at_the_end_even_if_nobody_reads_the_answer(tmp_path: Path) -> None:
    rested: list[str] = []

    def busy() -> None:
        raise DriverError("the camera does not close")

    desk = Desk(configuration=tmp_path / "a.toml", at_end=[busy, lambda: rested.append("camera")])
    in_end, in_start = os.pipe()
    out_end, out_start = os.pipe()
    os.close(out_end)
    os.write(in_start, b'{"op": "setup_operations.state"}\n')
    with os.fdopen(in_end, "rb") as requests, os.fdopen(out_start, "wb", buffering=0) as answers:
        serve(desk, requests, answers)
    os.close(in_start)
    assert rested == ["camera"]
