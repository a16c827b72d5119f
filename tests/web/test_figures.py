"""The figures that the page has to reach in a real browser.

The simulated camera at 640×480 and 30 Hz, its run, its page and a Chromium without a window, all on one computer.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import stadimeter
from support.browser import Served, served, tab, until

# What the page costs in a real browser: what is loaded and kept, and when a picture is marked as old.

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
    """Freeze the simulated camera; return how long after its last frame the picture is marked as old.

    By as much as a busy machine lets the browser's timers wait meanwhile, the page can do nothing earlier.
    """
    page.locator("canvas[data-drawn]").wait_for()
    page.locator(".old").wait_for(state="hidden")
    page.evaluate("""() => {
        let late = 0, last = performance.now();
        const beat = () => {
            late = Math.max(late, performance.now() - last - 20);
            last = performance.now();
        };
        const timer = setInterval(beat, 20);
        new MutationObserver((_, observer) => {
            observer.disconnect();
            clearInterval(timer);
            beat();
            const captured = Number(document.querySelector("canvas[data-drawn]").dataset.captured);
            window.oldAfter = performance.timeOrigin + performance.now() - captured * 1000 - late;
        }).observe(document.querySelector(".old"), { attributes: true, attributeFilter: ["hidden"] });
    }""")
    page.get_by_label("freeze camera").press("Space")  # a click may miss what moves
    return float(until(page, "window.oldAfter"))


# The figures that the page has to reach in a real browser.

STATIC = Path(stadimeter.__file__).parent / "web" / "static"
OURS = [each for each in STATIC.rglob("*") if each.is_file() and "vendor" not in each.parts]
"""Without the libraries, which are as large as their makers made them."""
STATIC_BYTES = sum(each.stat().st_size for each in OURS)


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("figures")) as serving:
        yield serving


def test_all_that_the_page_loads_has_at_most_300_kb(browser, here):
    with tab(browser) as page:
        assert 100_000 < loaded_bytes(page, here.url) <= STATIC_BYTES <= 300_000


@pytest.fixture
def idle_enough() -> None:
    """Skip a test of delays where other programs have taken the processors: it would measure them."""
    if os.getloadavg()[0] > 2 * (os.cpu_count() or 1):
        pytest.skip("this computer is too busy to measure delays: two programs wait for each processor")


@pytest.mark.usefixtures("idle_enough")
def test_a_frozen_picture_is_marked_as_old_within_a_second(browser, here):
    with tab(browser) as page:
        page.goto(f"{here.url}/#live")
        assert old_after_ms(page) <= 1000
        page.get_by_label("freeze camera").press("Space")


def test_a_tab_that_watches_does_not_grow(browser, here):
    with tab(browser) as page:
        page.goto(f"{here.url}/#live")
        page.locator("canvas[data-drawn]").wait_for()
        page.wait_for_timeout(10_000)
        heap, nodes = kept(page)
        page.wait_for_timeout(30_000)
        heap_later, nodes_later = kept(page)
        assert heap_later - heap < 1_000_000
        assert nodes_later - nodes < 200
