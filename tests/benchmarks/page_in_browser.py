"""What the page costs in a real browser: what is loaded and kept, and when a picture is marked as old.

`tests/web/test_figures.py` measures with it: the simulated camera at 640×480 and 30 Hz, its run, its page and a
Chromium without a window, all on one computer.
"""

from __future__ import annotations

from typing import Any

from support.browser import until

VIEWS = ("live", "timeline", "setup", "edit", "recordings", "alarms")

LOADED = """performance.getEntriesByType("resource").concat(performance.getEntriesByType("navigation"))
    .filter((each) => !/\\/(api|vendor)\\//.test(each.name)).map((each) => [each.name, each.decodedBodySize])"""


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
