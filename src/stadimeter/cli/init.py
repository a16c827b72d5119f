"""The command ``init``: a camera file and a configuration from questions and answers."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from stadimeter.app.detectors import build_detectors
from stadimeter.cli.check import check
from stadimeter.cli.exits import DONE, NOT_FOUND, plain_errors, say_note
from stadimeter.cli.formatting import METRE, format_distance
from stadimeter.cli.print_target import wiring
from stadimeter.cli.test_rules import run_tests
from stadimeter.config.addresses import address_for_people
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.measuring import Measuring
from stadimeter.workbench.saving import VERSIONS
from stadimeter.workbench.setup.interview import (
    ANSWERS,
    Interview,
    answer_all,
    check_keys,
    load_answers,
    load_example,
    was_left,
    write_files,
)
from stadimeter.workbench.setup.question import CONFIGURATION, PICTURES, Accepted, Known, Question
from stadimeter.workbench.setup.recipe_steps import configuration_files
from stadimeter.workbench.wiring import find_outputs, parts_of

BACK = "back"
WIRING = f"{PICTURES}/wiring.svg"


def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where the files will be; here unless given.")] = (
        Path()
    ),
    answers: Annotated[
        Path | None,
        typer.Option("--answers", metavar="FILE", help="Take the answers from this TOML file, and ask nothing."),
    ] = None,
    example: Annotated[
        str,
        typer.Option(
            "--example", metavar="NAME", help="Write an example: distance-alert, follow-ball, appliance or demo."
        ),
    ] = "",
) -> None:
    """Write your first configuration, one question at a time.

    Shows what it found, and has an answer ready, in brackets, which Enter takes. What is sure, such as the only camera,
    is shown and not asked. `back` goes back to what was answered or shown last. Ctrl-C leaves; each answer is saved
    as it is given, and `stadimeter init` in the same folder goes on from there.

    Writes a camera file, a configuration with two tests for each thing that shall happen, and pictures of what was
    found, in the folder init. Then it checks the configuration, runs its tests, and names the next three commands. A
    file that is there already is kept in the folder versions.

    With --example it asks nothing either, and writes a configuration that shows one of the three uses, for you to edit.

    With --answers it asks nothing: each question takes its answer from the file, or else the one that is ready.
    docs/reference/setup-answers.md lists the keys. The file that a session has left, init-answers.toml, is such a file.

    **Examples**

    - `stadimeter init`

    - `stadimeter init garage`

    - `stadimeter init garage --answers answers.toml`

    - `stadimeter init --example follow-ball`

    **Exit code**: 0 the configuration can be used and its tests pass; 1 you left before the end, the target is not
    in the last picture, or a test failed; 2 an answer or a file is wrong, or there is no terminal.
    """
    console = Console(highlight=False)
    with plain_errors():
        if answers and example:
            raise ConfigError("--answers and --example exclude each other")
        if example:
            for words in write_files(folder, {f"{example}.toml": load_example(example)}):
                typer.echo(words)
            return
        if answers is None and not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise ConfigError(
                "init asks questions, and there is no terminal here; give the answers with --answers FILE, such as "
                'camera = "ball.jpg" (docs/reference/setup-answers.md lists the keys)'
            )
        known = _answer_from_file(console, folder, answers) if answers else _answer_by_person(console, folder)
        _write(console, known)
        raise typer.Exit(_check_and_show(console, known))


def _answer_from_file(console: Console, folder: Path, file: Path) -> Known:
    given = load_answers(file)
    check_keys(given, str(file))
    interview = Interview(folder)
    with _busy(console):
        for key, accepted in answer_all(interview, given, str(file)):
            _tell_accepted(console, key, accepted)
    for key in given:
        if key not in interview.known.answers:
            say_note(f"{key} was not asked, since other answers leave no need for it")
    return interview.known


def _answer_by_person(console: Console, folder: Path) -> Known:
    file = folder / CONFIGURATION
    if file.exists():
        console.print(f"{file} is there already. At the end it is kept in {folder / VERSIONS}.", markup=False)
    try:
        return _interview(console, folder)
    except (KeyboardInterrupt, EOFError):
        again = "stadimeter init" if folder == Path() else f"stadimeter init {folder}"
        console.print(f"\nLeft. Every answer is saved; run `{again}` again to go on.", markup=False)
        raise typer.Exit(NOT_FOUND) from None


def _interview(console: Console, folder: Path) -> Known:
    file = folder / ANSWERS
    saved = load_answers(file) if file.exists() else {}
    if was_left(file, folder / CONFIGURATION):
        interview = Interview(folder)
        console.print(f"Going on with the answers in {file}:", markup=False)
        for key, accepted in interview.resume(saved):
            _tell_accepted(console, key, accepted)
    else:
        interview = Interview(folder, earlier=saved)
        words = "Enter takes the answer in [brackets], back goes back, Ctrl-C leaves and keeps the answers."
        console.print(words, style="dim", markup=False)
    while interview.next_key:
        _ask(console, interview)
    return interview.known


def _ask(console: Console, interview: Interview) -> None:
    """Ask the next question until it is answered, or the person goes back."""
    question = _question(console, interview)
    if question is None:
        return
    if question.is_sure and _takes(console, interview, question.ready):
        return
    _tell_question(console, question, len(interview.known.answers) + 1)
    while True:
        text = _prompt(console, question.ready)
        if text == BACK:
            interview.back()
            return
        accepted = _accept(console, interview, _option(question, text))
        if accepted is not None and not accepted.doubt:
            return
        if accepted is not None:  # the answer is the ready one now
            question = interview.question() or question


def _takes(console: Console, interview: Interview, ready: str) -> bool:
    """Take an answer that is sure, and tell it; return whether there is no doubt of it."""
    key = interview.next_key
    try:
        with _busy(console):
            accepted = interview.answer(ready)
    except StadimeterError:  # then it is asked
        return False
    if not accepted.doubt:
        console.print()
        _tell_accepted(console, f"{len(interview.known.answers)}. {key}", accepted)
    return not accepted.doubt


def _question(console: Console, interview: Interview) -> Question | None:
    """Return the next question; None if an earlier answer is of no use any more, which is asked again then."""
    try:
        with _busy(console):
            return interview.question()
    except StadimeterError as error:
        _tell_error(console, error)
        if not interview.back():
            raise
        return None


def _option(question: Question, text: str) -> str:
    """Return the answer that a number stands for; of recipes several numbers do."""
    numbers = text.replace(",", " ").split() if question.kind == "recipe" else [text]
    if not all(each.isdecimal() and 1 <= int(each) <= len(question.options) for each in numbers):
        return text
    return " ".join(question.options[int(each) - 1].answer for each in numbers)


def _accept(console: Console, interview: Interview, text: str) -> Accepted | None:
    try:
        with _busy(console):
            accepted = interview.answer(text)
    except StadimeterError as error:
        _tell_error(console, error)
        return None
    _tell_notes(console, accepted)
    return accepted


def _tell_question(console: Console, question: Question, number: int) -> None:
    console.print()
    console.print(Text(f"{number}. {question.text}", "bold"))
    for found in question.found:
        _print_indented(console, found, "green")
    form = f"{question.form[0].upper()}{question.form[1:]}." if question.form else ""
    if question.options:
        table = _options_table(question)
        group = ""
        for count, option in enumerate(question.options, start=1):
            if option.group != group:
                group = option.group
                _print_options(console, table)
                _print_indented(console, group, "bold")
                table = _options_table(question)
            table.add_row(str(count), Text(option.answer, "cyan"), Text(option.meaning))
        _print_options(console, table)
        form = f"Or {question.form}." if question.form else ""
    if form:
        _print_indented(console, form, "dim")


def _options_table(question: Question) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", min_width=len(str(len(question.options))))
    # The columns of all groups stand below each other. Other answers, such as addresses, may be too long for that.
    table.add_column(overflow="fold", min_width=max(len(each.answer) * bool(each.group) for each in question.options))
    table.add_column(overflow="fold")
    return table


def _print_options(console: Console, table: Table) -> None:
    if table.row_count:
        console.print(Padding(table, (0, 0, 0, 3)))


def _tell_notes(console: Console, accepted: Accepted) -> None:
    for note in accepted.notes:
        _print_indented(console, note, "yellow" if accepted.doubt else "green")
    if accepted.doubt:
        _print_indented(console, "Enter keeps this answer; or type another one, or back.", "dim")


def _prompt(console: Console, ready: str) -> str:
    """Return the line that the person types, or the ready answer; asks again for an empty line where there is none."""
    prompt = Text.assemble((f"[{ready}]" if ready else "", "cyan"), "> ")
    while True:
        typed = console.input(prompt, markup=False).strip()
        if typed or ready:
            return typed or ready
        console.print("There is no answer ready here; type one.", style="yellow")


def _tell_accepted(console: Console, key: str, accepted: Accepted) -> None:
    shown = address_for_people(accepted.answer) if "://" in accepted.answer else accepted.answer
    console.print(Text.assemble((f"{key}", "bold"), " = ", (shown, "cyan")))
    for note in accepted.notes:
        _print_indented(console, note, "green")


def _tell_error(console: Console, error: StadimeterError) -> None:
    for line in str(error).splitlines():
        _print_indented(console, line, "red")


def _print_indented(console: Console, words: str, style: str) -> None:
    console.print(Padding(Text(words, style), (0, 0, 0, 3), expand=False))


@contextmanager
def _busy(console: Console) -> Iterator[None]:
    """Show that something is going on; a colour takes seconds to be found."""
    with console.status("looking …", spinner="line"):
        yield


def _write(console: Console, known: Known) -> None:
    console.print()
    for words in write_files(known.folder, configuration_files(known.answers, known.lens, known.model_file)):
        console.print(words, markup=False, soft_wrap=True)


def _check_and_show(console: Console, known: Known) -> int:
    """Check what was written, measure, run its tests, name the next commands, and return the exit code."""
    console.print()
    check(known.file)
    written = load_configuration(known.file)
    if find_outputs(parts_of(written)):
        console.print()
        wiring(known.file, output=None)
        wiring(known.file, output=known.path(WIRING))
    console.print()
    is_measured = _is_measured(console, known, written)
    console.print()
    try:
        run_tests(known.file, name="", as_json=False, verbose=False)
    finally:
        _next_commands(console, known, [each.section for each in written.rules])
    return DONE if is_measured else NOT_FOUND


def _is_measured(console: Console, known: Known, written: Configuration) -> bool:
    """Measure the target in the last picture, and return whether it is there."""
    if written.camera_model is None:
        return False
    targets = build_detectors(written.targets[:1], written.camera_model, written.footings)
    results = Measuring(targets, written.camera_model).measure(known.frame, "").targets
    for seen in (each.measurement for each in results):
        if seen.distance_m is None:
            words = f"{_picture(known)}: `{seen.target}` was not measured: {seen.reason}"
            console.print(Text(words, "yellow"))
            return False
        away = format_distance(seen.distance_m, seen.sigma_m, METRE)
        console.print(f"{_picture(known)}: the {seen.target} is {away} away.", markup=False)
    return True


def _picture(known: Known) -> str:
    """Return the name of the picture that is measured at the end."""
    return os.path.relpath(known.frame.source) if known.frame.source else "The last picture of the camera"


def _next_commands(console: Console, known: Known, rules: Sequence[str]) -> None:
    source = known.frame.source
    pictures = _picture(known) if source else known.answers["camera"]
    what = f"--live {known.file}" if known.is_live else shlex.quote(pictures)
    console.print("\nNext:", style="bold")
    asked = next((each for each in (*known.answers["recipe"].split(), *rules) if each in rules), "")
    for line in (
        f"stadimeter measure {what} --config {known.file}",
        f"stadimeter run {known.file} --watch",
        f"stadimeter explain {asked}" if asked else f"stadimeter measure {pictures} --where --config {known.file}",
    ):
        console.print(f"  {line}", markup=False, soft_wrap=True)
