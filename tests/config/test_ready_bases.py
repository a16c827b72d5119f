"""The bases that the example of a robot has ready, each behind ``#``, beside the one that it uses."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import BASES, driver_names
from stadimeter.errors import ConfigError
from support.ready_bases import FOLLOW_BALL, READY, follow_ball


@pytest.mark.parametrize("driver", READY)
def test_a_base_that_is_ready_takes_the_place_of_the_one_that_is_used(tmp_path: Path, driver: str) -> None:
    path = tmp_path / "follow.toml"
    path.write_text(follow_ball(driver), encoding="utf-8")
    base = load_configuration(path).base
    assert base is not None
    assert base.driver == driver


def test_the_example_has_every_base_ready_that_is_one_board() -> None:
    """A protocol of one's own has no usual lines, a bridge to ROS is another program's, and a servo drives nowhere."""
    others = {"simulated", "ascii", "pan-servo", *(name for name in driver_names(BASES) if name.startswith("ros2"))}
    assert set(READY) == set(driver_names(BASES)) - others


def test_a_table_for_each_of_several_bases_is_refused_with_what_to_write(tmp_path: Path) -> None:
    path = tmp_path / "follow.toml"
    path.write_text(f'{FOLLOW_BALL}[base.pca9685]\nboard = "jetbot"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"unknown key 'pca9685' \(write its keys in \[base\] itself"):
        load_configuration(path)
