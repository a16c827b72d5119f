"""The page on troubleshooting quotes what the program really says."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text()
OF_OTHERS = {"numpy.dtype size changed", "stadimeter: command not found", "externally-managed-environment"}
"""What pip, Python and the shell say."""


def symptoms():
    """Return the messages in the first column: quoted, and of several words, to tell them from commands and names."""
    first = [line.split(" | ")[0] for line in PAGE.splitlines() if line.startswith("| ")]
    quoted = [quote for cell in first for quote in re.findall(r"`([^`]+)`", cell)]
    return [quote for quote in quoted if " " in quote and "…" not in quote and not quote.startswith("stadimeter ")]


def test_every_message_that_is_quoted_stands_in_the_source():
    sources = (path.read_text() for path in (ROOT / "src" / "stadimeter").rglob("*.py"))
    unbroken = "\n".join(re.sub(r'"\s*\n\s*[rf]?"', "", source) for source in sources)
    quoted = set(symptoms()) - OF_OTHERS
    assert len(quoted) > 15
    assert sorted(quote for quote in quoted if quote not in unbroken) == []
