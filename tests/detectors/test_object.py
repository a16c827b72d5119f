"""The object detector, with small networks that find what is bright, in both engines."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from stadimeter.config.plugins import DriverContext
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.decision import EventKind
from stadimeter.core.detection import DetectionStatus, Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan, Safety
from stadimeter.core.rule import AlarmRule
from stadimeter.detectors.object import BOX_SIGMA, EYES_SIGMA, ObjectOptions
from stadimeter.detectors.object import detector as detector_module
from stadimeter.detectors.object.detector import ObjectDetector
from stadimeter.detectors.object.families import EYES_SIGMA_PX, PERSON_SIGMA_PX, recognise
from stadimeter.detectors.object.following import FollowedBox
from stadimeter.detectors.object.model_file import MODEL_MAX_BYTES, load_model, parse_model
from stadimeter.detectors.object.network import Network, examine
from stadimeter.errors import DriverError, UnreadableError
from stadimeter.perception.perceiver import Perceiver
from stadimeter.testing.rig import ManualClock
from support.networks import CLASSES, EYES, bright_figure, put_figure, write_network
from support.through_lens import ThroughLens

pytestmark = pytest.mark.vision

FAMILIES = ("yolox", "yolov8", "nanodet", "yunet", "centerface")
FACES = ("yunet", "centerface")
ENGINES = ("opencv", "onnxruntime")
CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
SCALE = 256 / 640
"""Of pictures in the networks' input."""


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("networks")
    return {family: write_network(folder / f"{family}.onnx", family) for family in FAMILIES}


def detector(model: Path, **options: Any) -> ObjectDetector:
    size = {} if {"width", "eye_distance"} & set(options) else {"height": "1.72 m ± 7 cm"}
    made = ObjectOptions.model_validate({"model": str(model), "engine": "opencv", **size, **options})
    return made.build(DriverContext(name="it", clock=ManualClock()))


def picture(*figures: tuple[int, int, int], seed: int = 0) -> Image:
    """Return a dark room with bright figures, each by left, top and height; they are 0.4 times as wide."""
    image = np.random.default_rng(seed).integers(20, 90, (480, 640, 3), np.uint8)
    for left, top, height in figures:
        put_figure(image, bright_figure(height, round(0.4 * height)), left, top)
    return image


def at(seconds: float, *figures: tuple[int, int, int]) -> Frame:
    return Frame(picture(*figures), seconds, round(30 * seconds))


class CountedLooks:
    """Counts how often the network of a detector looks."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count = 0
        find = Network.find

        def counted(network: Network, *arguments: Any) -> Any:
            self.count += 1
            return find(network, *arguments)

        monkeypatch.setattr(Network, "find", counted)


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> CountedLooks:
    return CountedLooks(monkeypatch)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("family", FAMILIES)
def test_a_network_of_each_family_finds_the_box_in_both_engines(
    networks: dict[str, Path], family: str, engine: str
) -> None:
    if engine == "onnxruntime":
        pytest.importorskip("onnxruntime")
    found = detector(networks[family], engine=engine).detect(at(0, (100, 150, 200)))
    assert found.status is DetectionStatus.FOUND, found.reason
    assert found.outline_px[[0, 2]].ravel() == pytest.approx((99.5, 149.5, 179.5, 349.5), abs=1.5)
    assert found.height_px == pytest.approx(200, abs=2.5)
    assert found.quality == pytest.approx(0.9, abs=0.01)


@pytest.mark.parametrize("family", FACES)
def test_a_face_is_measured_by_its_eyes(networks: dict[str, Path], family: str) -> None:
    through = ThroughLens(detector(networks[family], eye_distance="63.4 mm ± 3.8 mm"), CAMERA)
    frame = Frame(picture(), 0.0, 0)
    put_figure(frame.image, bright_figure(130, 120), 150, 150)
    found, measured = through.detect(frame), through.measure(frame)
    # The eyes are 0.4 widths of 120 px apart, at 0.4 of the height; CenterFace would mark them further apart.
    apart = 1.05 if family == "centerface" else 1.0
    assert found.width_px == pytest.approx((EYES[1][0] - EYES[0][0]) * 120 / apart, abs=1)
    assert found.centre_px == pytest.approx((209.5, 201.5), abs=1.5)
    assert measured.distance_m == pytest.approx(0.0634 * 600 / 48 * apart, rel=0.05)
    of_pixels = EYES_SIGMA_PX / (found.width_px * (0.4 if family == "yunet" else SCALE))
    assert measured.sigma_m / measured.distance_m == pytest.approx(
        math.hypot(3.8 / 63.4, EYES_SIGMA, of_pixels), rel=0.02
    )


@pytest.mark.parametrize("family", FACES)
def test_a_face_in_profile_is_no_further_away_and_less_sure(networks: dict[str, Path], family: str) -> None:
    front, profile = Frame(picture(), 0.0, 0), Frame(picture(), 1.0, 1)
    put_figure(front.image, bright_figure(120, 110), 150, 150)
    put_figure(profile.image, bright_figure(120, 40), 150, 150)  # the eyes are 13 % of the height apart
    through = ThroughLens(detector(networks[family], eye_distance="63.4 mm ± 3.8 mm"), CAMERA)
    known, turned = through.measure(front), through.measure(profile)
    assert turned.distance_m == pytest.approx(known.distance_m, rel=0.15)
    assert turned.sigma_m / turned.distance_m > 0.12 > known.sigma_m / known.distance_m
    assert "looks aside: measured by the height of its box" in through.detect(profile).reason
    assert through.detect(front).reason == ""
    cut = Frame(picture(), 2.0, 2)
    put_figure(cut.image, bright_figure(120, 40), 150, -30)  # the eyes are in the picture, and the forehead is not
    assert through.detect(cut).status is DetectionStatus.TRUNCATED


def test_the_distance_of_a_person_follows_from_its_height_and_the_spread_is_in_its_sigma(
    networks: dict[str, Path],
) -> None:
    measured = ThroughLens(detector(networks["yolox"]), CAMERA).measure(at(0, (100, 150, 200)))
    assert measured.depth_m == pytest.approx(1.72 * 600 / 200, rel=0.01)
    of_pixels = PERSON_SIGMA_PX / (200 * SCALE)
    share = math.hypot(0.07 / 1.72, BOX_SIGMA, of_pixels)
    assert measured.sigma_m == pytest.approx(measured.distance_m * share, rel=0.02)
    # What differs from look to look; hair, shoes and posture stay.
    assert measured.noise_m == pytest.approx(
        measured.distance_m * math.hypot(BOX_SIGMA / math.sqrt(2), of_pixels), rel=0.02
    )


@pytest.mark.parametrize("height_px", [40, 60, 240])
def test_a_box_errs_by_pixels_of_the_input_so_one_seen_small_is_less_sure(
    networks: dict[str, Path], height_px: int
) -> None:
    """Whole pictures only: 640 px in an input of 256 px."""
    network = Network(recognise(load_model(networks["yolox"]), None), "opencv")
    seen = network.find(picture((100, 150, height_px)), 0, 0.5)
    assert seen.scale == pytest.approx(SCALE)
    frame = at(0, (100, 150, height_px))
    found = detector(networks["yolox"]).detect(frame)
    # What is small was looked at once more, in a part of the picture that is no larger than the input.
    scale = SCALE if height_px == 240 else 1.0
    share = math.hypot(BOX_SIGMA / math.sqrt(2), PERSON_SIGMA_PX / (height_px * scale))
    assert found.size_sigma_px / found.height_px == pytest.approx(share, rel=0.1)


TINY = (100, 150, 24)
"""A figure that is 4 px wide in the input, between two of its cells."""


def test_a_picture_from_a_file_is_searched_in_tiles_and_a_live_one_tile_by_tile(
    networks: dict[str, Path], looks: CountedLooks
) -> None:
    assert detector(networks["yolox"]).detect(at(0, TINY)).reason == "no person"
    from_file = Frame(picture(TINY), 0.0, 0, "hall.jpg")
    found = detector(networks["yolox"]).detect(from_file)
    assert found.height_px == pytest.approx(24, abs=1), found.reason
    it, before = detector(networks["yolox"], every="0.1 s"), looks.count
    seen = [it.detect(at(number / 5, TINY)).status for number in range(25)]
    assert DetectionStatus.FOUND in seen[:19], "nine tiles, every other look"
    assert looks.count - before <= 27, "one look for each picture"
    assert DetectionStatus.FOUND in seen[-2:], "it stays found by what is around it"


def test_what_only_a_closer_look_shows_stays_while_the_whole_picture_does_not_show_it(
    networks: dict[str, Path],
) -> None:
    it = detector(networks["yolox"], every="0.1 s")
    assert it.detect(Frame(picture(TINY), 0.0, 0, "hall.jpg")).status is DetectionStatus.FOUND
    seen = [it.detect(at(number / 5, TINY)) for number in range(1, 12)]
    assert {each.status for each in seen} <= {DetectionStatus.FOUND, DetectionStatus.NOT_FOUND}
    assert sum(each.status is DetectionStatus.FOUND for each in seen) >= 9


def test_a_box_at_the_border_of_a_part_is_no_person(networks: dict[str, Path]) -> None:
    """Tiles cut the figure, which the whole picture shows whole."""
    tall = (60, 40, 400)
    found = detector(networks["yolox"], count=3).detect_all(Frame(picture(tall), 0.0, 0, "hall.jpg"))
    assert [each.height_px for each in found] == [pytest.approx(400, abs=3)]


def test_a_far_one_that_cannot_be_followed_hides_no_near_one(
    networks: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(detector_module, "take_pattern", lambda *_: "it is plain")
    it = detector(networks["yolox"], every="0.2 s")
    it.detect(Frame(picture(TINY), 0.0, 0, "hall.jpg"))
    seen = [it.detect(at(number / 5, TINY, (400, 100, 300))).height_px for number in range(1, 5)]
    assert any(height_px == pytest.approx(300, abs=3) for height_px in seen), seen


@pytest.mark.parametrize("left", [8, 100], ids=["near a border", "elsewhere"])
def test_what_is_gone_is_given_up_though_it_seems_to_be_followed(
    networks: dict[str, Path], monkeypatch: pytest.MonkeyPatch, left: int
) -> None:
    monkeypatch.setattr(detector_module, "follow_box", lambda _image, _pattern, near: FollowedBox(near, 0.0))
    it = detector(networks["yolox"], every="0.2 s")
    there = (left, 150, 24)
    assert it.detect(Frame(picture(there), 0.0, 0, "hall.jpg")).status is DetectionStatus.FOUND
    seen = [it.detect(at(number / 5)).status for number in range(1, 8)]
    assert seen[-1] is DetectionStatus.NOT_FOUND


def test_one_who_leaves_across_the_border_is_not_kept_as_cut_off(networks: dict[str, Path]) -> None:
    it = detector(networks["yolox"], every="0.2 s")
    for number in range(12):
        it.detect(at(number / 10, (100, 380 + 6 * number, 80)))
    assert it.detect(at(2.0)).status in {DetectionStatus.TRUNCATED, DetectionStatus.NOT_FOUND}
    assert [it.detect(at(2.0 + number / 5)).status for number in range(1, 6)][-1] is DetectionStatus.NOT_FOUND


def test_two_are_found_and_each_keeps_its_name(networks: dict[str, Path]) -> None:
    it = detector(networks["yolox"], count=2, every="0.2 s")
    perceiver, names = Perceiver(dict.fromkeys(("it-1", "it-2"), it), CAMERA), []
    state = initial_state(Plan(targets=("it-1", "it-2")))
    for number in range(45):
        frame = at(number / 15, (60 + 2 * number, 150, 230), (560 - 2 * number, 100, 160))
        tracks = {each.track.target: each.track for each in state.tracks}
        found, measured = perceiver.look(frame, tracks)
        stamp = FrameStamp(sequence=number, captured_at_s=frame.captured_at_s)
        state, _ = decide(state, Observation(now_s=frame.captured_at_s, frame=stamp, measurements=measured))
        names.append(tuple(round(each.height_px) for each in found))
    assert all(one == pytest.approx(230, abs=6) and other == pytest.approx(160, abs=6) for one, other in names), names


def test_the_network_looks_once_in_a_time_and_its_box_is_followed_in_between(
    networks: dict[str, Path], looks: CountedLooks
) -> None:
    it = detector(networks["yolox"], every="0.5 s")
    for number in range(31):  # 1 s at 30 pictures a second; it comes nearer and goes to the right
        left, height = 100 + 3 * number, 200 + number
        found = it.detect(at(number / 30, (left, 150, height)))
        assert found.status is DetectionStatus.FOUND, found.reason
        assert found.height_px == pytest.approx(height, rel=0.02), number
        assert found.centre_px[0] == pytest.approx(left + 0.2 * height, abs=3), number
    assert looks.count == 3


def test_the_sigma_grows_with_the_age_of_what_the_network_saw(networks: dict[str, Path]) -> None:
    it = detector(networks["yolox"], every="1 s")
    shares = [
        found.size_sigma_px / found.height_px for found in (it.detect(at(t, (200, 120, 220))) for t in (0, 0.1, 0.9))
    ]
    assert shares[0] == pytest.approx(math.hypot(BOX_SIGMA / math.sqrt(2), PERSON_SIGMA_PX / (220 * SCALE)), rel=0.02)
    assert shares[0] < shares[1] < shares[2]


def test_what_cannot_be_followed_is_not_found_with_the_reason_and_the_network_looks_again(
    networks: dict[str, Path], looks: CountedLooks
) -> None:
    it = detector(networks["yolox"], every="5 s")
    assert it.detect(at(0.0, (150, 150, 200))).status is DetectionStatus.FOUND
    lost = it.detect(at(0.1))
    assert lost.status is DetectionStatus.NOT_FOUND
    assert lost.reason.startswith("the person is not followed until the network looks again: ")
    assert looks.count == 1
    assert it.detect(at(0.2, (400, 100, 300))).height_px == pytest.approx(300, abs=3)
    assert looks.count == 2


def test_an_earlier_frame_and_one_of_another_size_are_looked_at_anew_and_the_same_one_is_not(
    networks: dict[str, Path], looks: CountedLooks
) -> None:
    it = detector(networks["yolox"])
    whole = at(1.0, (150, 150, 200))
    assert it.detect(whole).centre_px == it.detect(whole).centre_px
    it.detect(at(0.9, (150, 150, 200)))
    it.detect(Frame(np.ascontiguousarray(whole.image[:240]), 1.0, 31))
    assert looks.count == 3


def test_with_a_prediction_the_nearest_is_taken_and_without_one_the_one_that_was_followed(
    networks: dict[str, Path],
) -> None:
    both = (60, 150, 230), (400, 100, 250)
    it = detector(networks["yolox"], every="0.2 s")
    expected = Prediction(centre_px=(106, 265), size_px=230, sigma_px=3)
    assert it.detect(at(0, *both), expected).height_px == pytest.approx(230, abs=3)
    later = it.detect(at(0.3, *both))  # once a second the whole picture is searched without a prediction
    assert (later.height_px, later.reason) == (pytest.approx(230, abs=3), "the one of 2 where it was expected")


def test_one_that_is_surely_nearer_takes_the_place_of_the_one_that_is_followed(networks: dict[str, Path]) -> None:
    far, nearer, cut = (60, 150, 160), (400, 100, 240), (400, -60, 300)
    it = detector(networks["yolox"], every="0.2 s")
    expected = Prediction(centre_px=(92, 230), size_px=160, sigma_px=3)
    assert it.detect(at(0, far), expected).height_px == pytest.approx(160, abs=2)
    seen = it.detect(at(0.3, far, nearer), expected)
    assert (seen.height_px, seen.reason) == (pytest.approx(240, abs=3), "the nearest of 2")
    # Of one that the border cuts there is no distance.
    assert it.detect(at(0.6, far, cut), expected).height_px == pytest.approx(160, abs=2)


@pytest.mark.long
def test_an_alarm_on_a_person_is_raised_by_another_one_who_comes_nearer(networks: dict[str, Path]) -> None:
    """One is tracked at 7.9 m, another one is at 5 m for 2.8 s: below 5.5 m."""
    near = AlarmRule(name="near", target="it", condition=DistanceCondition(below=5.5, target="it"))
    plan = Plan(targets=("it",), rules=(near,), safety=Safety(good_frames=1))
    through, state, raised = ThroughLens(detector(networks["yolox"], every="0.2 s"), CAMERA), initial_state(plan), []
    for number in range(78):
        now_s = number / 10
        others = ((400, 100, 206),) if 30 <= number < 58 else ()
        sight = through.measure(at(now_s, (60, 150, 130), *others))
        stamp = FrameStamp(sequence=number, captured_at_s=now_s)
        state, decision = decide(state, Observation(now_s=now_s, frame=stamp, measurements=(sight,)))
        raised += [now_s for event in decision.events if event.kind is EventKind.RAISED]
    assert len(raised) == 1
    assert 3.0 <= raised[0] < 5.0


@pytest.mark.parametrize(
    ("options", "figure", "status", "border"),
    [
        ({}, (100, -60, 300), DetectionStatus.TRUNCATED, "top"),
        ({}, (100, 250, 300), DetectionStatus.TRUNCATED, "bottom"),
        ({}, (-40, 100, 250), DetectionStatus.FOUND, ""),
        ({"width": "50 cm"}, (-40, 100, 250), DetectionStatus.TRUNCATED, "left"),
        ({"width": "50 cm"}, (100, -60, 300), DetectionStatus.FOUND, ""),
    ],
)
def test_it_is_truncated_where_the_known_side_is_cut_off(
    networks: dict[str, Path], options: dict[str, str], figure: tuple[int, int, int], status: str, border: str
) -> None:
    it = detector(networks["yolox"], **options)
    found = it.detect(at(0, figure))
    assert found.status is status
    assert found.reason.endswith(f"is cut off by the {border} border" if border else "")
    if border:  # what is cut off is not followed: it would be taken for whole further inside
        assert it.detect(at(0.1, figure)).status is DetectionStatus.TRUNCATED


def test_a_box_of_which_the_network_is_less_sure_is_listed_with_its_score(networks: dict[str, Path]) -> None:
    found = detector(networks["yolox"], min_score=0.95).detect(at(0, (100, 150, 200)))
    assert found.reason == "no person: the likeliest box scores 0.90, limit 0.95"
    assert [each.reason for each in found.rejected] == ["scores 0.90, limit 0.95"]


@pytest.mark.parametrize("family", ["yolox", "yolov8", "nanodet"])
def test_only_the_class_that_is_asked_for_is_found(networks: dict[str, Path], family: str) -> None:
    frame = at(0, (100, 150, 200))
    assert detector(networks[family], **{"class": "dog"}).detect(frame).reason == "no dog"
    assert detector(networks[family], **{"class": "0"}).detect(frame).status is DetectionStatus.FOUND


def problems(model: Path | str, **options: Any) -> dict[str, str]:
    """Return what is wrong with options, by key."""
    table = {"model": str(model), "height": "1.7 m", **options}
    with pytest.raises(ValidationError) as raised:
        ObjectOptions.model_validate({key: value for key, value in table.items() if value})
    return {".".join(map(str, each["loc"])): each["msg"] for each in raised.value.errors()}


def test_what_is_wrong_is_said_at_its_key(networks: dict[str, Path], tmp_path: Path) -> None:
    text = tmp_path / "text.onnx"
    text.write_text("no network")
    yolox = networks["yolox"]
    assert "it is no ONNX file" in problems(text)["model"]
    assert "the family 5 and one for each class" not in str(problems(yolox, family="yolov8"))
    assert "rows for an input of 256x256" in problems(yolox, family="yolov8")["family"]
    assert (
        "'cat' is no class of this network; it has: person, dog, ball" in problems(yolox, **{"class": "cat"})["class"]
    )
    assert "17.2 m is not the height of a person" in problems(yolox, height="17.2 m")["height"]
    assert (
        "is not the distance of two pupils"
        in problems(networks["yunet"], height=None, eye_distance="63.4 cm ± 1 cm")["eye_distance"]
    )
    assert "spreads by 41%" in problems(yolox, height="1.72 m ± 70 cm")["height"]
    assert "height and width are given" in problems(yolox, width="50 cm")[""]
    assert "no size is given" in problems(yolox, height=None)[""]
    assert "yolox finds no eyes, yunet and centerface do" in problems(yolox, height=None, eye_distance="63 mm")[""]
    assert problems(yolox, box_sigma=0.9).keys() == {"box_sigma"}


def test_a_file_that_is_not_there_is_a_lack_and_an_error_of_the_first_picture(tmp_path: Path) -> None:
    options = ObjectOptions.model_validate({"model": str(tmp_path / "none.onnx"), "height": "1.7 m"})
    assert options.lacks() == (f"the model file {tmp_path / 'none.onnx'} is not there; a run would stop",)
    with pytest.raises(DriverError, match=r"the model of target 'it' cannot be used: .*there is no such file"):
        options.build(DriverContext(name="it", clock=ManualClock())).detect(at(0))


def test_every_cut_of_a_file_is_refused_or_read(networks: dict[str, Path]) -> None:
    data = networks["nanodet"].read_bytes()
    for length in (0, 1, 2, 10, 100, len(data) // 2, len(data) - 1):
        with pytest.raises(ValueError, match="it is no ONNX file, or is cut short"):
            parse_model(Path("x"), data[:length])


def test_a_file_too_large_and_one_of_two_inputs_are_refused(tmp_path: Path, networks: dict[str, Path]) -> None:
    large = tmp_path / "large.onnx"
    with large.open("wb") as file:
        file.truncate(MODEL_MAX_BYTES + 1)
    with pytest.raises(UnreadableError, match="larger than 60 MB"):
        load_model(large)
    import onnx

    model = onnx.load(networks["yolox"])
    model.graph.input.add().CopyFrom(onnx.helper.make_tensor_value_info("more", 1, (1, 3, 8, 8)))
    with pytest.raises(ValueError, match="its input is not one picture"):
        parse_model(Path("x"), model.SerializeToString())


@pytest.mark.parametrize("engine", ENGINES)
def test_a_network_that_an_engine_cannot_run_is_an_error_of_ours(tmp_path: Path, engine: str) -> None:
    if engine == "onnxruntime":
        pytest.importorskip("onnxruntime")
    import onnx

    model = onnx.load(write_network(tmp_path / "x.onnx", "yolox"))
    model.graph.node[0].op_type = "NoSuchThing"
    path = tmp_path / "odd.onnx"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(DriverError, match=rf"cannot run {path}"):
        detector(path, engine=engine).detect(at(0))


def test_a_file_whose_sizes_are_left_over_from_its_export_runs_at_any_size_in_both_engines(tmp_path: Path) -> None:
    """As that of CenterFace, which says 10 pictures of 32 px."""
    onnx = pytest.importorskip("onnx")
    value, shape = onnx.helper.make_tensor_value_info, (10, 3, 32, 32)
    maps = {"537": 1, "538": 2, "539": 2, "540": 10}
    nodes = [
        onnx.helper.make_node("Conv", ["images", f"w{name}"], [name], kernel_shape=[4, 4], strides=[4, 4])
        for name in maps
    ]
    weights = [
        onnx.numpy_helper.from_array(np.full((count, 3, 4, 4), 1e-6, np.float32), f"w{name}")
        for name, count in maps.items()
    ]
    outputs = [value(name, 1, (10, count, 8, 8)) for name, count in maps.items()]
    graph = onnx.helper.make_graph(nodes, "any", [value("images", 1, shape)], outputs, weights)
    path = tmp_path / "any.onnx"
    opset = [onnx.helper.make_opsetid("", 13)]
    path.write_bytes(onnx.helper.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString())
    report = examine(path)
    assert report.family == "centerface"
    assert [each.trouble for each in report.timings] == [""] * len(report.timings)


def test_names_of_classes_come_from_the_file_or_are_those_of_coco_or_numbers(tmp_path: Path) -> None:
    assert examine(write_network(tmp_path / "a.onnx", "yolov8")).classes == CLASSES
    assert examine(write_network(tmp_path / "b.onnx", "yolov8", is_named=False)).classes == ("0", "1", "2")
    many = examine(write_network(tmp_path / "c.onnx", "yolov8", [f"{n}" for n in range(80)], is_named=False)).classes
    assert (len(many), many[0], many[79]) == (80, "person", "toothbrush")
