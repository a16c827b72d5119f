"""What Debian asks of a package besides its program: man page, completion and changelog, made from what there is.

The man page is the help of each command, the completion is that of the command line's library, the changelog is
CHANGELOG.md: none of them can be forgotten when a command changes.
"""

from __future__ import annotations

import gzip
import os
import re
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from email.utils import formatdate
from typing import Any

import typer

from stadimeter.cli.main import app

COMPLETIONS = {
    "bash": "usr/share/bash-completion/completions/stadimeter",
    "zsh": "usr/share/zsh/vendor-completions/_stadimeter",
    "fish": "usr/share/fish/vendor_completions.d/stadimeter.fish",
}
"""Where each shell looks for the completion of packages."""

FILES = {
    "/etc/stadimeter/appliance.toml": "the configuration of the service",
    "/etc/stadimeter/safe-outputs.conf": "what else is switched off when the service has ended, if somebody made it",
    "/usr/share/stadimeter/examples": "examples of configurations, and of a broker's",
    "/usr/share/doc/stadimeter": "guides",
    "/var/lib/stadimeter": "what alarms remember, events and recordings of the service",
}


def completion(shell: str) -> str:
    """Return the script that completes commands and options in a shell."""
    script = "import sys; sys.argv = ['stadimeter']; from stadimeter.__main__ import main; main()"
    environment = {**os.environ, "_STADIMETER_COMPLETE": f"source_{shell}"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, check=True, capture_output=True, text=True)  # noqa: S603
    return done.stdout.strip() + "\n"


def man_page(version: str) -> str:
    """Return stadimeter(1), in the macros of man(7)."""
    group: Any = typer.main.get_command(app)
    context = group.make_context("stadimeter", [], resilient_parsing=True)
    summary, _, description = group.help.partition("\n\n")
    lines = [
        f'.TH STADIMETER 1 "" "stadimeter {_escaped(version)}" "User Commands"',
        ".SH NAME",
        rf"stadimeter \- {_escaped(summary[0].lower() + summary[1:].rstrip('.'))}",
        ".SH SYNOPSIS",
        r".B stadimeter",
        r"\fIcommand\fR [\fIoption\fR \&...] [\fIargument\fR \&...]",
        ".SH DESCRIPTION",
        *_prose(description),
        ".SH OPTIONS",
        *_parameters(group, context),
        ".SH COMMANDS",
    ]
    for name in group.list_commands(context):
        if not group.commands[name].hidden:
            lines += _command(group.load(name), context, name)
    lines += [".SH FILES"]
    for place, what in FILES.items():
        lines += [".TP", f".I {_escaped(place)}", _escaped(what)]
    return "\n".join(lines) + "\n"


def _command(command: Any, above: Any, name: str) -> Iterator[str]:
    context = type(above)(command, info_name=name, parent=above)
    yield f'.SS "{_escaped(context.command_path)}"'
    yield from _prose(command.help or "")
    yield from _parameters(command, context)
    for inner in getattr(command, "commands", {}).values():
        yield from _command(inner, context, inner.name)


def _parameters(command: Any, context: Any) -> Iterator[str]:
    for parameter in command.get_params(context):
        if (record := parameter.get_help_record(context)) is not None:
            names, words = record
            yield from (".TP", rf"\fB{_escaped(names.strip())}\fR", _inline(" ".join(words.split())) or r"\&")


def _prose(text: str) -> Iterator[str]:
    """Yield paragraphs and lists. Of Markdown, help has **bold**, `code` and lists of lines that begin with a dash."""
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        is_item = paragraph.startswith("- ")
        yield r".IP \(bu 2" if is_item else ".PP"
        yield _inline(" ".join(paragraph.removeprefix("- ").split()))


def _inline(text: str) -> str:
    return re.sub(r"\*\*(.+?)\*\*|`(.+?)`", lambda found: rf"\fB{found[1] or found[2]}\fR", _escaped(text))


def _escaped(text: str) -> str:
    text = text.replace("\\", r"\e").replace("-", r"\-")
    return rf"\&{text}" if text.startswith((".", "'")) else text


def changelog(version: str, maintainer: str, markdown: str) -> bytes:
    """Return the newest part of CHANGELOG.md in the form of a Debian changelog, packed."""
    newest = markdown.split("\n## ")[1].partition("\n")[2]
    lines = [f"stadimeter ({version}) unstable; urgency=medium", ""]
    for part in newest.split("\n### ")[1:]:
        heading, _, body = part.partition("\n")
        lines += [f"  [ {heading} ]"]
        for item in re.split(r"^- ", body, flags=re.MULTILINE)[1:]:
            words = " ".join(item.split())
            lines += textwrap.wrap(words, 79, initial_indent="  * ", subsequent_indent="    ", break_on_hyphens=False)
        lines += [""]
    made_s = int(os.environ.get("SOURCE_DATE_EPOCH", time.time()))
    lines += [f" -- {maintainer}  {formatdate(made_s)}", ""]
    return gzip.compress("\n".join(lines).encode(), mtime=made_s)
