"""How quickly a day of the timeline is on the screen, and zoomed, in a real browser.

``python tests/benchmarks/timeline_in_browser.py`` prints the rows of docs/benchmarks/web.md: 86,400 seconds of three
targets and six rules, a run beside it, its page and a Chromium without a window, all on one computer. Each figure is by
the marks of the browser's own clock: until the frame after the one in which the chart was drawn.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from stadimeter.workbench.server.operations import Desk, find_operation
from support.browser import STILL, chromium, served, tab, until
from support.timeline_day import DAY_S, keep_day

TARGETS, RULES = ("ball", "box", "door"), ("near", "far", "left", "right", "gone", "still")
TIMES = 9

CHART = "document.querySelector('.timeline-chart')"

# Marks each drawing once the browser has made its frame: a message that is sent in a frame comes after it.
WATCH = """() => {
    performance.clearMarks();
    const chart = document.querySelector(".timeline-chart");
    window.watch?.disconnect();
    window.watch = new MutationObserver((changes) => {
        const names = changes.map((each) => each.attributeName);
        const painted = new MessageChannel();
        painted.port1.onmessage = () => names.forEach((name) => performance.mark(name));
        requestAnimationFrame(() => painted.port2.postMessage(null));
    });
    window.watch.observe(chart, { attributes: true, attributeFilter: ["data-drawn", "data-step"] });
    const turned = () => performance.mark("wheel");
    document.querySelector(".u-over").addEventListener("wheel", turned, { once: true, capture: true });
}"""

# The page is entered anew, and a mark is set by the first drawing that has data.
FIRST = """addEventListener("DOMContentLoaded", () => new MutationObserver((_, observer) => {
    if (!document.querySelector(".timeline-chart[data-step][data-drawn]")) return;
    observer.disconnect();
    const painted = new MessageChannel();
    painted.port1.onmessage = () => performance.mark("painted");
    requestAnimationFrame(() => painted.port2.postMessage(null));
}).observe(document.documentElement, { subtree: true, attributes: true, childList: true }))"""


def mark_ms(page: Any, name: str) -> float:
    """Return when the first mark of a name was set, as soon as there is one."""
    return float(until(page, f"performance.getEntriesByName('{name}')[0]?.startTime"))


def first_paint_ms(page: Any, url: str) -> float:
    """Return how long after the address was entered the day was on the screen."""
    page.goto("about:blank")
    page.goto(f"{url}/#timeline", wait_until="commit")
    return mark_ms(page, "painted")


def zoom_ms(page: Any, by: int) -> tuple[float, float]:
    """Turn the wheel; return when the chart was drawn anew, and when with the detail of the new view."""
    page.evaluate(WATCH)
    page.mouse.wheel(0, by)
    drawn, loaded = mark_ms(page, "data-drawn"), mark_ms(page, "data-step")
    return drawn - mark_ms(page, "wheel"), loaded - mark_ms(page, "wheel")


def answer_ms(configuration: Path, hours: float) -> float:
    """Return how long the server's operation takes, without its way to the browser."""
    desk, now_s = Desk(configuration=configuration, run_socket=Path("/none")), time.time()
    asked = {"from": now_s - hours * 3600, "to": now_s, "points": 1500}
    times = []
    for _ in range(TIMES):
        began_s = time.perf_counter()
        find_operation("timeline.timeline")(desk, asked)
        times.append((time.perf_counter() - began_s) * 1e3)
    return median(times)


def in_words(times_ms: list[float]) -> str:
    """Return the median and the longest."""
    return f"median {median(times_ms):.0f} ms, longest {max(times_ms):.0f} ms"


def main() -> None:
    """Measure, and print the rows."""
    text = f'[timeline]\nkeep = "7 d"\n{STILL}'
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        kept = Path(folder) / "timeline" / "stadimeter"
        keep_day(kept, time.time(), TARGETS, RULES)
        size = sum(file.stat().st_size for file in kept.iterdir())
        answers = [answer_ms(Path(folder) / "stadimeter.toml", hours) for hours in (24, 1)]
        with served(Path(folder), text) as here, tab(browser) as page:
            page.add_init_script(FIRST)
            first = [first_paint_ms(page, here.url) for _ in range(TIMES)]
            until(page, f"{CHART}.dataset.drawn > 3")
            page.wait_for_timeout(5000)  # until clips and thresholds are there
            box = page.locator(".u-over").bounding_box()
            page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
            zooms = [zoom_ms(page, -300 if turn < TIMES else 300) for turn in range(2 * TIMES)]
    print(f"{DAY_S} s, {len(TARGETS)} targets, {len(RULES)} rules: {size / 1e6:.1f} MB; load {os.getloadavg()[0]:.0f}")
    print(f"| first paint, the workbench process not started yet | {first[0]:.0f} ms | ≤ 1 s |")
    print(f"| first paint, {len(first) - 1} times after | {in_words(first[1:])} | ≤ 1 s |")
    print(f"| zoom, until the chart is drawn, {len(zooms)} times | {in_words([one for one, _ in zooms])} | ≤ 100 ms |")
    print(f"| zoom, until its detail is drawn | {in_words([two for _, two in zooms])} | ≤ 100 ms |")
    print(f"| the server's answer, 24 h; 1 h | {answers[0]:.0f} ms; {answers[1]:.0f} ms | a few ms |")


if __name__ == "__main__":
    main()
