"""The command ``web``: the page of a run, in a process of its own."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import plain_errors
from stadimeter.config.extras import install_line
from stadimeter.errors import PageError
from stadimeter.web import python
from stadimeter.web.passwords import PasswordFile, place_of_passwords

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
Port = Annotated[int, typer.Option("--port", min=0, max=65535, help="The port; 0 for any that is free.")]
SetPassword = Annotated[
    bool, typer.Option("--set-password", help="Ask for a new password, and end. It ends all sessions.")
]
ForReading = Annotated[
    bool, typer.Option("--read", help="With --set-password: for watching only; else it is for operating.")
]
PasswordPath = Annotated[
    Path | None,
    typer.Option("--password-file", metavar="FILE", help="Where the passwords' hashes are; else beside CONFIG."),
]
Certificate = Annotated[
    Path | None, typer.Option("--certificate", metavar="FILE", help="Serve https, with this certificate (PEM).")
]
Key = Annotated[
    Path | None, typer.Option("--key", metavar="FILE", help="The certificate's key (PEM, without a passphrase).")
]
AllowedHosts = Annotated[
    list[str] | None,
    typer.Option("--allow-host", metavar="NAME", help="Another name of this computer in browsers. Repeatable."),
]
SocketFile = Annotated[
    Path | None, typer.Option("--socket", metavar="PATH", help="The socket of the run; by default it is found.")
]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("web")(web)


def web(
    config: ConfigFile = None,
    address: Address = None,
    port: Port = 8080,
    set_password: SetPassword = False,
    read: ForReading = False,
    password_file: PasswordPath = None,
    certificate: Certificate = None,
    key: Key = None,
    allow_host: AllowedHosts = None,
    socket: SocketFile = None,
) -> None:
    """Serve a page on which a browser sees, sets up and operates a run.

    The page is a process of its own. It asks the run at its control socket, and offers to start one if there is none.
    Without a password it can be reached from this computer only.

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
        passwords = password_file or place_of_passwords(config)
        if set_password:
            _set_password(passwords, "read" if read else "operate")
            return
        if config is None:
            raise PageError(400, "no-configuration", "name the CONFIG that the page is for; it need not be there yet")
        paths = {
            "configuration": config,
            "passwords": passwords,
            "socket": socket,
            "certificate": certificate,
            "key": key,
        }
        _become(paths, {"address": address, "port": port, "allowed_hosts": allow_host or []})


def _check_extra() -> None:
    if not all(find_spec(name) for name in ("starlette", "uvicorn")):
        words = f"the page needs the extra `web`: {install_line('web')}"
        raise PageError(503, "no-extra", words)


def _set_password(path: Path, right: str) -> None:
    words = {"operate": "Password for operating", "read": "Password for watching"}[right]
    file = PasswordFile(path)
    is_first = file.passwords() is None
    password = typer.prompt(words, hide_input=True, confirmation_prompt="Once more")
    file.set(right, password)
    typer.echo(f"The password is set; all sessions have ended. Its hash is in {path}.")
    if is_first:
        typer.echo("A page that is served already is reached by others when it has been started again.")


def _become(paths: Mapping[str, Path | None], more: Mapping[str, object]) -> None:
    """Go on as the page's process, which has nothing of the command line in its memory."""
    given = {"paths": {name: path and str(path) for name, path in paths.items()}, **more}
    sys.stdout.flush()
    os.execv(sys.executable, [*python("stadimeter.web"), json.dumps(given)])  # noqa: S606 - our own interpreter, with what was asked for
