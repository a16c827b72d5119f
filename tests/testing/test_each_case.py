from __future__ import annotations

import pytest

from support.each_case import each_case


def test_every_case_is_run_and_those_that_fail_are_named() -> None:
    seen = []

    @each_case(("number", "unit"), [(1, "m"), pytest.param(2, "s", id="seconds"), (3, "V")])
    @each_case("sign", [1, -1], ids=["plus", "minus"])
    def every_case_is_in_metres(number: int, unit: str, sign: int) -> None:
        seen.append((number, unit, sign))
        if unit == "V":
            pytest.fail("volts")
        assert unit == "m" or sign > 0

    with pytest.raises(BaseExceptionGroup, match="2 of 3 cases fail") as failed:
        every_case_is_in_metres()
    assert seen == [(1, "m", 1), (1, "m", -1), (2, "s", 1), (2, "s", -1), (3, "V", 1), (3, "V", -1)]
    seconds, volts = failed.value.exceptions
    assert seconds.__notes__ == ["case seconds: {'number': 2, 'unit': 's'}"]
    assert [error.__notes__ for error in seconds.exceptions] == [["case minus: {'sign': -1}"]]
    assert len(volts.exceptions) == 2


def test_what_is_no_case_stays_a_fixture(tmp_path_factory: pytest.TempPathFactory) -> None:
    @each_case("number", [1, 2])
    def positive(number: int, folder: object) -> None:
        assert number > 0
        assert folder is tmp_path_factory

    positive(folder=tmp_path_factory)
