"""Editing a configuration: its text, what `check` finds in it while it is typed, saving, and its versions.

A text is checked as if it stood at the place of the configuration. Nothing is written before it is saved.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from stadimeter.app.control.client import HELLO_WAIT_S, ask
from stadimeter.app.control.reloading import needs_restart
from stadimeter.app.exact_json import plain
from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.this_computer import warnings_here
from stadimeter.config.describe import describe
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, read_untrusted_text, sha256_of
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.toml_source import Texts
from stadimeter.config.units import path_from
from stadimeter.errors import ChangedMeanwhileError, ConfigError, ControlError, Problem, UnreadableError
from stadimeter.workbench.rule_tests import run_rule_test
from stadimeter.workbench.saving import check_is_not_ours, files_of, save_files, versions
from stadimeter.workbench.server.operations import Desk, operation
from stadimeter.workbench.server.run_of_desk import run_socket

# No test of a configuration begins later than this: whoever asks waits, and so do all others.
TESTS_MAX_S = 20.0


@operation
def configuration(desk: Desk) -> dict[str, Any]:
    """Answer the text of the configuration as it is saved, its version, and the former ones."""
    saved = saved_text(desk)
    return {
        "text": saved or "",
        "version": version_of(saved),
        "path": str(desk.configuration),
        "exists": saved is not None,
        "versions": [{"id": each.id, "unix_s": each.unix_s} for each in versions(desk.configuration)],
    }


@operation
def check(desk: Desk, text: str, files: dict[str, str] | None = None, *, tests: bool = False) -> dict[str, Any]:
    """Answer what is wrong with a text and what it does in words; with ``tests``, what its tests come to."""
    try:
        found = load_text(desk, text, files)
    except ConfigError as error:
        return {"problems": _list_problems(error.problems, "error"), "words": [], "tests": []}
    warnings = (*found.warnings, *feasibility_warnings(found), *warnings_here(found))
    return {
        "problems": _list_problems(warnings, "warning"),
        "words": list(describe(found)),
        "tests": list(_run_tests(found)) if tests else [],
    }


@operation
def save(
    desk: Desk, text: str, files: dict[str, str] | None = None, base_version: str = "", *, even_if_wrong: bool = False
) -> dict[str, Any]:
    """Save a text, and files such as the camera file with it; keep what was there."""
    typed = text.replace("\r\n", "\n")
    if not even_if_wrong:
        load_text(desk, typed, files)
    return _save(desk, {**(files or {}), desk.configuration.name: typed}, base_version)


@operation
def version(desk: Desk, id_: str) -> dict[str, Any]:
    """Answer the text of a former version."""
    return {"id": id_, "text": files_of(desk.configuration, id_)[desk.configuration.name]}


@operation
def restore(desk: Desk, id_: str, base_version: str = "") -> dict[str, Any]:
    """Bring a former version back, with the files that were saved with it; what it replaces is kept in turn."""
    return _save(desk, files_of(desk.configuration, id_), base_version)


def saved_text(desk: Desk) -> str | None:
    """Return the text of the configuration; None if there is none.

    Raises:
        UnreadableError: It cannot be read.
    """
    try:
        return read_untrusted_text(desk.configuration, CONFIGURATION_MAX_BYTES)
    except UnreadableError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise


def version_of(saved: str | None) -> str:
    """Return a fingerprint that tells one text from another; empty where there is none."""
    return "" if saved is None else sha256_of(saved)


def load_text(desk: Desk, text: str, files: dict[str, str] | None = None) -> Configuration:
    """Load the configuration that a text makes at the configuration's place; `ConfigError` for one that cannot be used.

    Args:
        files: The texts of files that are looked at, or saved, with it, by their names.
    """
    return load_configuration(desk.configuration, texts=_texts(desk, text, files or {}))


def _texts(desk: Desk, text: str, files: Mapping[str, str]) -> Texts:
    place = desk.configuration
    return {**{path_from(place.parent, name): each for name, each in files.items()}, place: text}


def _list_problems(problems: tuple[Problem, ...], severity: str) -> list[dict[str, Any]]:
    return [{**plain(problem), "severity": severity} for problem in sorted(problems, key=lambda each: each.line)]


def _run_tests(found: Configuration) -> Iterator[dict[str, Any]]:
    until_s = time.monotonic() + TESTS_MAX_S
    for test in found.tests:
        is_passed, words = None, f"not run: the tests before it took {TESTS_MAX_S:g} s; `stadimeter test` runs all"
        if time.monotonic() < until_s:
            done = run_rule_test(found, test)
            trouble = [f"it could not be run: {done.trouble}"] if done.trouble else []
            failed = [f"{each.subject}.{each.key}: expected {each.expected}, got {each.got}" for each in done.failures]
            is_passed, words = done.passed, "; ".join([*trouble, *failed])
        yield {"name": test.name, "line": test.line, "ok": is_passed, "words": words}


def _save(desk: Desk, files: Mapping[str, str], base_version: str) -> dict[str, Any]:
    place = desk.configuration
    check_is_not_ours(place)
    needs = _find_need(desk, files)
    _, kept = save_files(place.parent, files, lambda: refuse_if_changed(desk, base_version, files[place.name]))
    return {"version": version_of(files[place.name]), "kept": kept.name if kept else None, "needs": needs}


def refuse_if_changed(desk: Desk, base_version: str, ours: str) -> None:
    """Raise `ChangedMeanwhileError` if another has saved since a version, and not the same text."""
    theirs = saved_text(desk)
    if version_of(theirs) == base_version or theirs == ours:
        return
    if theirs is None:
        raise ChangedMeanwhileError(f"{desk.configuration} is not there any more; save again to write it anew")
    raise ChangedMeanwhileError(f"{desk.configuration} was changed by another since you read it; nothing was saved")


def _find_need(desk: Desk, files: Mapping[str, str]) -> str:
    """Find what it takes that a run goes by these files: ``nothing``, ``reload``, ``restart``, or a ``start``."""
    try:
        digest = ask(run_socket(desk), "hello", wait_s=HELLO_WAIT_S).get("digest")
    except ControlError:
        return "start"
    place = desk.configuration
    new = _load_or_none(place, _texts(desk, files[place.name], files))
    saved = _load_or_none(place, {})
    if new is None or saved is None or sha256_of(saved.text) != digest or needs_restart(saved, new):
        return "restart"
    return "nothing" if sha256_of(new.text) == digest else "reload"


def _load_or_none(place: Path, texts: Texts) -> Configuration | None:
    try:
        return load_configuration(place, texts=texts)
    except ConfigError:
        return None
