"""Many quick cases of one test in one go."""

from __future__ import annotations

import functools
import inspect
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pytest


def each_case(
    names: str | Sequence[str], cases: Iterable[Any], ids: Sequence[str] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test for every case, as `pytest.mark.parametrize` does, but as one test.

    For cases that need nothing of their own set up or cleaned away, and take less time than pytest does about a test.
    Every case is run; those that fail are raised together, each with a note that names it.
    """
    named = [name.strip() for name in names.split(",")] if isinstance(names, str) else list(names)
    rows = [_values_and_id(case, len(named) == 1) for case in cases]
    assert rows, "a test without cases cannot fail"

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def run_all(**fixtures: Any) -> None:
            failures = []
            for number, (values, own_id) in enumerate(rows):
                given = dict(zip(named, values, strict=True))
                try:
                    test(**fixtures, **given)
                except (Exception, pytest.fail.Exception, BaseExceptionGroup) as error:  # noqa: BLE001 - raised below, with the others
                    label = ids[number] if ids else own_id or str(number)
                    error.add_note(f"case {label}: {textwrap.shorten(repr(given), 400)}")
                    failures.append(error)
            if failures:
                raise BaseExceptionGroup(f"{len(failures)} of {len(rows)} cases fail", failures)

        signature = inspect.signature(test)
        left = [parameter for name, parameter in signature.parameters.items() if name not in named]
        run_all.__signature__ = signature.replace(parameters=left)  # type: ignore[attr-defined]
        return run_all

    return decorate


def _values_and_id(case: Any, is_single: bool) -> tuple[Sequence[Any], str | None]:
    """Return the values of a case, and the name that it was given with `pytest.param`, if any."""
    if hasattr(case, "values") and hasattr(case, "marks"):
        assert not case.marks, "a case of several in one test cannot bear marks"
        return case.values, case.id
    return ((case,) if is_single else case), None
