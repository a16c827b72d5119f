"""What the page costs in a real browser: from a frame to the screen, to the first picture, what is loaded and kept.

``python tests/benchmarks/page_in_browser.py`` prints the rows of docs/benchmarks/web.md, from the simulated camera at
640×480 and 30 Hz, its run, its page and a Chromium without a window, all on one computer.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from support.browser import chromium, served, tab, until

VIEWS = ("live", "timeline", "setup", "edit", "recordings", "alarms")

WATCH = """() => {
    window.delays = [];
    const canvas = document.querySelector("canvas[data-drawn]");
    new MutationObserver(() => {
        const capturedMs = Number(canvas.dataset.captured) * 1000;
        const painted = new MessageChannel();
        painted.port1.onmessage = () => window.delays.push(performance.timeOrigin + performance.now() - capturedMs);
        requestAnimationFrame(() => painted.port2.postMessage(null));  // comes after the browser's frame was made
    }).observe(canvas, { attributes: true, attributeFilter: ["data-captured"] });
}"""

LOADED = """performance.getEntriesByType("resource").concat(performance.getEntriesByType("navigation"))
    .filter((each) => !/\\/(api|vendor)\\//.test(each.name)).map((each) => [each.name, each.decodedBodySize])"""


def delays_ms(page: Any, seconds: float) -> list[float]:
    """Return for each picture that was drawn how long after its capture it was on the screen."""
    page.locator("canvas[data-drawn]").wait_for()
    page.wait_for_timeout(2000)
    page.evaluate(WATCH)
    page.wait_for_timeout(seconds * 1000)
    return page.evaluate("window.delays")


def first_picture_ms(page: Any, url: str) -> float:
    """Return how long after the address was entered the first picture was drawn."""
    page.goto(f"{url}/#alarms")
    page.goto("about:blank")
    page.goto(f"{url}/#live", wait_until="commit")
    drawn = until(page, "document.querySelector('canvas[data-drawn]')?.dataset.drawn")
    return float(drawn) * 1000 - page.evaluate("performance.timeOrigin")


def loaded_bytes(page: Any, url: str) -> int:
    """Return the size of all of ours that the page loads when every view is opened, uncompressed."""
    sizes: dict[str, int] = {}
    for view in VIEWS:
        page.goto(f"{url}/#{view}")
        page.locator(".view > *").first.wait_for()
        page.wait_for_load_state("load")
        sizes.update(page.evaluate(LOADED))
    return sum(sizes.values())


def kept(page: Any) -> tuple[int, int]:
    """Return the bytes of the tab's heap and the nodes of its document, without what is free to go."""
    tools = page.context.new_cdp_session(page)
    tools.send("HeapProfiler.collectGarbage")
    heap, nodes = tools.send("Runtime.getHeapUsage")["usedSize"], tools.send("Memory.getDOMCounters")["nodes"]
    tools.detach()
    return int(heap), int(nodes)


def old_after_ms(page: Any) -> float:
    """Freeze the simulated camera; return how long after its last frame the picture is marked as old."""
    page.locator("canvas[data-drawn]").wait_for()
    page.locator(".old").wait_for(state="hidden")
    page.evaluate("""() => new MutationObserver((_, observer) => {
        observer.disconnect();
        const captured = Number(document.querySelector("canvas[data-drawn]").dataset.captured);
        window.oldAfter = performance.timeOrigin + performance.now() - captured * 1000;
    }).observe(document.querySelector(".old"), { attributes: true, attributeFilter: ["hidden"] })""")
    page.get_by_label("freeze camera").check()
    return float(until(page, "window.oldAfter"))


def main() -> None:
    """Measure, and print the rows."""
    with tempfile.TemporaryDirectory() as folder, chromium() as browser, served(Path(folder)) as here:
        with tab(browser) as page:
            page.goto(f"{here.url}/#live")
            delays = delays_ms(page, 30)
            before = kept(page)
            page.wait_for_timeout(60_000)
            after = kept(page)
            old_ms = old_after_ms(page)
        with tab(browser) as page:
            first_ms = [first_picture_ms(page, here.url) for _ in range(5)]
            loaded = loaded_bytes(page, here.url)
    print(f"| frame to screen, {len(delays)} frames | median {median(delays):.0f} ms, p95 {p95(delays):.0f} ms |")
    print(f"| address to first picture, 5 times | median {median(first_ms):.0f} ms, longest {max(first_ms):.0f} ms |")
    print(f"| all that the page loads, uncompressed | {loaded / 1000:.0f} kB |")
    print(f"| a frozen picture is marked as old after | {old_ms:.0f} ms |")
    grown = (after[0] - before[0]) / 1000
    print(f"| a tab that watches: heap, and growth in a minute | {after[0] / 1e6:.1f} MB, {grown:+.0f} kB |")


def p95(values: list[float]) -> float:
    """Return the 95th percentile."""
    return quantiles(values, n=20)[-1]


if __name__ == "__main__":
    main()
