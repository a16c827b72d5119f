"""What is wrong with a page as a browser draws it: cut off, too faint, without a name, out of reach of the keyboard."""

from __future__ import annotations

from pathlib import Path
from typing import Any

SCRIPT = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")
TABS_MAX = 400


def faults_of(page: Any) -> list[str]:
    """Return what is cut off, what has too little contrast, what has no name, and what is too small to touch."""
    page.evaluate(SCRIPT)
    return page.evaluate("window.pageChecks.all()")


def out_of_reach(page: Any) -> list[str]:
    """Press Tab until the focus has been everywhere; return what it did not come to, or where it was not to be seen."""
    page.evaluate(SCRIPT)
    page.evaluate("document.activeElement?.blur()")
    for _ in range(TABS_MAX):
        page.keyboard.press("Tab")
        if page.evaluate("window.pageChecks.visit()"):
            break
    return page.evaluate("window.pageChecks.unreachable()")
