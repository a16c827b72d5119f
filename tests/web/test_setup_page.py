"""The set-up in a real browser: each question, what is wrong with an answer, and that nothing is lost."""

from __future__ import annotations

import json

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.setup.interview import ANSWERS, load_answers, save_answers
from support.browser import DESKTOP, PHONE, TABLET, served, tab, until
from support.page import faults_of

CAMERA = {"camera": "simulated"}
TARGET = {**CAMERA, "target": "ball", "size": "20 cm"}
COLOUR = {**TARGET, "colour": "21,46,38:52,255,255"}
LENS = {**COLOUR, "calibration": "56 deg"}
RECIPE = {**LENS, "recipe": "far"}
BLANKS = {**RECIPE, "far_from": "2 m", "far_to": "4 m"}
ALL = {**BLANKS, "far_output": "screen"}


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """Return a page of a configuration that is not there yet; nothing runs."""
    with served(tmp_path_factory.mktemp("setup"), None, runs=False) as started:
        yield started


@pytest.fixture
def page(browser):
    with tab(browser) as opened:
        yield opened


def begin_at(page, here, answers):
    """Open the set-up where it was left with these answers."""
    page.request.post(f"{here.url}/api/v1/setup/leave", data={}, headers={"Origin": here.url})
    here.configuration.unlink(missing_ok=True)
    save_answers(here.configuration.parent / ANSWERS, answers)
    page.goto(f"{here.url}/#setup")
    page.wait_for_selector(".setup")


def asked(page):
    return page.locator("h1").inner_text()


def go_on(page):
    """Press the button that goes on, and wait until the next question is asked, or something is said about this one."""
    before = asked(page)
    page.locator(".setup-way .primary").click()
    until(
        page,
        f"document.querySelector('h1')?.innerText !== {json.dumps(before)}"
        " || document.querySelector('.setup-doubt, .setup-error:not([hidden])') !== null",
    )


def kept(here):
    return load_answers(here.configuration.parent / ANSWERS)


@pytest.mark.parametrize(
    ("answers", "wrong", "words"),
    [
        pytest.param({}, "", "othing is chosen yet", id="no camera"),
        pytest.param(LENS, "", "othing is chosen yet", id="no recipe"),
        pytest.param({}, "/dev/video97", "video97", id="a camera that is not there"),
        pytest.param(CAMERA | {"target": "ball"}, "0 cm", "above zero", id="a size of nothing"),
        pytest.param(BLANKS, "buzzer 99", "99", id="a pin that the header has not"),
    ],
)
def test_an_answer_that_cannot_be_used_gets_its_sentence_and_nothing_is_lost(page, here, answers, wrong, words):
    begin_at(page, here, answers)
    question = asked(page)
    if not page.locator(".setup-text input").is_visible():
        page.locator(".setup-text summary").click()
    page.locator(".setup-text input").fill(wrong)
    go_on(page)
    assert words in page.locator(".setup-error:not([hidden])").first.inner_text()
    assert asked(page) == question
    assert page.locator(".setup-text input").input_value() == wrong
    assert kept(here) == answers


def test_a_set_up_that_was_left_is_taken_up_at_its_question_and_goes_back_to_any(page, here):
    begin_at(page, here, RECIPE)
    assert "From which distance on?" in asked(page)
    page.reload()
    page.wait_for_selector(".setup")
    assert "From which distance on?" in asked(page)
    page.get_by_role("button", name="Change the answer to size: 20 cm").click()
    page.get_by_role("heading", name="How large is the ball?").wait_for()
    assert page.locator(".setup-text input").input_value() == "20 cm"
    assert list(kept(here)) == ["camera", "target"]


def test_nine_clicks_lead_from_a_camera_to_a_buzzer(page, here):
    begin_at(page, here, {})
    clicks = 0

    def click(locator):
        nonlocal clicks
        locator.click()
        clicks += 1

    def on(heading):
        click(page.locator(".setup-way .primary"))
        page.get_by_role("heading", name=heading).wait_for()

    page.get_by_label("simulated", exact=False).click()  # one that is there is chosen already
    on("What shall be measured?")
    on("What colour is the ball?")
    click(page.locator(".setup-stage-picture img"))
    page.locator(".setup-found.is-good").wait_for()
    on("How far away is the ball?")
    on("What shall happen?")
    page.locator(".setup-open:visible input").fill("80 cm")
    on("drive?")
    click(page.get_by_role("radio", name="buzzer 23"))
    on("Save, and run it")
    page.get_by_role("heading", name="All 2 tests pass").wait_for()
    assert clicks + 1 == 9, "one more runs it"
    assert kept(here)["near_near"] == "80 cm"


def test_it_begins_anew_only_after_a_question(page, here):
    begin_at(page, here, LENS)
    page.get_by_role("button", name="Begin anew").click()
    page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    assert "What shall happen?" in asked(page)
    page.get_by_role("button", name="Begin anew").click()
    page.get_by_role("dialog").get_by_role("button", name="Begin anew").click()
    page.get_by_role("heading", name="Which camera?").wait_for()


def test_a_computer_that_is_not_set_up_begins_with_the_set_up(page, here):
    page.request.post(f"{here.url}/api/v1/setup/leave", data={}, headers={"Origin": here.url})
    here.configuration.unlink(missing_ok=True)
    page.goto(here.url)
    page.wait_for_selector(".setup")
    assert page.locator(".setup-way .primary").is_visible()
    page.get_by_text("not connected").wait_for()
    assert page.locator(".banner").count() == 0, "it says to set it up, where that is done"


def test_a_pin_is_chosen_and_its_wiring_and_its_danger_are_shown(page, here):
    begin_at(page, here, BLANKS)
    page.get_by_role("radio", name="vibration-motor 18").check()
    page.get_by_alt_text("How the vibration-motor is wired to GPIO 18").wait_for()
    page.get_by_label("The pin of its signal").select_option("15")
    page.get_by_alt_text("wired to GPIO 15").wait_for()
    page.get_by_text("Careful: it is used for the serial console").wait_for()
    page.get_by_label("The pin of its signal").select_option("18")
    page.get_by_alt_text("wired to GPIO 18").wait_for()
    go_on(page)
    assert kept(here)["far_output"] == "vibration-motor 18"


def test_save_says_that_the_tests_pass_and_writes_a_configuration_that_loads(page, here):
    begin_at(page, here, ALL)
    page.get_by_role("heading", name="All 2 tests pass").wait_for()
    assert "`" not in page.locator(".setup-words").inner_text()
    page.get_by_role("button", name="Save only").click()
    page.get_by_text("It is saved.").wait_for()
    written = load_configuration(here.configuration)
    assert [rule.name for rule in written.plan.rules] == ["far"]


def test_a_run_that_dies_while_it_shall_take_over_is_told_and_the_next_press_starts_one(browser, tmp_path):
    with served(tmp_path) as here, tab(browser) as page:
        save_answers(tmp_path / ANSWERS, ALL)
        page.goto(f"{here.url}/#live")
        page.get_by_text("live", exact=True).wait_for()
        page.goto(f"{here.url}/#setup")
        press = page.get_by_role("button", name="Save, and run it")
        press.wait_for()

        def killed_first(route):
            here.run.kill()
            here.run.wait()
            route.continue_()

        page.route("**/run/restart", killed_first)
        press.click()
        page.get_by_text("It is saved, but it does not run").wait_for()
        assert "[rules.near]" not in here.configuration.read_text()
        press.click()
        page.locator("canvas[data-drawn]").wait_for()
        load_configuration(here.configuration)


def test_saving_over_what_another_has_saved_shows_what_changes_in_theirs(page, here):
    begin_at(page, here, ALL)
    page.get_by_role("heading", name="All 2 tests pass").wait_for()
    here.configuration.write_text("# of another\n")
    page.get_by_role("button", name="Save only").click()
    page.get_by_text("Below is what yours changes in theirs").wait_for()
    assert here.configuration.read_text() == "# of another\n"
    assert "- # of another" in page.locator(".difference").inner_text()
    page.get_by_role("button", name="Save only").click()
    page.get_by_text("It is saved.").wait_for()
    page.reload()
    page.wait_for_selector(".setup")
    assert "[rules.far]" in here.configuration.read_text()


ON_TOP = """() => {
    const go = document.querySelector(".setup-way .primary");
    const { left, top, width, height } = go.getBoundingClientRect();
    return document.elementFromPoint(left + width / 2, top + height - 4) === go;
}"""


def test_the_way_on_is_in_sight_on_a_phone(browser, here):
    with tab(browser, size=PHONE) as page:
        for answers in ({}, CAMERA, TARGET, COLOUR, LENS, BLANKS, ALL):
            begin_at(page, here, answers)
            page.locator(".setup-way .primary").wait_for()
            assert page.evaluate(ON_TOP), answers


@pytest.mark.parametrize("size", [PHONE, TABLET, DESKTOP])
@pytest.mark.parametrize("answers", [{}, COLOUR, BLANKS, ALL])
def test_nothing_is_cut_off_or_hard_to_read_in_any_step(browser, here, size, answers):
    with tab(browser, size=size, scheme="dark" if size == TABLET else "light") as page:
        begin_at(page, here, answers)
        page.locator(".setup-stage-picture img[src]" if answers else ".setup-look img").first.wait_for()
        assert not faults_of(page)
