"""The commands that draw: ``print`` tags, boards and discs at true scale, and ``wiring``."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from stadimeter.cli.calibrate import board_from_options
from stadimeter.cli.exits import ConfigArgument, configuration_path, plain_errors
from stadimeter.cli.target_options import takes_options, targets_from_options
from stadimeter.config.loader import load_configuration
from stadimeter.config.toml_source import as_toml
from stadimeter.core.drawing import Drawing
from stadimeter.detectors.protocol import DrawsTarget
from stadimeter.errors import ConfigError
from stadimeter.workbench.printing import PAPERS, Item, board_drawing, print_pages, write_drawings
from stadimeter.workbench.wiring import find_outputs, parts_of, wiring_picture, wiring_text

CHECK = "Print at 100 % (actual size), then measure the ruler: 10 cm and 4 in."
MAX_TAGS = 200

print_group = typer.Typer(no_args_is_help=True)

OutputOption = Annotated[
    Path, typer.Option("--output", "-o", metavar="FILE", help="The file to write, .pdf, or .svg for a single page.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
PaperOption = Annotated[str, typer.Option("--paper", metavar="NAME", help=f"The paper: {', '.join(PAPERS)}.")]


@print_group.callback()
def _print() -> None:
    """Make tags, boards and discs to print, at true scale.

    Print at 100 %, "actual size", never "fit to page", and measure the ruler at the foot of the page. Glue the print
    onto something flat and stiff.
    """


@print_group.command()
def tag(
    *,
    size: Annotated[str, typer.Argument(metavar="SIDE", help="Side of the black square.")] = "8cm",
    output: OutputOption,
    family: Annotated[
        str, typer.Option("--family", metavar="FAMILY", help="An AprilTag family, such as 36h11, or ArUco's 4x4-50.")
    ] = "36h11",
    numbers: Annotated[
        list[str] | None,
        typer.Option("--id", metavar="N|N-M", help="Numbers of the tags in the family; 0 if not given."),
    ] = None,
    paper: PaperOption = "A4",
    as_json: JsonOption = False,
) -> None:
    """Make tags to print: AprilTags or ArUco markers, as many on a page as fit.

    **Examples**

    - `stadimeter print tag -o tag.pdf`

    - `stadimeter print tag 12cm --family 4x4-50 --id 0-3 --id 7 --paper letter -o tags.pdf`

    **Exit code**: 0 the file was written; 2 an option is wrong, the tag is larger than the paper, or the file cannot be
    written.
    """
    with plain_errors():
        wanted = _numbers(numbers or ["0"])
        drawn = [(number, _draw_target({"--tag": size, "--family": family, "--id": number})) for number in wanted]
        full = drawn[0][1][1]["family"]
        items = [Item(drawing, f"{full}  id {number}") for number, (drawing, _) in drawn]
        words = f"{full}, id {_in_words(wanted)}: the side of the black square is {size}."
        table = {"detector": "tag", "side": size, "family": full, **({"id": wanted[0]} if len(wanted) == 1 else {})}
        option = f"--tag {size} --family {family}"
        pages = _write(output, items, paper, (words, CHECK, f"stadimeter measure … {option}"))
        _tell(output, pages, paper, {"tag": table}, as_json=as_json)


@print_group.command()
def disc(
    *,
    size: Annotated[str, typer.Argument(metavar="DIAMETER", help="Diameter of the disc.")] = "12cm",
    output: OutputOption,
    paper: PaperOption = "A4",
    as_json: JsonOption = False,
) -> None:
    """Make a black disc to print.

    **Examples**

    - `stadimeter print disc 15cm -o disc.pdf`

    **Exit code**: 0 the file was written; 2 an option is wrong, the disc is larger than the paper, or the file cannot
    be written.
    """
    with plain_errors():
        drawing, _ = _draw_target({"--disc": size})
        words = f"A disc of {size} across. Leave the white around it."
        pages = _write(output, [Item(drawing)], paper, (words, CHECK, f"stadimeter measure … --disc {size}"))
        table = {"detector": "disc", "diameter": size, "shade": "dark"}
        _tell(output, pages, paper, {"disc": table}, as_json=as_json)


@print_group.command()
@takes_options()
def board(
    *,
    output: OutputOption,
    square: str = "25mm",
    chessboard: str | None = None,
    charuco: str | None = None,
    marker: str | None = None,
    dictionary: str | None = None,
    paper: PaperOption = "A4",
    as_json: JsonOption = False,
) -> None:
    """Make a board to print, for `stadimeter calibrate board`: a chessboard or a ChArUco board, with the same options.

    **Examples**

    - `stadimeter print board -o board.pdf`

    - `stadimeter print board --charuco 5x7 --square 35mm --marker 26mm --dictionary 4X4_50 -o board.pdf`

    **Exit code**: 0 the file was written; 2 an option is wrong, the board is larger than the paper, or the file cannot
    be written.
    """
    with plain_errors():
        chessboard = chessboard or ("9x6" if charuco is None else None)
        wanted = board_from_options(chessboard, charuco, square, marker, dictionary)
        which = f"--board {chessboard}" if chessboard else f"--charuco {charuco}"
        of_charuco = f" --marker {marker} --dictionary {dictionary}" if charuco else ""
        options = f"{which} --square {square}{of_charuco}"
        pages = _write(
            output,
            [Item(board_drawing(wanted))],
            paper,
            (f"Squares of {square}. {CHECK}", f"calibrate board … {options}"),
        )
        _tell(output, pages, paper, {}, as_json=as_json)
        if not as_json:
            typer.echo(f"then: stadimeter calibrate board --live opencv,device=0 {options} -o camera.toml")


def _draw_target(given: Mapping[str, Any]) -> tuple[Drawing, dict[str, Any]]:
    """Return the drawing of a target that the options of `measure` describe, and its options."""
    choice = targets_from_options(given).choices[0]
    if not isinstance(choice.options, DrawsTarget):
        raise ConfigError(f"the detector {choice.driver!r} draws no target to print")
    return choice.options.draw(), choice.options.model_dump()


_RANGE = re.compile(r"\s*(\d{1,5})\s*(?:-\s*(\d{1,5})\s*)?")


def _numbers(texts: Sequence[str]) -> list[int]:
    """Return the numbers of ``0-3`` and ``7``, in their order, each once."""
    numbers: dict[int, None] = {}
    for text in ",".join(texts).split(","):
        match = _RANGE.fullmatch(text)
        if not match:
            raise ConfigError(f"--id: {text!r} is no number of a tag; write it such as 3, or 0-3 for several")
        first, last = int(match[1]), int(match[2] or match[1])
        numbers |= dict.fromkeys(range(first, last + 1))
    if not 0 < len(numbers) <= MAX_TAGS:
        raise ConfigError(f"--id: that is {len(numbers)} tags, and {MAX_TAGS} at most are made at a time")
    return list(numbers)


def _in_words(numbers: Sequence[int]) -> str:
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"{numbers[0]} to {numbers[-1]}"
    return ", ".join(map(str, numbers))


def _write(output: Path, items: Sequence[Item], paper: str, words: Sequence[str]) -> int:
    """Write the pages, and return how many there are."""
    pages = print_pages(items, paper, words)
    write_drawings(output, pages)
    return len(pages)


def _tell(output: Path, pages: int, paper: str, targets: Mapping[str, Mapping[str, Any]], *, as_json: bool) -> None:
    """Say what was written, and how the print stands in a configuration."""
    if as_json:
        typer.echo(json.dumps({"file": str(output), "pages": pages, "paper": paper, "targets": targets}))
        return
    typer.echo(f"wrote {output}: {pages} page{'s' if pages > 1 else ''} of {paper}\n{CHECK}")
    for name, table in targets.items():
        typer.echo(f"in a configuration:\n\n[targets.{name}]")
        typer.echo("\n".join(f"{key} = {as_toml(value)}" for key, value in table.items()))


def wiring(
    config: ConfigArgument = None,
    *,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Draw it into this file, .svg or .pdf.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Draw which part is on which pin of the Raspberry Pi.

    Shows the 40 pins of the header, those that the configuration uses, and the circuit of each part: a motor or a
    buzzer on a transistor, an LED with its resistor, a relay board, a button. Warns of pins that the Pi itself uses.

    A base has a serial port of its own, and is not on the header.

    **Examples**

    - `stadimeter wiring config/distance-alert.toml`

    - `stadimeter wiring config/distance-alert.toml -o wiring.svg`

    **Exit code**: 0 done; 2 the configuration cannot be used, nothing is on a pin, or the file cannot be written.
    """
    with plain_errors():
        configuration = load_configuration(configuration_path(config))
        parts = parts_of(configuration)
        if not find_outputs(parts):
            raise ConfigError(f"{configuration.path}: no part is on a pin of the header, so there is nothing to wire")
        for warning in configuration.warnings:
            if warning.code == "pin-taken":
                typer.echo(f"warning: {warning}", err=True)
        if output is not None:
            write_drawings(output, [wiring_picture(parts)])
        if as_json:
            typer.echo(json.dumps(msgspec.to_builtins(find_outputs(parts)), ensure_ascii=False))
        elif output is None:
            typer.echo(wiring_text(parts))
        else:
            typer.echo(f"wrote {output}")
