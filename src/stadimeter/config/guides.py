"""Where the guides are that messages name: in a checkout, in the Debian package, or on the web."""

from __future__ import annotations

from pathlib import Path

# A system may leave it out: `path-exclude` of dpkg.
CHECKOUT = Path(__file__).parents[3] / "docs"
OF_PACKAGE = Path("/usr/share/doc/stadimeter")
ON_THE_WEB = "https://github.com/stadimeter/stadimeter/blob/main/docs"


def guide(page: str) -> str:
    """Return where a page such as ``doctor.md`` can be read from this computer."""
    if (CHECKOUT / page).is_file():
        return f"docs/{page}"
    if (OF_PACKAGE / page).is_file():
        return str(OF_PACKAGE / page)
    return f"{ON_THE_WEB}/{page}"
