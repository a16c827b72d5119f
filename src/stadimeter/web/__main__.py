"""``python -m stadimeter.web``: the page's process, as `stadimeter web` starts it in its own place.

The libraries that read a command line and print its help would take a third of the memory of this process, which stays.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stadimeter.app.ending import end_with_input
from stadimeter.errors import PageError
from stadimeter.web.access import shown_address
from stadimeter.web.page import PageOptions
from stadimeter.web.serving import check_certificate, listen, serve

if TYPE_CHECKING:
    from stadimeter.web.others import Others


def main() -> None:
    """Serve the page with the options of the only argument, as JSON."""
    given = json.loads(sys.argv[1])
    paths = {name: Path(path) if path else None for name, path in given["paths"].items()}
    certificate, key, tokens = paths.pop("certificate"), paths.pop("key"), paths.pop("others_tokens")
    try:
        others = _others(given["others"], tokens) if given["others"] else None
        options = PageOptions(**paths, allowed_hosts=tuple(given["allowed_hosts"]), others=others)  # type: ignore[arg-type]
        check_certificate(certificate, key)
        listener = listen(given["address"], given["port"], options.passwords)
    except PageError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    if given.get("ends_with_input"):
        end_with_input()
    scheme = "https" if certificate else "http"
    address = shown_address(*listener.getsockname()[:2])
    serve(options, listener, (certificate, key), lambda: print(f"The page: {scheme}://{address}/", flush=True))


def _others(urls: Sequence[str], tokens: Path | None) -> Others:
    from stadimeter.web.others import Others, read_tokens  # noqa: PLC0415 - most pages know of no other

    return Others(urls, read_tokens(tokens) if tokens else {})


if __name__ == "__main__":
    main()
