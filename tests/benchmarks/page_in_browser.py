"""What the page costs in a real browser: from a frame to the screen, to the first picture, what is loaded and kept.

`tests/web/test_figures.py` measures with it: the simulated camera at 640×480 and 30 Hz, its run, its page and a
Chromium without a window, all on one computer.
"""

from __future__ import annotations

from statistics import quantiles
from typing import Any

from support.browser import until

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


def p95(values: list[float]) -> float:
    """Return the 95th percentile."""
    return quantiles(values, n=20)[-1]
