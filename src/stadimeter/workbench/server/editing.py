"""Editing a configuration: its text, what `check` finds in it while it is typed, saving, and its versions.

A text is checked as if it stood at the place of the configuration. Nothing is written before it is saved.
"""

from __future__ import annotations

import difflib
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from stadimeter.app.control.client import HELLO_WAIT_S, ask, find
from stadimeter.app.control.reloading import needs_restart
from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.recordings.recorded_configuration import sha256_of
from stadimeter.app.this_computer import warnings_here
from stadimeter.config.describe import describe
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.rule_test_tables import RuleTest
from stadimeter.config.toml_source import Texts
from stadimeter.config.units import path_from
from stadimeter.config.untrusted_file import CONFIGURATION_MAX_BYTES, read_untrusted_text
from stadimeter.errors import ChangedMeanwhileError, ConfigError, ControlError, Problem, UnreadableError
from stadimeter.workbench.rule_tests.running import RuleTestResult, RuleTests
from stadimeter.workbench.saving import check_is_not_ours, difference_in_words, files_of, save_files, versions
from stadimeter.workbench.server.arguments import get_bool, get_text
from stadimeter.workbench.server.operations import Desk, DeskReply, operation

# No test of a configuration begins later than this: whoever asks waits, and so do all others.
TESTS_MAX_S = 20.0

# A person reads the first of them.
DIFF_LINES_MAX = 400


@operation
def configuration(desk: Desk, _args: Mapping[str, Any]) -> DeskReply:
    """Answer the text of the configuration as it is saved, its version, and the former ones."""
    saved = saved_text(desk)
    return DeskReply(
        data={
            "text": saved or "",
            "version": version_of(saved),
            "path": str(desk.configuration),
            "exists": saved is not None,
            "versions": _versions(desk, saved or ""),
        }
    )


@operation
def check(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Answer what is wrong with a text and what it does in words; with ``tests``, what its tests come to."""
    typed, files, with_tests = _text(args), files_with(args), get_bool(args, "tests")
    return DeskReply(data=_checked(desk, typed, files, with_tests=with_tests))


@operation
def save(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Save a text, and files such as the camera file with it; keep what was there."""
    typed, files = _text(args), files_with(args)
    if not get_bool(args, "even_if_wrong"):
        loaded(desk, typed, files)
    return _saved(desk, {**files, desk.configuration.name: typed}, args)


@operation
def version(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Answer the text of a former version."""
    wanted = get_text(args, "id")
    return DeskReply(data={"id": wanted, "text": files_of(desk.configuration, wanted)[desk.configuration.name]})


@operation
def restore(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Bring a former version back, with the files that were saved with it; what it replaces is kept in turn."""
    return _saved(desk, files_of(desk.configuration, get_text(args, "id")), args)


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
    """Return what tells one text from another; empty where there is none."""
    return "" if saved is None else sha256_of(saved)


def loaded(desk: Desk, text: str, files: Mapping[str, str]) -> Configuration:
    """Return what a text comes to at the place of the configuration; `ConfigError` for one that cannot be used."""
    return load_configuration(desk.configuration, texts=_texts(desk, text, files))


def _texts(desk: Desk, text: str, files: Mapping[str, str]) -> Texts:
    place = desk.configuration
    return {**{path_from(place.parent, name): each for name, each in files.items()}, place: text}


def _text(args: Mapping[str, Any]) -> str:
    return _writable(get_text(args, "text")).replace("\r\n", "\n")


def _writable(words: str) -> str:
    """Return a text that a file can hold; half of a surrogate pair, which JSON can write, is none."""
    try:
        words.encode()
    except UnicodeEncodeError as error:
        raise ConfigError("the text holds half of a character, which no file can have") from error
    return words


def files_with(args: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts of files that are looked at, or saved, with a configuration."""
    files = args.get("files") or {}
    if not isinstance(files, Mapping) or not all(isinstance(each, str) for pair in files.items() for each in pair):
        raise ConfigError("the files beside a configuration are texts, by their names")
    return {name: _writable(each) for name, each in files.items()}


def _checked(desk: Desk, text: str, files: Mapping[str, str], *, with_tests: bool) -> dict[str, Any]:
    try:
        found = loaded(desk, text, files)
    except ConfigError as error:
        return {"problems": _listed(error.problems, error.warnings), "words": [], "rules": [], "tests": []}
    warnings = (*found.warnings, *feasibility_warnings(found), *warnings_here(found))
    return {
        "problems": _listed((), warnings),
        "words": list(describe(found)),
        "rules": _rule_lines(found),
        "tests": _tested(found) if with_tests else [],
    }


def _listed(errors: tuple[Problem, ...], warnings: tuple[Problem, ...]) -> list[dict[str, Any]]:
    found = [("error", each) for each in errors] + [("warning", each) for each in warnings]
    return [
        {**asdict(problem), "severity": severity} for severity, problem in sorted(found, key=lambda each: each[1].line)
    ]


def _rule_lines(found: Configuration) -> list[dict[str, Any]]:
    return [{"rule": rule.name, "line": found.spans["rules", rule.name].line} for rule in found.plan.rules]


def _tested(found: Configuration) -> list[dict[str, Any]]:
    tests, until_s = RuleTests(found), time.monotonic() + TESTS_MAX_S
    return [_test_result(tests.run(test)) if time.monotonic() < until_s else _left_out(test) for test in found.tests]


def _left_out(test: RuleTest) -> dict[str, Any]:
    words = f"not run: the tests before it took {TESTS_MAX_S:g} s; `stadimeter test` runs all"
    return {"name": test.name, "line": test.line, "ok": None, "words": words}


def _test_result(result: RuleTestResult) -> dict[str, Any]:
    words = [f"{each.subject}.{each.key}: expected {each.expected}, got {each.got}" for each in result.failures]
    trouble = [f"it could not be run: {result.trouble}"] if result.trouble else []
    return {
        "name": result.test.name,
        "line": result.test.line,
        "ok": result.passed,
        "words": "; ".join([*trouble, *words]),
    }


def _saved(desk: Desk, files: Mapping[str, str], args: Mapping[str, Any]) -> DeskReply:
    place = desk.configuration
    check_is_not_ours(place)
    needs = _needed(desk, files)
    base = get_text(args, "base_version", "")
    _, kept = save_files(place.parent, files, lambda: _refuse_if_changed(desk, base, files[place.name]))
    data = {"version": version_of(files[place.name]), "kept": kept.name if kept else None, "needs": needs}
    return DeskReply(data=data)


def _refuse_if_changed(desk: Desk, base_version: str, ours: str) -> None:
    theirs = saved_text(desk)
    if version_of(theirs) == base_version or theirs == ours:
        return
    if theirs is None:
        raise ChangedMeanwhileError(f"{desk.configuration} is not there any more; save again to write it anew", "", [])
    words = f"{desk.configuration} was changed by another since you read it; nothing was saved"
    raise ChangedMeanwhileError(words, theirs, _diff(theirs, ours))


def _diff(theirs: str, ours: str) -> list[str]:
    """Return what saving ours would change in theirs, in the unified format."""
    lines = difflib.unified_diff(theirs.split("\n"), ours.split("\n"), "saved meanwhile", "yours", lineterm="")
    found = list(lines)
    left = len(found) - DIFF_LINES_MAX
    return [*found[:DIFF_LINES_MAX], *([f"… and {left} more lines"] if left > 0 else [])]


def _versions(desk: Desk, text: str) -> list[dict[str, Any]]:
    told, later = [], text
    for each in versions(desk.configuration):
        try:
            former = read_untrusted_text(each.folder / desk.configuration.name, CONFIGURATION_MAX_BYTES)
        except UnreadableError as error:
            words = f"it cannot be read: {error.reason}"
        else:
            words, later = difference_in_words(former, later), former
        told.append({"id": each.id, "unix_s": each.unix_s, "words": words})
    return told


def _needed(desk: Desk, files: Mapping[str, str]) -> str:
    """Return what it takes that a run goes by these files: ``nothing``, ``reload``, ``restart``, or a ``start``."""
    try:
        digest = ask(run_socket(desk), "hello", wait_s=HELLO_WAIT_S).get("digest")
    except ControlError:
        return "start"
    new = _load_or_none(desk.configuration, _texts(desk, files[desk.configuration.name], files))
    running = _running(desk, digest)
    if new is None or running is None or needs_restart(running, new):
        return "restart"
    return "nothing" if sha256_of(new.text) == digest else "reload"


def run_socket(desk: Desk) -> Path:
    """Return where the run of this configuration listens; `ControlError` if there is none."""
    return desk.run_socket or find(desk.configuration, names_others=False)


def _running(desk: Desk, digest: object) -> Configuration | None:
    """Return the configuration that the run goes by: of the texts that are there, the one with its digest."""
    place = desk.configuration
    for path in (place, *(each.folder / place.name for each in versions(place))):
        try:
            text = read_untrusted_text(path, CONFIGURATION_MAX_BYTES)
        except UnreadableError:
            continue
        found = _load_or_none(place, {place: text})
        if found is not None and sha256_of(found.text) == digest:
            return found
    return None


def _load_or_none(place: Path, texts: Texts) -> Configuration | None:
    try:
        return load_configuration(place, texts=texts)
    except ConfigError:
        return None
