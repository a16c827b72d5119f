"""Recordings, clips and the timeline in a real browser."""

from __future__ import annotations

import re
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.browser import PHONE, ROOM, STILL, Served, served, tab, until
from support.timeline_day import keep_day

# Recordings in a real browser: made, replayed by the keyboard, downloaded, deleted; and one that is damaged.

SHOWN_S = "Number(document.querySelector('input[type=range]').value)"
ACTIVE = """fetch("/api/v1/status").then((answer) => answer.json())
    .then(({ rules }) => rules?.some(({ status }) => status === "active"))"""
SHOWN_PICTURE = "document.querySelector('.replay img').naturalWidth"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("recordings")) as serving:
        yield serving


@pytest.fixture(scope="module")
def recording(browser: Any, room: Served) -> Path:
    """Make a recording of three seconds or more by the page, in which a rule is active; return its file."""
    with tab(browser) as page:
        page.goto(f"{room.url}/#recordings")
        page.get_by_role("button", name="Record", exact=True).click()
        page.get_by_text(re.compile("Recording: [3-9]")).wait_for()
        until(page, ACTIVE)  # between being near and far away, the ball is in neither rule for six seconds
        page.wait_for_timeout(1000)
        page.get_by_role("button", name="Stop recording").click()
        page.get_by_role("button", name="Replay").wait_for()
        page.get_by_role("link", name="Download").wait_for()
    (file,) = room.configuration.parent.glob("*/*.mcap")
    return file


def test_it_is_replayed_by_the_keyboard_alone(browser, room, recording):
    with tab(browser) as page:
        page.goto(f"{room.url}/#recordings")
        replay = page.get_by_role("button", name=f"Replay {recording.name}")
        replay.wait_for()
        replay.focus()
        page.keyboard.press("Enter")
        until(page, SHOWN_PICTURE)
        first = page.locator(".replay img").get_attribute("src")
        for _ in range(5):
            page.keyboard.press("ArrowRight")
        assert until(page, SHOWN_S) == pytest.approx(0.5)
        assert page.get_by_role("slider").get_attribute("aria-valuetext").startswith("0.5 of ")
        until(page, f"document.querySelector('.replay img').src !== '{first}' && {SHOWN_PICTURE} === 640")
        values = page.get_by_role("region", name=f"Replay of {recording.name}")
        assert "ball" in values.get_by_role("list").first.inner_text()


def test_one_that_is_damaged_says_what_is_wrong_and_can_be_replayed_as_far_as_it_goes(browser, room, recording):
    whole = recording.read_bytes()
    cut, ruined = recording.with_name("cut.mcap"), recording.with_name("ruined.mcap")
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    ruined.write_bytes(b"\x89MCAP0\r\n" + bytes(1000))
    with tab(browser) as page:
        page.goto(f"{room.url}/#recordings")
        row = page.get_by_role("listitem").filter(has_text="cut.mcap")
        row.get_by_text("its end is missing").wait_for()
        row.get_by_role("button", name="Replay").click()
        until(page, SHOWN_PICTURE)
        other = page.get_by_role("listitem").filter(has_text="ruined.mcap")
        assert "Damaged: " in other.inner_text()
        assert other.get_by_role("button", name="Replay").count() == 0
        assert other.get_by_role("button", name="Delete").count() == 1
    cut.unlink()
    ruined.unlink()


def test_what_the_rules_in_the_field_would_have_done_on_it_is_drawn_beside_what_was_done(browser, room, recording):
    with tab(browser) as page:
        page.goto(f"{room.url}/#edit")
        here = page.get_by_role("region", name="On a recording")
        here.get_by_role("button", name="What would this have done?").click()
        here.get_by_text("Every event is the same.").wait_for()
        chart = here.get_by_role("slider")
        chart.focus()
        read = ""
        for _ in range(120):  # steps in all: at some time in it a rule was active
            page.keyboard.press("ArrowLeft")
            read = until(page, "document.querySelector('[aria-label=\"On a recording\"] .read').textContent")
            if re.search(r"ball \d.* · (\w+), then active · \1, now active", read):
                return
        raise AssertionError(read)


def test_it_is_deleted_only_after_a_question(browser, room, recording):
    other = recording.with_name("other.mcap")
    other.write_bytes(recording.read_bytes())
    with tab(browser) as page:
        page.goto(f"{room.url}/#recordings")
        delete = page.get_by_role("button", name="Delete other.mcap")
        delete.click()
        page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
        assert other.exists()
        delete.click()
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        page.get_by_text("other.mcap is deleted.").first.wait_for()
        until(page, "!document.body.innerText.includes('Download other') && !document.querySelector('dialog')")
        assert not other.exists()
        assert recording.exists()


def test_what_the_documents_install_for_the_page_can_record():
    extras = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())["project"]
    needed = extras["optional-dependencies"]
    assert set(needed["record"]) <= set(needed["web"])


# Clips in a real browser: kept by a button, and opened from the alarm that they are of.

BOX = '\n[black_box]\nbefore = "3 s"\nafter = "1 s"\n'


@pytest.fixture(scope="module")
def room_with_clips(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("clips"), ROOM + BOX) as serving:
        yield serving


@pytest.mark.long
def test_an_alarm_leads_to_the_moment_of_its_clip_with_the_picture_beside_its_sentence(
    browser: Any, room_with_clips: Served
) -> None:
    with tab(browser) as page:
        page.goto(f"{room_with_clips.url}/#alarms")
        link = page.locator(".alarms").get_by_role("link", name="Watch the clip")
        link.wait_for()
        link.click()
        page.locator(".replay img").wait_for(state="attached")
        until(page, SHOWN_PICTURE)
        assert until(page, SHOWN_S) > 0.5
        until(page, "document.querySelector('.replay').innerText.includes('near')")
        page.go_back()
        link = page.locator(".events").get_by_role("link", name="Watch the clip").first
        link.wait_for()
        assert link.bounding_box()["height"] < 30, "on one line"


# The timeline in a real browser: a day at once, scrolled and zoomed by every means, and a moment explained.

CHART = "document.querySelector('.timeline-chart').dataset"
SPAN_S = f"({CHART}.to - {CHART}.from)"
HOUR_S = 3600


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Serve a run that keeps a timeline, and has kept a day of it."""
    folder = tmp_path_factory.mktemp("timeline")
    keep_day(folder / "timeline" / "stadimeter", time.time() - 60)
    with served(folder, f'[timeline]\nkeep = "7 d"\n{STILL}') as serving:
        yield serving


def opened(page: Any, here: Served) -> Any:
    page.goto(f"{here.url}/#timeline")
    chart = page.locator(".timeline-chart[data-step]")
    chart.wait_for()
    return chart


def test_a_day_is_there_at_once_and_zooming_in_shows_each_second(browser: Any, here: Served) -> None:
    with tab(browser) as page:
        chart = opened(page, here)
        assert until(page, SPAN_S) == pytest.approx(24 * HOUR_S, abs=5)
        assert chart.get_attribute("data-step") == "120"
        box = page.locator(".u-over").bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        for _ in range(40):
            page.mouse.wheel(0, -300)
        until(page, f"{SPAN_S} < 60 && {CHART}.step === '1'")


def test_the_keyboard_reads_scrolls_zooms_and_explains(browser: Any, here: Served) -> None:
    with tab(browser) as page:
        chart = opened(page, here)
        chart.focus()
        for _ in range(30):
            page.keyboard.press("ArrowLeft")
        words = until(page, "document.querySelector('.timeline .read').textContent")
        assert "ball" in words
        assert chart.get_attribute("aria-valuetext") == words
        page.keyboard.press("+")
        until(page, f"{SPAN_S} < 80000")
        before = page.evaluate(f"Number({CHART}.to)")
        page.keyboard.press("PageUp")
        until(page, f"Number({CHART}.to) < {before - HOUR_S}")
        page.keyboard.press("Enter")
        page.get_by_role("region", name="The moment").get_by_role("heading", name="Rules").wait_for()


def test_a_click_on_the_past_tells_what_is_known_of_it(browser: Any, here: Served) -> None:
    with tab(browser) as page:
        opened(page, here)
        box = page.locator(".u-over").bounding_box()
        page.mouse.click(box["x"] + box["width"] / 3, box["y"] + 60)
        told = page.get_by_role("region", name="The moment")
        told.get_by_text("No recording holds this moment").wait_for()
        assert "near" in told.inner_text()
        assert " m ±" in told.inner_text() or "not measured" in told.inner_text()
        told.get_by_role("button", name="Close").click()
        assert told.count() == 0


def test_live_values_go_on_at_the_right_edge_and_the_run_explains_them(browser: Any, here: Served) -> None:
    with tab(browser) as page:
        chart = opened(page, here)
        page.get_by_role("button", name="Show 10 min").click()
        until(page, f"{CHART}.step === '1'")
        before = page.evaluate(f"Number({CHART}.to)")
        until(page, f"Number({CHART}.to) > {before + 7}")
        chart.focus()
        page.keyboard.press("ArrowLeft")  # 5 s
        words = until(page, "document.querySelector('.timeline .read').textContent")
        assert "ball 3." in words
        assert "far active" in words
        page.keyboard.press("Enter")
        page.get_by_role("region", name="The moment").get_by_text("By the run itself").wait_for()


def test_it_opens_with_all_that_is_there_and_shows_which_span_that_is(browser: Any, room: Served) -> None:
    with tab(browser) as page:
        opened(page, room)
        pressed = page.locator("[aria-pressed=true]")
        page.get_by_role("button", name="Show 10 min", pressed=True).wait_for()
        assert until(page, SPAN_S) == pytest.approx(600, abs=5)
        page.get_by_role("button", name="Zoom in").click()
        pressed.wait_for(state="detached")
        page.get_by_role("button", name="Show 6 h").click()
        assert pressed.all_inner_texts() == ["6 h"]


def test_thresholds_are_asked_for_again_when_the_run_goes_by_another_configuration(browser: Any, room: Served) -> None:
    with tab(browser) as page:
        opened(page, room)
        page.get_by_role("region", name="What if").wait_for()
        room.configuration.write_text(ROOM.replace('below = "1 m"', 'below = "1.2 m"'))
        with page.expect_response("**/timeline/marks*") as marks:
            page.evaluate("import('/static/api.js').then(({ api }) => api.post('run/reload'))")
        near = [each for each in marks.value.json()["thresholds"] if each["rule"] == "near"]
        assert near[0]["value_m"] == pytest.approx(1.2)


LANE = """() => {
    const chart = document.querySelector(".timeline-chart");
    const canvas = chart.querySelector("canvas");
    const wanted = ["good", "alarm"].map((name) => {
        const ink = new OffscreenCanvas(1, 1).getContext("2d");
        ink.fillStyle = getComputedStyle(chart).getPropertyValue(`--${name}`);
        ink.fillRect(0, 0, 1, 1);
        return [...ink.getImageData(0, 0, 1, 1).data].join();
    });
    const lanes = Math.round(canvas.height - (2 * 30 + 6) * devicePixelRatio);
    const { data } = canvas.getContext("2d").getImageData(0, lanes, canvas.width, Math.round(30 * devicePixelRatio));
    const found = new Set();
    for (let at = 0; at < data.length; at += 4) found.add([...data.slice(at, at + 4)].join());
    return wanted.map((colour) => found.has(colour));
}"""


def test_a_rule_that_only_drives_an_output_is_green_as_on_the_live_page(browser: Any, here: Served) -> None:
    with tab(browser) as page:
        opened(page, here)
        page.get_by_role("button", name="Show 10 min").click()
        deadline_s = time.monotonic() + 60
        while page.evaluate(LANE) != [True, False]:
            assert time.monotonic() < deadline_s, page.evaluate(LANE)
            page.wait_for_timeout(200)


TAKEN = """() => {
    const area = document.querySelector(".u-over");
    window.heard = [];
    for (const kind of ["pointerdown", "pointermove", "pointercancel", "pointerup"])
        area.parentElement.addEventListener(kind, (event) => (window.heard.push(kind), event.preventDefault()), true);
}"""


def test_what_a_finger_drags_on_the_chart_goes_with_it_and_the_page_stays(browser: Any, here: Served) -> None:
    with tab(browser, size=PHONE) as page:
        opened(page, here)
        page.evaluate(TAKEN)
        box = page.locator(".u-over").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        fingers = page.context.new_cdp_session(page)
        fingers.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
        for moved in range(10, 110, 10):
            point = {"x": x, "y": y - moved}
            fingers.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [point]})
        fingers.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        heard = until(page, "window.heard.includes('pointerup') && window.heard")
        assert "pointercancel" not in heard
        assert page.evaluate("scrollY") == 0
