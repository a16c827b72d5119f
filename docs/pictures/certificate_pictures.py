"""The page in a real browser that makes a certificate, for docs/site.md."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from web_pages import save

from support.browser import chromium, served, tab

HERE = Path(__file__).parent
GUIDE = HERE.parent / "site.md"
SIZE = (1120, 1040)


def configuration_text() -> str:
    """Return the configuration that the guide shows."""
    pattern = r"<!-- file: site.toml -->\n```toml\n(.*?)```"
    (text,) = re.findall(pattern, GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    return str(text)


def make_certificate_picture(folder: Path) -> None:
    """Write the picture.

    Args:
        folder: Where to.
    """
    with (
        tempfile.TemporaryDirectory() as room,
        chromium() as browser,
        served(Path(room), configuration_text(), runs=False) as here,
        tab(browser, size=SIZE) as page,
    ):
        page.goto(f"{here.url}/#certificate")
        for number in range(5):
            page.get_by_role("button", name="Measure").click()
            page.locator(".list li").nth(number).wait_for()
        page.get_by_role("button", name="Write the certificate").click()
        page.get_by_text("Measured 20").wait_for()
        save(page, folder / "web-certificate.png")


if __name__ == "__main__":
    make_certificate_picture(HERE)
