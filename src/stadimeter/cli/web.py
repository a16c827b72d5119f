"""The command ``web``: the page of a run, in a process of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from stadimeter.cli.exits import plain_errors


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("web")(web)


def web(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="The configuration; it need not be there yet.")],
    address: Annotated[str, typer.Option("--address", metavar="ADDRESS", help="Where to listen.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="The port.")] = 8080,
    socket: Annotated[
        Path | None, typer.Option("--socket", metavar="PATH", help="The socket of the run; by default it is found.")
    ] = None,
) -> None:
    """Serve a page on which a browser sees, sets up and operates a run.

    **Example**

    - `stadimeter web config/distance-alert.toml`

    **Exit code**: 0 ended by Ctrl-C or SIGTERM; 2 the port is in use, or something that it needs is missing.
    """
    with plain_errors():
        from stadimeter.web.page import Page  # noqa: PLC0415 - only with the extra
        from stadimeter.web.run_link import RunLink  # noqa: PLC0415
        from stadimeter.web.serving import listen, serve  # noqa: PLC0415
        from stadimeter.web.workbench_link import WorkbenchLink, command_of_workbench  # noqa: PLC0415

        listener = listen(address, port)
        page = Page(config, RunLink(config, socket), WorkbenchLink(command_of_workbench(config, socket)))
        host, taken = listener.getsockname()[:2]
        serve(page, listener, lambda: typer.echo(f"the page: http://{host}:{taken}/"))
