"""What ``measure --explain`` says."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from msgspec.structs import replace

from stadimeter.cli.formatting import FOOT, METRE
from stadimeter.cli.measure_output import Printer, explanation, explanation_record, marks_of
from stadimeter.core.detection import Detection, DetectionStatus, RejectedCandidate
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.ranging.measure import SigmaParts
from stadimeter.workbench.measuring import PictureResult, TargetResult

DOOR = RejectedCandidate(centre_px=(120.4, 340.0), size_px=88.2, reason="edge scatters by 2.1 px, limit 1.0 px")
LAMP = RejectedCandidate(centre_px=(9.0, 8.0), size_px=7.0, reason="7.0 px wide, limit 12 px")

MEASURED = Measurement(
    target="paper",
    status=MeasurementStatus.MEASURED,
    captured_at_s=0.0,
    distance_m=2.0,
    depth_m=2.0,
    sigma_m=0.025,
    noise_m=0.0006,
    bearing_rad=0.0,
    elevation_rad=0.0,
    tilt_rad=math.radians(14),
    ambiguity=0.12,
)
FOUND = Detection(
    target="paper",
    status=DetectionStatus.FOUND,
    outline_px=np.array([(210.0, 155.0), (429.0, 155.0), (429.0, 324.0), (210.0, 324.0)]),
    centre_px=(319.5, 239.5),
    width_px=219.0,
    height_px=169.0,
    size_sigma_px=0.043,
    quality=0.98,
)
PARTS = SigmaParts(edges_m=0.0006, focal_length_m=0.024, size_m=0.0, pose_m=0.007)


def result(
    measured: Measurement = MEASURED, found: Detection | None = FOUND, parts: SigmaParts | None = PARTS, first: int = 1
) -> TargetResult:
    return TargetResult(file="a.png", measurement=measured, detection=found, parts=parts, rejected_from=first)


def not_found(*rejected: RejectedCandidate) -> TargetResult:
    reason = "no sheet among 2 outlines"
    return result(
        Measurement(target="paper", status=MeasurementStatus.NOT_FOUND, captured_at_s=0.0, reason=reason),
        Detection(target="paper", status=DetectionStatus.NOT_FOUND, reason=reason, rejected=rejected),
        None,
    )


def test_a_target_that_was_found_is_explained_line_by_line() -> None:
    assert explanation(result(found=replace(FOUND, rejected=(DOOR, LAMP)), first=9)) == [
        "    seen       219.00 x 169.00 px ± 0.04 at 319.5, 239.5, quality 0.98",
        "    tilt       tilted 14°, ambiguity 0.12",
        (
            "    sigma      1.25 % of the distance: edges 0.030 %, focal length 1.20 %, size taken as exact, "
            "which way it is tilted 0.35 %"
        ),
        "    rejected    9  88 px at 120, 340  edge scatters by 2.1 px, limit 1.0 px",
        "               10  7 px at 9, 8       7.0 px wide, limit 12 px",
    ]


def test_what_is_perhaps_the_target_has_its_distance_and_the_doubt_in_one_line(capsys: Any) -> None:
    doubted = result(replace(MEASURED, status=MeasurementStatus.PERHAPS, reason="a pale rim"))
    doubted = replace(doubted, detection=replace(FOUND, status=DetectionStatus.PERHAPS, reason="a pale rim"))
    printer = Printer(as_json=False, explain=False, unit=FOOT, file_width=5, target_width=5)
    printer.result(doubted)
    assert capsys.readouterr().out == "a.png  paper  perhaps 6.56 ft ± 0.08  2.00 m ± 0.03: a pale rim\n"
    (mark,) = marks_of(PictureResult(file="a.png", frame=None, targets=(doubted,)), METRE)
    assert mark.headline == "paper: perhaps 2.00 m ± 0.03"
    assert mark.lines[-1] == "perhaps: a pale rim"


def test_json_has_the_outline_and_says_what_is_only_perhaps_the_target() -> None:
    assert result().record()["perhaps"] is False
    record = result(replace(MEASURED, status=MeasurementStatus.PERHAPS)).record()
    assert (record["status"], record["perhaps"]) == ("measured", True)
    assert record["outline_px"] == [[210.0, 155.0], [429.0, 155.0], [429.0, 324.0], [210.0, 324.0]]
    assert json.loads(json.dumps(not_found().record()))["outline_px"] == []


def test_a_tilt_that_may_as_well_be_the_other_way_is_said() -> None:
    lines = explanation(result(replace(MEASURED, ambiguity=0.93)))
    assert "tilted 14°, or mirrored: both explain the picture nearly alike (ambiguity 0.93, 1 is no idea)" in lines[1]


def test_a_target_that_was_not_found_has_only_what_was_rejected() -> None:
    assert explanation(not_found(DOOR)) == [
        "    rejected   1  88 px at 120, 340  edge scatters by 2.1 px, limit 1.0 px"
    ]


def test_a_picture_in_which_nothing_was_looked_at_says_so() -> None:
    assert explanation(not_found()) == ["    rejected   nothing was looked at"]
    assert explanation(result())[-1] == "    rejected   nothing else was looked at"


def test_the_fields_for_programs_say_the_same() -> None:
    record = explanation_record(result(found=replace(FOUND, rejected=(DOOR,)), first=4))
    assert json.loads(json.dumps(record)) == {
        "remark": "",
        "centre_px": [319.5, 239.5],
        "width_px": 219.0,
        "height_px": 169.0,
        "size_sigma_px": 0.043,
        "quality": 0.98,
        "sigma_edges_m": 0.0006,
        "sigma_focal_length_m": 0.024,
        "sigma_size_m": 0.0,
        "sigma_pose_m": 0.007,
        "floor_distance_m": None,
        "floor_sigma_m": None,
        "floor_apart_sigmas": None,
        "rejected": [{"number": 4, "centre_px": [120.4, 340.0], "size_px": 88.2, "reason": DOOR.reason}],
    }


def test_a_figure_that_is_no_number_is_null_for_programs() -> None:
    broken = replace(FOUND, size_sigma_px=math.inf, rejected=(replace(DOOR, size_px=math.nan),))
    record = explanation_record(result(found=broken))
    assert record["size_sigma_px"] is None
    json.dumps(record, allow_nan=False)
