"""The command ``web``: the page of a run, in a process of its own."""

from __future__ import annotations

import json
import os
import re
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from stadimeter.cli.exits import plain_errors
from stadimeter.config.extras import install_line
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, read_untrusted_text
from stadimeter.config.findings import findings_of, problems
from stadimeter.config.models import WebTable
from stadimeter.config.toml_source import parse_toml
from stadimeter.config.units import validation_context
from stadimeter.errors import ConfigError, PageError
from stadimeter.web import python
from stadimeter.web.passwords import PasswordFile, place_of_passwords

# Begins the table `[web]`. A file without it is not parsed: the page is for configurations with errors, too.
_WEB_TABLE = re.compile(r"""^\s*\[?\s*["']?web\b""", re.MULTILINE)

ConfigFile = Annotated[
    Path | None,
    typer.Argument(metavar="CONFIG", help="The configuration that the page is for; it need not be there yet."),
]
Address = Annotated[
    str | None,
    typer.Option(
        "--address",
        metavar="ADDRESS",
        help="Where to listen; by default on this computer only, and everywhere once a password is set.",
    ),
]
Port = Annotated[
    int | None, typer.Option("--port", min=0, max=65535, help="The port, by default 8080; 0 for any that is free.")
]
SetPassword = Annotated[
    bool, typer.Option("--set-password", help="Ask for a new password, and end. It ends all sessions.")
]
ForReading = Annotated[
    bool, typer.Option("--read", help="With --set-password: for watching only; else it is for operating.")
]
MetricsToken = Annotated[
    bool, typer.Option("--metrics-token", help="Print what Prometheus needs to read /metrics, and end.")
]
AlarmsToken = Annotated[
    bool, typer.Option("--alarms-token", help="Print what the page of another camera needs to read alarms, and end.")
]
PasswordPath = Annotated[
    Path | None,
    typer.Option("--password-file", metavar="FILE", help="Where the passwords' hashes are; else beside CONFIG."),
]
SocketFile = Annotated[
    Path | None, typer.Option("--socket", metavar="PATH", help="The socket of the run; by default it is found.")
]


def web(
    config: ConfigFile = None,
    address: Address = None,
    port: Port = None,
    set_password: SetPassword = False,
    read: ForReading = False,
    metrics_token: MetricsToken = False,
    alarms_token: AlarmsToken = False,
    password_file: PasswordPath = None,
    socket: SocketFile = None,
) -> None:
    """Serve a page for your browser: see, set up and operate a run.

    The page is a process of its own. It asks the run at its control socket, and offers to start one if there is none.
    Without a password it can be reached from this computer only. What no option says is taken from `[web]` in CONFIG.

    **Examples**

    - `stadimeter web config/distance-alert.toml`

    - `stadimeter web config/distance-alert.toml --set-password`

    **Exit code**: 0 ended by Ctrl-C or SIGTERM; 2 the port is in use, a certificate does not fit its key, or the extra
    `web` is not installed.
    """
    with plain_errors():
        _check_extra()
        if config is not None and config.is_dir():
            words = f"{config} is a folder; name the configuration in it, such as {config / 'stadimeter.toml'}"
            raise PageError(400, "no-configuration", words)
        given = {"host": address, "port": port, "password_file": password_file}
        options = _load_table(config).model_copy(
            update={name: each for name, each in given.items() if each is not None}
        )
        if set_password:
            _set_password(options.password_file or place_of_passwords(config), "read" if read else "operate")
            return
        if metrics_token or alarms_token:
            what = "metrics" if metrics_token else "alarms"
            typer.echo(_token(options.password_file or place_of_passwords(config), what))
            return
        if config is None:
            raise PageError(400, "no-configuration", "name the CONFIG that the page is for; it need not be there yet")
        sys.stdout.flush()
        command = page_command(config, options, socket)
        os.execv(command[0], command)  # noqa: S606 - our own interpreter, without the command line in its memory


def page_command(config: Path, options: WebTable, socket: Path | None = None, **more: object) -> list[str]:
    """Return the command that runs the page of a configuration in a process of its own."""
    paths = {
        "configuration": config,
        "passwords": options.password_file or place_of_passwords(config),
        "socket": socket,
        "certificate": options.certificate,
        "key": options.key,
        "others_tokens": options.others_tokens,
    }
    given = {
        "paths": {name: path and str(path) for name, path in paths.items()},
        "address": options.host,
        "port": options.port,
        "allowed_hosts": options.allowed_hosts,
        "others": options.others,
        **more,
    }
    return [*python("stadimeter.web"), json.dumps(given)]


def _check_extra() -> None:
    if not all(find_spec(name) for name in ("starlette", "uvicorn")):
        words = f"the page needs the extra `web`: {install_line('web')}"
        raise PageError(503, "no-extra", words)


def _load_table(config: Path | None) -> WebTable:
    """Return the table `[web]` of a configuration, whatever else is wrong with that; one of defaults if there is none.

    Raises:
        ConfigError: What is wrong in the table, or why it cannot be found in the file.
    """
    text = read_untrusted_text(config, CONFIGURATION_MAX_BYTES) if config is not None and config.exists() else ""
    if config is None or not _WEB_TABLE.search(text):
        return WebTable()
    source = parse_toml(text, str(config))
    table = source.table.get("web", {})
    try:
        return WebTable.model_validate(table, context=validation_context(config))
    except ValidationError as error:
        found = findings_of(error, WebTable, table, ("web",))
        raise ConfigError(problems(found, str(config), source.spans)) from error


def _token(path: Path, what: str) -> str:
    passwords = PasswordFile(path).passwords()
    if passwords is None:
        words = f"{path} has no password, so the page is read from this computer only, and {what} without a token"
        raise PageError(400, "no-passwords", words)
    return passwords.token(what)


def _set_password(path: Path, right: str) -> None:
    words = {"operate": "Password for operating", "read": "Password for watching"}[right]
    file = PasswordFile(path)
    is_first = file.passwords() is None
    password = typer.prompt(words, hide_input=True, confirmation_prompt="Once more")
    file.set(right, password)
    typer.echo(f"The password is set; all sessions have ended. Its hash is in {path}.")
    if is_first:
        typer.echo("A page that is served already is reached by others when it has been started again.")
