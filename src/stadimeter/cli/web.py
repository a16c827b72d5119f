"""The command ``web``: the page of a run, in a process of its own."""

from __future__ import annotations

import socket
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stadimeter.cli.exits import plain_errors
from stadimeter.errors import PageError

if TYPE_CHECKING:
    from stadimeter.web.page import Options


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("web")(web)


def web(
    config: Annotated[
        Path | None,
        typer.Argument(metavar="CONFIG", help="The configuration that the page is for; it need not be there yet."),
    ] = None,
    address: Annotated[
        str | None,
        typer.Option(
            "--address",
            metavar="ADDRESS",
            help="Where to listen; by default on this computer only, and everywhere once a password is set.",
        ),
    ] = None,
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="The port; 0 for any that is free.")] = 8080,
    set_password: Annotated[
        bool, typer.Option("--set-password", help="Ask for a new password, and end. It ends all sessions.")
    ] = False,
    read: Annotated[
        bool, typer.Option("--read", help="With --set-password: for watching only; else it is for operating.")
    ] = False,
    password_file: Annotated[
        Path | None,
        typer.Option("--password-file", metavar="FILE", help="Where the passwords' hashes are; else beside CONFIG."),
    ] = None,
    certificate: Annotated[
        Path | None, typer.Option("--certificate", metavar="FILE", help="Serve https, with this certificate (PEM).")
    ] = None,
    key: Annotated[
        Path | None, typer.Option("--key", metavar="FILE", help="The certificate's key (PEM, without a passphrase).")
    ] = None,
    allow_host: Annotated[
        list[str] | None,
        typer.Option("--allow-host", metavar="NAME", help="Another name of this computer in browsers. Repeatable."),
    ] = None,
    socket: Annotated[
        Path | None, typer.Option("--socket", metavar="PATH", help="The socket of the run; by default it is found.")
    ] = None,
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
        from stadimeter.web.passwords import place_of_passwords  # noqa: PLC0415 - only with the extra

        passwords = password_file or place_of_passwords(config)
        if set_password:
            _set_password(passwords, "read" if read else "operate")
        elif config is None:
            raise PageError(400, "no-configuration", "name the CONFIG that the page is for; it need not be there yet")
        else:
            from stadimeter.web.page import Options  # noqa: PLC0415

            hosts = tuple(allow_host or ())
            options = Options(configuration=config, passwords=passwords, socket=socket, allowed_hosts=hosts)
            _serve(options, (address, port), (certificate, key))


def _check_extra() -> None:
    if not all(find_spec(name) for name in ("starlette", "uvicorn")):
        words = "the page needs the extra `web`: pip install 'stadimeter[web]'"
        raise PageError(503, "no-extra", words)


def _set_password(path: Path, right: str) -> None:
    from stadimeter.web.passwords import PasswordFile  # noqa: PLC0415 - only with the extra

    words = {"operate": "Password for operating", "read": "Password for watching"}[right]
    password = typer.prompt(words, hide_input=True, confirmation_prompt="Once more")
    PasswordFile(path).set(right, password)
    typer.echo(f"The password is set; all sessions have ended. Its hash is in {path}.")


def _serve(options: Options, listens: tuple[str | None, int], tls: tuple[Path | None, Path | None]) -> None:
    from stadimeter.web.serving import check_certificate, listen, serve  # noqa: PLC0415 - only with the extra

    check_certificate(*tls)
    listener = listen(*listens, options.passwords)
    scheme = "https" if tls[0] else "http"
    serve(options, listener, tls, lambda: typer.echo(f"The page: {scheme}://{_shown(listener)}/"))


def _shown(listener: socket.socket) -> str:
    """Return where a browser finds us: an address, or our name on the local network if it may be any address."""
    address, port = listener.getsockname()[:2]
    if address in {"::", "0.0.0.0"}:  # noqa: S104
        return f"{socket.gethostname().partition('.')[0]}.local:{port}"
    return f"[{address}]:{port}" if ":" in address else f"{address}:{port}"
