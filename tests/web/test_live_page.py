"""The live page in a real browser: what it shows, and what a person does on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from stadimeter.web.passwords import PasswordFile
from support.browser import DESKTOP, PHONE, ROOM, SILENT_AFTER_ONE, STILL, Served, served, tab, until


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("still"), STILL) as serving:
        yield serving


@pytest.fixture
def moving(tmp_path) -> Iterator[Served]:
    with served(tmp_path) as serving:
        yield serving


def opened(page: Any, here: Served, view: str = "live") -> None:
    page.goto(f"{here.url}/#{view}")
    page.get_by_text("live", exact=True).wait_for()


def unfold(page: Any, title: str) -> None:
    page.locator(".fold > details:not([open]) > summary", has_text=title).click()


def text_of(page: Any, selector: str) -> str:
    return page.locator(selector).first.inner_text()


DRAWN = """async () => {
    const { Frame } = await import("/static/views/live/picture.js");
    const { html, render } = await import("/static/ui.js");
    const grey = new OffscreenCanvas(400, 300);
    const ink = grey.getContext("2d");
    ink.fillStyle = "#808080";
    ink.fillRect(0, 0, 400, 300);
    const outline_px = [[100, 200], [200, 200], [200, 280], [100, 280]];
    const detection = { status: "found", centre_px: [150, 240], width_px: 100, height_px: 80, outline_px };
    const measured = { is_valid: true, distance_m: 2, sigma_m: 0.01, detection };
    const target = { name: "ball", status: "tracking", rejected: [], ...measured };
    const frame = { width_px: 400, height_px: 300, captured_unix_s: 12.5 };
    const snapshot = { frame, targets: [target], narration: "", recording: null };
    const bitmap = await createImageBitmap(grey);
    const subscribe = (fn) => (fn(snapshot, bitmap), () => {});
    const live = { ageMs: () => 0, state: { status: "live" }, snapshot, subscribe, watch: () => () => {} };
    const main = document.getElementById("main");
    main.replaceChildren();
    render(html`<${Frame} live=${live} unit=${{ symbol: "m", size_m: 1, decimals: 3 }} />`, main);
    const canvas = main.querySelector("canvas");
    while (!canvas.dataset.drawn) await new Promise(requestAnimationFrame);
    const scale = canvas.width / 400;
    const pixels = canvas.getContext("2d");
    const on = (px) => Math.round((px + 0.5) * scale);
    const at = (x, y) => [...pixels.getImageData(on(x), on(y), 1, 1).data].slice(0, 3);
    const places = { edge: at(130, 200), centre: at(150, 240), inside: at(130, 220), outside: at(50, 50) };
    const told = { ...places, captured: canvas.dataset.captured, words: main.querySelector(".figure").innerText };
    render(null, main);
    return told;
}"""


def test_the_outline_lies_where_the_message_of_its_frame_says(browser, still):
    with tab(browser, device_scale_factor=2) as page:
        opened(page, still, "alarms")
        drawn = page.evaluate(DRAWN)
        assert drawn["edge"] == drawn["centre"] == [0xFF, 0xE1, 0x4D]
        assert drawn["inside"] == drawn["outside"] == [0x80, 0x80, 0x80]
        assert drawn["captured"] == "12.5"
        assert drawn["words"].split() == ["2.00", "m", "±", "0.01"]


def test_distances_are_shown_in_the_unit_that_a_person_chose_and_remembered(browser, still):
    with tab(browser) as page:
        opened(page, still)
        value = page.locator(".target .value")
        until(page, "parseFloat(document.querySelector('.target .value')?.textContent) > 3.1")
        assert float(value.inner_text()) == pytest.approx(3.2, rel=0.03)
        page.get_by_label("Lengths in").select_option("ft")
        until(page, "parseFloat(document.querySelector('.target .value')?.textContent) > 9")
        page.reload()
        until(page, "parseFloat(document.querySelector('.target .value')?.textContent) > 9")
        assert "ft" in text_of(page, ".figure .unit")
        assert " ft" in text_of(page, ".rule .body")


def test_an_alarm_is_acknowledged_and_reset_with_a_name_and_a_reason(browser, moving):
    with tab(browser, size=PHONE) as page:
        opened(page, moving)
        page.get_by_text("latched, not acknowledged").wait_for()
        unfold(page, "Events")
        page.get_by_role("button", name="Acknowledge: near").press("Enter")
        page.get_by_label("Why").fill("on my way")
        page.get_by_label("Your name").fill("zoe")
        page.keyboard.press("Enter")
        page.locator(".event", has_text="near acknowledged by zoe").wait_for()
        page.get_by_text("on my way").first.wait_for()
        page.get_by_role("button", name="Reset: near").press("Enter")
        page.get_by_role("dialog").get_by_role("button", name="Reset").click()
        page.locator(".event", has_text="near reset by zoe").wait_for()


def test_a_dialog_keeps_what_was_typed_where_the_run_refuses_and_asks_before_it_loses_it(browser, moving):
    with tab(browser) as page:
        opened(page, moving)
        page.get_by_role("button", name="Acknowledge: near").click()
        dialog = page.get_by_role("dialog")
        refused = {"error": {"code": "gone", "message": "the run did not take it"}}
        page.route("**/ack", lambda route: route.fulfill(status=409, json=refused))
        page.get_by_label("Why").fill("on my way")
        page.keyboard.press("Enter")
        dialog.get_by_text("the run did not take it").wait_for()
        assert page.get_by_label("Why").input_value() == "on my way"
        page.keyboard.press("Escape")
        dialog.get_by_text("What you changed is lost").wait_for()
        page.get_by_label("Why").fill("I am there")  # a change means that one stays
        page.keyboard.press("Escape")
        dialog.get_by_text("What you changed is lost").wait_for()
        page.keyboard.press("Escape")
        dialog.wait_for(state="detached")


def test_nothing_is_said_of_rules_before_the_run_has_told_them(browser, still):
    with tab(browser) as page:
        page.route("**/live?*", lambda _: None)
        page.goto(still.url)
        page.get_by_text("The rules and the outputs of the run stand here.").wait_for()
        assert page.get_by_text("No rule").count() == page.get_by_text("No output").count() == 0


SPOKEN = """() => {
    window.spoken = [];
    new MutationObserver((changes) => window.spoken.push(...changes.map(({ target }) => target.textContent)
        .filter((_, at) => (changes[at].target.parentElement ?? document.body).closest("[role=status], [role=alert]"))))
        .observe(document.body, { subtree: true, childList: true, characterData: true });
}"""


@pytest.mark.parametrize("view", ["live", "timeline", "alarms"])
def test_figures_that_go_on_changing_are_not_read_aloud(browser, moving, view):
    with tab(browser) as page:
        opened(page, moving, view)
        page.locator(".view > *").first.wait_for()
        page.wait_for_timeout(1000)
        page.evaluate(SPOKEN)
        page.wait_for_timeout(3000)
        assert len(set(page.evaluate("window.spoken"))) <= 3  # an alarm that comes or goes, a machine that stands still


FITS = f"""[".picture", ".chart", ".rules", ".output", ".output ~ .output"].every((part) => {{
    const shown = document.querySelector(part);
    return shown && shown.getBoundingClientRect().bottom <= {DESKTOP[1]};
}})"""


def test_picture_chart_rules_and_outputs_are_on_the_first_screen_of_a_laptop(browser, moving):
    with tab(browser) as page:
        opened(page, moving)
        page.locator("canvas[data-drawn]").wait_for()
        page.locator(".chart .uplot").wait_for()
        until(page, FITS)  # a banner of a late frame, as a busy computer has them, makes room again when it goes


PLACES = """async () => {
    const { steadyDistances, UNITS } = await import("/static/format.js");
    const steady = steadyDistances();
    const places = (sigma_m) => steady("ball", 2.3456, sigma_m, UNITS.m).value.split(".")[1].length;
    return [0.0094, 0.0096, 0.0093, 0.012, 0.0091, 0.03, 0.0094, 0.007, 0.004].map(places);
}"""


def test_the_number_changes_its_last_digit_only_when_the_deviation_has_clearly_changed(browser, still):
    with tab(browser) as page:
        opened(page, still, "alarms")
        assert page.evaluate(PLACES) == [3, 3, 3, 3, 3, 2, 2, 2, 3]


COUNTED = """async () => {
    const { alarmsInWords } = await import("/static/others.js");
    const one = { acknowledged: true, status: "active", inhibits: [] };
    return ["info", "warning", "alarm"].map((severity) => alarmsInWords([{ ...one, severity }]));
}"""


def test_what_is_for_information_only_is_not_counted_as_an_alarm(browser, still):
    with tab(browser) as page:
        opened(page, still, "alarms")
        assert page.evaluate(COUNTED) == ["", "1 alarm", "1 alarm"]


def test_an_output_is_on_only_while_the_button_is_held(browser, still):
    with tab(browser) as page:
        opened(page, still)
        buzzer = page.locator(".output", has_text="buzzer")
        buzzer.locator("summary").click()
        level = "document.querySelectorAll('.output')[1].querySelector('output').textContent"
        pressed = "document.querySelectorAll('.output')[1].querySelector('.hold').getAttribute('aria-pressed')"
        held = f"{level} === '50 %' && document.querySelectorAll('.output')[1].textContent.includes('held by')"
        button = buzzer.get_by_role("button", name="Hold to test")

        def hold(press: Callable[[], None], let_go: Callable[[], None]) -> None:
            press()
            # A busy computer answers too late to hold an output: the page says so, and a person presses again.
            while until(page, f"{held} ? 'on' : {pressed} === 'false' && 'too slow'") == "too slow":
                let_go()
                press()

        button.hover()
        hold(page.mouse.down, page.mouse.up)
        page.mouse.up()
        until(page, f"{level} === '0 %'")
        button.focus()
        hold(lambda: page.keyboard.down(" "), lambda: page.keyboard.up(" "))
        page.evaluate("window.dispatchEvent(new Event('blur'))")
        until(page, f"{level} === '0 %'")
        assert button.get_attribute("aria-pressed") == "false"


def test_a_hold_that_ended_begins_with_a_new_press_only_though_the_key_is_down(browser, still):
    with tab(browser) as page:
        opened(page, still)
        buzzer = page.locator(".output", has_text="buzzer")
        buzzer.locator("summary").click()
        asked: list[Any] = []
        refused = {"error": {"code": "held", "message": "another holds it"}}

        def refuse(route):
            asked.append(route.request.post_data_json)
            route.fulfill(status=409, json=refused)

        page.route("**/hold", refuse)
        buzzer.get_by_role("button", name="Hold to test").focus()
        page.keyboard.down(" ")
        buzzer.get_by_text("another holds it").wait_for()
        for _ in range(3):
            page.keyboard.down(" ")  # as a key that is held down repeats itself
        assert buzzer.get_by_role("button", name="Hold to test").get_attribute("aria-pressed") == "false"
        page.keyboard.up(" ")
        assert len([each for each in asked if "level" in each]) == 1


def test_the_ball_is_moved_and_hidden_in_the_simulated_room(browser, moving):
    with tab(browser) as page:
        opened(page, moving)
        ball = page.get_by_role("button", name="ball in the room")
        ball.hover()
        plan = page.locator(".plan").bounding_box()  # where it is now that the page was scrolled
        page.mouse.down()
        page.mouse.move(plan["x"] + plan["width"] / 2, plan["y"] + 0.15 * plan["height"], steps=5)
        assert ball.evaluate("e => getComputedStyle(e).outlineStyle") == "none"  # its pixels would be metres
        page.mouse.up()
        where = page.locator(".room .number")
        until(page, "/from the camera, ahead/.test(document.querySelector('.room .number')?.textContent)")
        far_m = float(where.inner_text().split()[1])
        until(page, f"Math.abs(parseFloat(document.querySelector('.target .value')?.textContent) - {far_m}) < 0.15")
        page.get_by_label("hide target").check()
        page.locator(".target.is-unknown").wait_for()


def test_a_frozen_picture_and_an_ended_run_cannot_be_overlooked(browser, moving):
    with tab(browser) as page:
        opened(page, moving)
        page.locator("canvas[data-drawn]").wait_for()
        page.locator(".old").wait_for(state="hidden")
        page.get_by_label("freeze camera").press("Space")  # a click may miss what moves
        page.get_by_text("Old picture:").wait_for()
        page.get_by_text("Outputs are at their safe values").wait_for()
        page.get_by_label("freeze camera").press("Space")
        page.locator(".old").wait_for(state="hidden")
        moving.run.terminate()
        moving.run.wait()
        page.get_by_text("not connected").wait_for()
        page.get_by_role("button", name="Start the run").wait_for()
        moving.start_run()
        page.get_by_text("live", exact=True).wait_for()


def test_a_run_that_must_be_armed_acts_once_a_person_arms_it(browser, tmp_path):
    with served(tmp_path, STILL + '[safety]\narm = "by-command"\n') as here, tab(browser) as page:
        opened(page, here)
        page.get_by_text("disarmed since the start").first.wait_for()
        page.locator(".banner").get_by_role("button", name="Arm").click()
        page.get_by_role("dialog").get_by_role("button", name="Arm").click()
        page.locator(".banner").wait_for(state="detached")
        until(page, "document.querySelector('.output output').textContent !== '0 %'")


def test_who_may_only_read_sees_everything_and_operates_nothing(browser, tmp_path):
    passwords = tmp_path / "passwords"
    PasswordFile(passwords).set("read", "only to look")
    PasswordFile(passwords).set("operate", "to operate too")
    options = ("--password-file", str(passwords), "--address", "127.0.0.1")
    with served(tmp_path, ROOM, *options) as here, tab(browser) as page:
        page.goto(here.url)
        page.locator("input[type=password]").fill("only to look")
        page.keyboard.press("Enter")
        page.get_by_text("live", exact=True).wait_for()
        page.locator("canvas[data-drawn]").wait_for()
        page.locator(".badge", has_text="not acknowledged").wait_for()
        unfold(page, "About the picture")
        page.get_by_text("You are logged in to look").wait_for()
        for name in ("Acknowledge", "Reset", "Hold to test", "Record", "Let it go on", "forwards", "Stop every output"):
            assert page.get_by_role("button", name=name).count() == 0
        assert page.locator(".room input:not(:disabled)").count() == 0
        assert page.get_by_role("link", name="Edit").count() == 0
        page.get_by_role("button", name="Log out").click()
        page.locator("input[type=password]").wait_for()


def test_a_connection_that_fell_silent_is_made_anew(browser, still):
    with tab(browser) as page:
        page.clock.install()
        page.add_init_script(f"({SILENT_AFTER_ONE})()")
        page.goto(still.url)
        until(page, "window.isSilent === true")
        page.clock.fast_forward("00:30")
        page.get_by_text("live", exact=True).wait_for()
        page.locator("canvas[data-drawn]").wait_for()
