"""One frame that is grossly wrong raises nothing, also near the camera, where noise is far smaller than the error."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.rule_tests.running import run_rule_test
from support.simulated_run import SIMULATED_BALL

STANDING = """
[world]
ball_diameter = "6.4 cm"

[rules.near]
actuator = "motor"
severity = "{severity}"
when = {{ below = "50 cm" }}

[[tests]]
input = {{ hover = {{ at = "{distance}", for = "60 s" }}, dropouts = 0.05, outliers = 0.01 }}
expect.near = {{ raised = 0 }}
"""


@pytest.mark.long
@pytest.mark.parametrize("severity", ["warning", "safety"])
@pytest.mark.parametrize("distance", ["51 cm", "52 cm", "55 cm"])
def test_a_ball_that_stands_just_outside_is_not_taken_for_one_that_comes_in(
    distance: str, severity: str, tmp_path: Path
) -> None:
    file = tmp_path / "standing.toml"
    file.write_text(SIMULATED_BALL + STANDING.format(distance=distance, severity=severity), encoding="utf-8")
    configuration = load_configuration(file)
    (test,) = configuration.tests
    for seed in range(201, 203):
        seeded = replace(test, input=test.input.model_copy(update={"seed": seed}))
        assert run_rule_test(configuration, seeded).failures == ()
