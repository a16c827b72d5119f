from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from stadimeter.simulation.world import FaultKind, WorldOptions
from support.each_case import each_case


def read(**options: Any) -> WorldOptions:
    return WorldOptions.model_validate(options)


def test_a_world_needs_no_options() -> None:
    options = read()
    assert options.path
    assert options.faults == ()


def test_options_are_read_with_their_units() -> None:
    options = read(
        ball_diameter="8 in",
        robot_x="-50 cm",
        robot_heading="90 deg",
        path=[{"at": "0 s", "x": "-2 m", "y": "3 ft"}],
        faults=[{"at": "1 min", "for": "500 ms", "kind": "freeze-camera"}],
    )
    assert options.ball_diameter == pytest.approx(0.2032)
    assert options.robot_x == -0.5
    assert options.robot_heading == pytest.approx(1.5707963)
    assert (options.path[0].x, options.path[0].y) == pytest.approx((-2.0, 0.9144))
    fault = options.faults[0]
    assert (fault.at, fault.duration, fault.kind) == (60.0, 0.5, FaultKind.FREEZE_CAMERA)


@each_case(
    ("options", "words"),
    [
        ({"path": []}, "at least 1 item"),
        ({"path": [{"at": "1 s", "x": "1 m", "y": "0 m"}]}, "first way point must be at '0 s'"),
        (
            {"loop": False, "path": [{"at": at, "x": "1 m", "y": "0 m"} for at in ("0 s", "2 s", "2 s")]},
            "order them by time",
        ),
        (
            {"path": [{"at": "0 s", "x": "1 m", "y": "0 m"}, {"at": "2 s", "x": "2 m", "y": "0 m"}]},
            "end it where it begins, or set loop = false",
        ),
        ({"robot_x": "3"}, "has no unit"),
        ({"robot_x": 3}, "has no unit"),
        ({"robot_y": "1 parsec"}, "unknown unit 'parsec'"),
        ({"ball_diameter": "0 cm"}, "not a length above zero"),
        ({"ball_height": "-1 cm"}, "below zero"),
        ({"track_width": "-20 cm"}, "not a length above zero"),
        ({"ticks_per_metre": 0}, "greater than 0"),
        ({"seed": -1}, "greater than or equal to 0"),
        ({"faults": [{"at": "1 s", "kind": "flat-tyre"}]}, "'hide-target', 'freeze-camera'"),
        ({"faults": [{"at": "1 s", "duration": "1 s", "kind": "hide-target"}]}, "Extra inputs"),
        ({"balls": 2}, "Extra inputs"),
    ],
)
def test_a_wrong_option_is_refused_in_words(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError) as raised:
        read(**options)
    assert words in str(raised.value)
