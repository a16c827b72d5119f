"""The command ``test``: the tests that a configuration carries."""

from __future__ import annotations

import fnmatch
import json
from collections.abc import Iterator, Sequence
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from stadimeter.app.exact_json import plain
from stadimeter.cli.check import prose_console
from stadimeter.cli.exits import NOT_FOUND, WRONG, ConfigArgument, configuration_path, plain_errors, working
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.rule_test_tables import RuleTest
from stadimeter.core.words import counted
from stadimeter.workbench.rule_tests import Failure, RuleTestResult, run_rule_test

_EXAMPLE = """\
[[tests]]
name = "hover does not chatter"
input = { hover = { at = "50 cm", for = "60 s" } }
expect.RULE = { transitions_max = 2 }"""


def run_tests(
    config: ConfigArgument = None,
    name: Annotated[
        str, typer.Option("--name", metavar="PATTERN", help="Only tests whose name holds this; * stands for anything.")
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print the events of each test too.")] = False,
) -> None:
    """Run the tests of a configuration. Nothing is opened and nothing moves.

    A test says in `[[tests]]` what the target does and what is expected of rules and outputs. The distances are made
    up, with the noise that the camera and the target are expected to have, or come from a recording. The rules are the
    ones that a run follows, to the last bit, and the same test always gives the same result.

    **Example**

    - `stadimeter test config/distance-alert.toml --name chatter`

    **Exit code**: 0 all passed, or there are none; 1 a test failed; 2 the configuration is wrong, or no test has that
    name.
    """
    with plain_errors():
        configuration = load_configuration(configuration_path(config))
    chosen = [test for test in configuration.tests if _is_meant(test.name, name)]
    if name and not chosen:
        _nothing_of_that_name(configuration, name)
    results: list[RuleTestResult] = []
    console = prose_console()
    for test in chosen:
        with working(f"testing: {test.name}"):
            result = run_rule_test(configuration, test)
        results.append(result)
        if not as_json:
            _tell(console, configuration, result, verbose=verbose)
    if as_json:
        typer.echo(json.dumps(_figures(results), ensure_ascii=False))
    else:
        _sum_up(console, configuration, results)
    if not all(result.passed for result in results):
        raise typer.Exit(NOT_FOUND)


def _is_meant(name: str, pattern: str) -> bool:
    return fnmatch.fnmatchcase(name.lower(), f"*{pattern.lower()}*")


def _nothing_of_that_name(configuration: Configuration, name: str) -> None:
    names = ", ".join(f"'{test.name}'" for test in configuration.tests) or "none at all"
    typer.echo(f"error: {configuration.path} has no test whose name holds '{name}'; there are: {names}", err=True)
    raise typer.Exit(WRONG)


def _tell(console: Console, configuration: Configuration, result: RuleTestResult, *, verbose: bool) -> None:
    mark = ("passed", "bold green") if result.passed else ("FAILED", "bold red")
    took = f"  {result.took_s:.1f} s, {result.cycles} cycles" if result.cycles else ""
    console.print(Text.assemble(mark, "  ", result.test.name, (took, "dim")))
    if not result.passed:
        console.print(Text(f"        {configuration.path}:{result.test.line}", "bold"))
    if result.trouble:
        console.print(Text(f"        it could not be run: {result.trouble}"))
    for failure in result.failures:
        for line in _lines(failure):
            console.print(line)
    if verbose:
        for at_s, event in result.events:
            words = f"{at_s:9.2f} s  {event.kind.value:<16} {event.source:<16} {event.reason}"
            console.print(Text(words, "dim"))


def _lines(failure: Failure) -> Iterator[Text]:
    yield Text.assemble("        ", (f"{failure.subject}.{failure.key}", "cyan"))
    yield Text.assemble(("          expected  ", "dim"), failure.expected)
    yield Text.assemble(("          got       ", "dim"), failure.got)
    if failure.why:
        yield Text.assemble(("          why       ", "dim"), f"at {failure.at_s:.2f} s: {failure.why}")


def _sum_up(console: Console, configuration: Configuration, results: Sequence[RuleTestResult]) -> None:
    if not results:
        console.print(f"{configuration.path} has no tests. One looks like this:\n\n{_EXAMPLE}", markup=False)
        return
    failed = sum(not result.passed for result in results)
    words = f"{counted(len(results), 'test')}: {len(results) - failed} passed" + (
        f", {failed} failed" if failed else ""
    )
    console.print(Text(words, "bold red" if failed else "bold green"))


def _figures(results: Sequence[RuleTestResult]) -> dict[str, object]:
    return {
        "passed": sum(result.passed for result in results),
        "failed": sum(not result.passed for result in results),
        "tests": [_record(result) for result in results],
    }


def _record(result: RuleTestResult) -> dict[str, object]:
    test: RuleTest = result.test
    return {
        "name": test.name,
        "line": test.line,
        "passed": result.passed,
        "trouble": result.trouble,
        "failures": [plain(failure) for failure in result.failures],
        "took_s": result.took_s,
        "cycles": result.cycles,
        "events": [{**plain(event), "at_s": at_s} for at_s, event in result.events],
    }
