"""The set-up in a real browser: each question, what is wrong with an answer, and that nothing is lost."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.workbench.setup.interview import ANSWERS, load_answers, save_answers
from support.browser import DESKTOP, PHONE, TABLET, served, tab, until
from support.cameras import StreamServer
from support.networks import bright_figure, put_figure, write_network
from support.page_checks import faults_of
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.cut_sheet import GroupTarget
from support.scenes.render import render
from support.scenes.scene import Scene

BALLS = Path(__file__).resolve().parents[3] / "shared" / "data" / "tennis_ball" / "images"

CAMERA = {"camera": "simulated"}
TARGET = {**CAMERA, "target": "ball", "size": "20 cm"}
COLOUR = {**TARGET, "colour": "21,46,38:52,255,255"}
LENS = {**COLOUR, "calibration": "56 deg"}
WISH = {**LENS, "wish": "far"}
BLANKS = {**WISH, "far_from": "2 m", "far_to": "4 m"}
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


def test_enter_goes_through_the_simulated_room_from_nothing_to_what_shall_happen(page, here):
    begin_at(page, here, {})
    page.get_by_label("simulated").check()
    page.keyboard.press("Enter")
    for question in ("What shall be measured?", "How large is the ball?", "What colour is the ball?"):
        page.get_by_role("heading", name=question).wait_for()
        if "colour" in question:
            page.get_by_role("button", name="Look for it").click()
            page.locator(".setup-found.is-good").wait_for()
            page.get_by_role("button", name="Go on").focus()
        page.keyboard.press("Enter")
    page.get_by_role("heading", name="How far away is the ball?").wait_for()
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="farther away").wait_for()
    page.get_by_text(re.compile(r"Focal length 60\d px ± ")).wait_for()
    page.get_by_label("Distance of the simulated ball").fill("3.1")
    page.locator(".setup-caption").get_by_text(re.compile("(3[89]|40) px across")).wait_for()
    page.get_by_role("button", name="Take it as proof").click()
    page.get_by_role("heading", name="What shall happen?").wait_for()
    page.get_by_text("The two distances agree.").wait_for()
    rows = page.locator(".setup-outlook tbody tr")
    rows.first.wait_for()
    assert rows.count() >= 5


def test_a_click_on_the_ball_finds_its_colour_and_one_on_the_wall_says_what_is_wrong(page, here):
    begin_at(page, here, TARGET)
    picture = page.locator(".setup-stage-picture")
    page.locator(".setup-stage-picture img[src]").wait_for()
    box = picture.bounding_box()
    picture.click(position={"x": box["width"] / 2, "y": box["height"] / 2})
    page.get_by_text("1 picture counts.").wait_for()
    colour = page.locator(".setup-text input").input_value()
    assert re.fullmatch(r"\d+,\d+,\d+:\d+,\d+,\d+", colour)
    picture.click(position={"x": box["width"] * 0.04, "y": box["height"] * 0.06})
    page.locator(".setup-error:not([hidden]), .setup-found.is-warning").first.wait_for()
    assert "ball" in page.locator(".setup-error:not([hidden]), .setup-found.is-warning").first.inner_text()
    assert page.locator(".setup-text input").input_value() == colour


def test_clicks_are_listed_and_taken_back_one_by_one(page, here):
    begin_at(page, here, TARGET)
    picture = page.locator(".setup-stage-picture")
    page.locator(".setup-stage-picture img[src]").wait_for()
    box = picture.bounding_box()
    for share in (0.5, 0.505):
        picture.click(position={"x": box["width"] * share, "y": box["height"] / 2})
        page.get_by_role("button", name=re.compile("^Forget click")).nth(int(share > 0.5)).wait_for()
    page.get_by_role("button", name="Forget click 2").click()
    page.get_by_role("button", name="Forget click 2").wait_for(state="detached")
    page.get_by_role("button", name="Forget click 1").click()
    page.locator(".setup-found").get_by_text("Click on the ball.").wait_for()
    assert page.locator(".setup-text input").input_value() == ""


def test_the_cross_on_the_picture_moves_by_arrow_keys_and_enter_takes_its_place(page, here):
    begin_at(page, here, TARGET)
    picture = page.get_by_role("application")
    page.locator(".setup-stage-picture img[src]").wait_for()
    picture.focus()
    page.keyboard.press("ArrowLeft")
    page.locator(".setup-marks .is-cross").wait_for(state="attached")
    page.keyboard.press("Enter")
    page.get_by_text("1 picture counts.").wait_for()


@pytest.mark.parametrize(
    ("answers", "wrong", "words"),
    [
        pytest.param({}, "", "othing is chosen yet", id="no camera"),
        pytest.param(LENS, "", "othing is chosen yet", id="no wish"),
        pytest.param({}, "/dev/video97", "video97", id="a camera that is not there"),
        pytest.param(CAMERA | {"target": "ball"}, "0 cm", "above zero", id="a size of nothing"),
        pytest.param(BLANKS, "buzzer 99", "99", id="a pin that the header has not"),
    ],
)
def test_an_answer_that_cannot_be_used_gets_its_sentence_and_nothing_is_lost(page, here, answers, wrong, words):
    begin_at(page, here, answers)
    question = asked(page)
    page.locator(".setup-text summary").click()
    page.locator(".setup-text input").fill(wrong)
    go_on(page)
    assert words in page.locator(".setup-error:not([hidden])").first.inner_text()
    assert asked(page) == question
    assert page.locator(".setup-text input").input_value() == wrong
    assert kept(here) == answers


def test_the_same_distance_twice_proves_nothing_and_is_refused(page, here):
    begin_at(page, here, COLOUR)
    go_on(page)
    page.get_by_role("heading", name="farther away").wait_for()
    page.get_by_label("Distance", exact=True).fill("1")
    go_on(page)
    assert page.locator(".setup-error:not([hidden])").first.inner_text()
    assert "proof" not in kept(here)


def test_a_real_chessboard_before_the_camera_gives_the_lens_and_says_what_is_still_wanted(page, here, real_pictures):
    pictures = [cv2.imread(str(path)) for path in sorted((real_pictures / "chessboard").glob("left[0-9]*.jpg"))][::2]
    device = StreamServer(shown=pictures[0])
    try:
        begin_at(page, here, {**COLOUR, "camera": device.address})
        page.get_by_text("With a printed board").click()
        section = page.locator(".setup-by-board")
        section.get_by_label("Columns").fill("0")
        page.keyboard.press("Enter")
        section.get_by_text("A board has 3 to 60 columns and rows").wait_for()
        section.get_by_label("Columns").fill("9")
        page.keyboard.press("Enter")
        section.get_by_text("1 view, in").wait_for()
        assert "the board in the" in section.locator("li").first.inner_text()
        for views, picture in enumerate(pictures[1:5], start=2):
            device.shown = picture
            section.get_by_text(f"{views} views, in").wait_for()
        page.get_by_text(re.compile(r"Focal length 5[234]\d px ± \d")).wait_for()
        assert page.locator(".setup-marks .is-covered").count() >= 3
        section.get_by_role("button", name="Take this lens").click()
        page.get_by_role("heading", name="What shall happen?").wait_for()
        assert kept(here)["calibration"] == "init/board.toml"
    finally:
        page.request.post(f"{here.url}/api/v1/setup/leave", data={}, headers={"Origin": here.url})
        device.stop()


def test_a_set_up_that_was_left_is_taken_up_at_its_question_and_goes_back_to_any(page, here):
    begin_at(page, here, WISH)
    assert "From which distance on?" in asked(page)
    page.reload()
    page.wait_for_selector(".setup")
    assert "From which distance on?" in asked(page)
    page.get_by_role("button", name="Change the answer to size: 20 cm").click()
    page.get_by_role("heading", name="How large is the ball?").wait_for()
    assert page.get_by_label("Size", exact=True).input_value() == "20"
    assert list(kept(here)) == ["camera", "target"]


def test_an_answer_is_not_given_to_another_question_when_another_device_went_on(browser, page, here):
    begin_at(page, here, CAMERA)
    with tab(browser) as other:
        other.goto(f"{here.url}/#setup")
        other.get_by_role("heading", name="What shall be measured?").wait_for()
        other.get_by_label("sheet").check()
        go_on(other)
    page.locator(".setup-way .primary").click()
    page.get_by_text("on another device").wait_for()
    assert "How large is the sheet?" in asked(page)
    assert kept(here) == CAMERA | {"target": "sheet"}


def test_a_double_click_on_back_takes_one_answer_back(page, here):
    begin_at(page, here, BLANKS)
    back = page.get_by_role("button", name="Back", exact=True)
    # Both presses before the first answer, as on a slow device: the question is asked for only after them.
    page.route("**/api/v1/setup", lambda route: (page.wait_for_timeout(300), route.continue_()))
    back.evaluate("button => (button.click(), button.click())")
    page.get_by_role("heading", name="At which distance is it strongest?").wait_for()
    page.get_by_role("button", name="Go on").click()
    page.get_by_role("heading", name="What shall").wait_for()
    assert kept(here) == BLANKS


def test_a_wish_is_a_sentence_with_blanks_that_is_tried_while_it_is_filled_in(page, here):
    begin_at(page, here, WISH)
    assert "Vibrate when it is farther than" in page.locator(".setup-sentence").inner_text()
    lanes = page.get_by_role("img", name="If it came, went, and was gone")
    lanes.wait_for()
    page.locator(".setup-blank").last.fill("5 m")
    page.get_by_text("full at 5.00 m").wait_for()
    go_on(page)
    assert kept(here) == WISH | {"far_from": "2 m", "far_to": "5 m"}


def test_a_wish_that_counts_is_found_by_its_title_in_its_group_and_tried(browser, here):
    with tab(browser, size=(390, 844)) as page:
        begin_at(page, here, LENS)
        page.get_by_text("How often, and for how long").click()
        page.get_by_label("beep when it is near").uncheck()
        page.get_by_label("act when it comes three times within a minute").check()
        page.get_by_text("1 chosen").wait_for()
        assert page.get_by_text("1 chosen").count() == 1
        assert not faults_of(page)
        go_on(page)
        page.get_by_role("textbox", name="How often?", exact=True).first.fill("1")
        go_on(page)
        page.get_by_text("'1' is no number from 2 to 999").wait_for()
        page.get_by_role("textbox", name="How often?", exact=True).first.fill("2")
        page.get_by_role("textbox", name="Within what time?", exact=True).first.fill("2 min")
        page.get_by_text("is above 1 times").wait_for()
        page.get_by_role("img", name="If it came, went, and was gone").wait_for()
        go_on(page)
        page.get_by_role("heading", name="drive?").wait_for()
        assert kept(here) == LENS | {"wish": "often", "often_near": "1 m", "often_times": "2", "often_window": "2 min"}


def test_a_sentence_that_is_turned_around_is_told_and_what_is_told_covers_no_button(page, here):
    begin_at(page, here, WISH)
    page.locator(".setup-blank").first.fill("10 ft")
    page.locator(".setup-blank").last.fill("5 ft")
    go_on(page)
    page.get_by_text("5 ft is not farther than 10 ft").wait_for()
    page.get_by_text("If it came, went, and was gone").wait_for()
    go_on(page)
    assert kept(here) == WISH | {"far_from": "10 ft", "far_to": "4 m"}


def test_a_pin_is_chosen_by_the_keyboard_and_its_wiring_and_its_danger_are_shown(page, here):
    begin_at(page, here, BLANKS)
    page.get_by_label("vibration-motor 18").check()
    page.get_by_alt_text("How the vibration-motor is wired to GPIO 18").wait_for()
    page.get_by_role("radio", name="Pin 12, GPIO 18").focus()
    page.keyboard.press("ArrowUp")
    page.get_by_alt_text("wired to GPIO 15").wait_for()
    page.get_by_text("Careful: it is used for the serial console").wait_for()
    page.keyboard.press("ArrowDown")
    page.get_by_alt_text("wired to GPIO 18").wait_for()
    go_on(page)
    assert kept(here)["far_output"] == "vibration-motor 18"


def test_the_whole_drawing_of_the_wiring_is_seen_beside_the_pins(page, here):
    page.set_viewport_size({"width": 1120, "height": 900})
    begin_at(page, here, BLANKS)
    page.get_by_label("vibration-motor 18").check()
    page.get_by_alt_text("How the vibration-motor is wired to GPIO 18").wait_for()
    page.get_by_text("Wires to the header: pin 12 (GPIO 18), pin 14 (ground).").wait_for()
    hidden_px = "(e => e.scrollWidth - e.clientWidth)(document.querySelector('.setup-scrolls'))"
    assert page.evaluate(hidden_px) == 0


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


def test_a_run_that_does_not_start_is_told_and_the_set_up_stays_where_it_is(page, here):
    begin_at(page, here, ALL)
    press = page.get_by_role("button", name="Save, and run it")
    press.wait_for()
    words = "the run did not start: the camera is taken"
    refused = {"error": {"code": "not-started", "message": words}}
    page.route("**/run/start", lambda route: route.fulfill(status=409, json=refused))
    press.click()
    page.get_by_text(words).wait_for()
    with page.expect_response("**/setup/picture.jpg*") as picture:
        assert picture.value.status == 200
    page.get_by_text(words).wait_for()
    assert asked(page) == "Save, and run it"


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


def test_a_folder_of_pictures_has_a_distance_field_for_each_and_is_played_in_a_loop(page, here):
    folder = here.configuration.parent / "shots"
    folder.mkdir(exist_ok=True)
    for distance_m in (0.8, 1.2):
        ball = BallTarget(diameter_m=0.2, position_m=(0.0, 0.0, distance_m), bgr=(60, 200, 180))
        lens = CameraModel.with_focal_length(600.0, 640, 480)
        picture = render(Scene(camera=lens, target=ball, seed=1, backdrop=PlainBackdrop())).image
        cv2.imwrite(str(folder / f"{distance_m} m.png"), picture)
    begin_at(page, here, {})
    page.locator("summary", has_text="Answer in words").click()
    page.locator(".setup-text input").fill("shots")
    page.locator(".setup-thumbnails img").nth(1).wait_for()
    assert page.get_by_label("It begins again after the last").is_checked()
    page.get_by_label("How long each picture is shown").fill("1,5 s")
    page.get_by_label("How long each picture is shown").press("Tab")
    until(page, "document.querySelector('.setup-text input').value === 'shots rate=5Hz dwell=1,5s loop=yes'")
    go_on(page)
    (here.configuration.parent / "camera.toml").unlink(missing_ok=True)  # of another test: it would be offered first
    begin_at(page, here, {**kept(here), "target": "ball", "size": "20 cm", "colour": "20,60,60:50,255,255"})
    page.locator(".setup-thumbnails .is-found").nth(1).wait_for()
    fields = page.get_by_label("Distance in")
    assert [fields.nth(0).input_value(), fields.nth(1).input_value()] == ["0.8 m", "1.2 m"]  # their names say so
    fields.nth(0).fill("")
    fields.nth(1).fill("1,2 m")
    page.locator(".setup-way .primary").click()
    page.get_by_role("heading", name="What shall happen?").wait_for()
    assert kept(here)["calibration"] == "'shots/1.2 m.png@1,2 m'"


def test_on_a_phone_the_picture_the_answer_and_its_button_are_seen_at_once(browser, here):
    with tab(browser, size=(390, 844)) as page:
        begin_at(page, here, COLOUR)
        page.locator(".setup-stage-picture img[src]").wait_for()
        below = page.locator("#tabs").bounding_box()["y"]
        for each in (page.locator(".setup-stage-picture"), page.get_by_label("Distance"), page.get_by_text("Take it")):
            box = each.first.bounding_box()
            assert 0 <= box["y"] < box["y"] + box["height"] <= below


def test_on_a_phone_the_wiring_is_drawn_in_its_own_size_and_said_in_words(browser, here):
    with tab(browser, size=PHONE) as page:
        begin_at(page, here, BLANKS)
        page.get_by_label("vibration-motor 18").check()
        page.get_by_text("Wires to the header: pin 12 (GPIO 18), pin 14 (ground).").wait_for()
        drawing = page.get_by_alt_text("How the vibration-motor is wired to GPIO 18")
        until(page, "document.querySelector('.setup-circuit').naturalWidth > 0")
        assert drawing.evaluate("e => e.clientWidth >= e.naturalWidth")
        page.get_by_text("move it sideways").wait_for()
        page.get_by_text("MOSFET: N-channel").wait_for()


def test_what_stays_in_sight_beside_a_long_question_is_not_behind_the_stop_button(page, here):
    begin_at(page, here, BLANKS)
    page.get_by_label("vibration-motor 18").check()
    page.get_by_text("Wires to the header").wait_for()
    page.evaluate("scrollTo(0, 150)")
    stop = page.get_by_role("button", name="Stop every output").bounding_box()
    assert page.locator(".setup-side").bounding_box()["y"] >= stop["y"] + stop["height"]


def test_what_was_said_of_an_answer_goes_when_it_is_corrected(page, here):
    begin_at(page, here, WISH)
    page.locator(".setup-blank").first.fill("200 m")
    page.locator(".setup-way .primary").click()
    page.locator(".setup-doubt").wait_for()
    page.locator(".setup-blank").first.fill("2 m")
    page.locator(".setup-doubt").wait_for(state="hidden")
    page.locator(".setup-blank").first.fill("200 m")
    page.locator(".setup-doubt").wait_for()


def test_a_long_answer_stays_in_its_column(page, here):
    long = f"{'long-' * 20}name.jpg"
    cv2.imwrite(str(here.configuration.parent / long), np.full((48, 64, 3), 90, np.uint8))
    begin_at(page, here, {"camera": long, "target": "ball", "size": "20 cm"})
    given = page.locator(".setup-given").first
    assert given.get_attribute("title") == long
    assert given.bounding_box()["width"] <= 220


def test_the_range_of_the_camera_has_axes(page, here):
    begin_at(page, here, LENS)
    page.locator(".setup-chart").wait_for()
    words = page.locator(".setup-chart text").all_text_contents()
    assert {"0 %", "10 %", "1 m", "2 m"} <= set(words)


def test_the_demonstration_says_what_to_do_and_offers_nothing_that_cannot_succeed(page, here):
    problem = {"message": "this is the demonstration's", "hint": "run `stadimeter web`"}
    told = {"code": "demonstration", "message": "x", "problems": [problem]}
    page.route("**/api/v1/setup/begin", lambda route: route.fulfill(status=400, json={"error": told}))
    page.request.post(f"{here.url}/api/v1/setup/leave", data={}, headers={"Origin": here.url})
    page.goto(f"{here.url}/#setup")
    page.get_by_role("link", name="Watch it").wait_for()
    assert page.get_by_role("button", name="Try again").count() == 0


def rendered(folder, name, *places):
    """Write a picture of balls of 20 cm at these places."""
    first, *others = (BallTarget(position_m=place, diameter_m=0.2, bgr=(60, 200, 180)) for place in places)
    target = GroupTarget(first=first, others=tuple(others)) if others else first
    lens = CameraModel.with_focal_length(600.0, 640, 480)
    image = render(Scene(camera=lens, target=target, seed=1, backdrop=PlainBackdrop())).image
    cv2.imwrite(str(folder / name), image)


@pytest.mark.long
def test_a_person_is_set_up_with_a_network_of_the_folder_from_the_list_to_the_last_test(page, here):
    folder = here.configuration.parent
    image = np.random.default_rng(0).integers(20, 90, (480, 640, 3), np.uint8)
    put_figure(image, bright_figure(300, 120), 200, 100)
    cv2.imwrite(str(folder / "person.png"), image)
    network = write_network(folder / "mine.onnx", "yolox")
    try:
        begin_at(page, here, {"camera": "person.png"})
        page.get_by_text("Found by a neural network").click()
        page.locator(".setup-card", has_text="a person").get_by_role("radio").check()
        go_on(page)
        assert "Which network finds people?" in asked(page)
        page.get_by_label("mine.onnx").check()
        go_on(page)
        assert "How tall are the people" in asked(page)
        assert page.locator(".setup-text input").input_value() == "1.70 m ± 9 cm"
        go_on(page)
        page.get_by_text("Found the person at").first.wait_for()
        page.locator(".setup-text summary").click()
        page.locator(".setup-text input").fill("56 deg")
        go_on(page)
        assert "What shall happen?" in asked(page)
        assert not faults_of(page)
        target = page.get_by_role("navigation", name="Steps of the set-up").locator("li").nth(1)
        assert target.get_by_role("button").count() == 3, "model and size belong to the target"
        begin_at(page, here, {**kept(here), "wish": "near", "near_near": "4 m", "near_output": "screen"})
        page.get_by_role("heading", name="All 2 tests pass").wait_for()
        page.get_by_role("button", name="Save only").click()
        page.get_by_text("It is saved.").wait_for()
        assert load_configuration(here.configuration).targets[0].driver == "object"
    finally:
        network.unlink()


@pytest.mark.long
def test_several_balls_are_set_up_and_counted_and_what_they_would_do_is_drawn(page, here):
    rendered(here.configuration.parent, "three.png", (-0.4, 0.0, 1.5), (0.4, 0.05, 1.7), (0.05, 0.0, 2.5))
    begin_at(page, here, {"camera": "three.png"})
    page.get_by_text("Several of one kind").first.click()
    page.locator(".setup-card", has_text="several balls").get_by_role("radio").check()
    go_on(page)
    page.get_by_label("Size", exact=True).fill("20")
    go_on(page)
    assert "How many are there at most?" in asked(page)
    go_on(page)
    assert "What colour" in asked(page)
    begin_at(page, here, {**kept(here), "colour": "20,60,60:50,255,255", "calibration": "56 deg"})
    page.get_by_text("Several at once").click()
    page.get_by_label("beep when it is near").uncheck()
    page.get_by_label("act when three are near at once").check()
    go_on(page)
    page.get_by_role("textbox", name="How many at once?", exact=True).fill("4")
    page.get_by_text("at least 4 of").first.wait_for()
    page.get_by_role("img", name="If it came, went, and was gone").wait_for()
    go_on(page)
    page.get_by_role("heading", name="drive?").wait_for()
    go_on(page)
    page.get_by_role("heading", name="All 2 tests pass").wait_for()
    page.get_by_role("button", name="Save only").click()
    page.get_by_text("It is saved.").wait_for()
    assert load_configuration(here.configuration).plan.measured_targets == tuple(
        f"balls-{each}" for each in range(1, 5)
    )


@pytest.mark.long
def test_a_size_that_is_not_known_is_learnt_from_pictures_on_the_page(page, here):
    folder = here.configuration.parent
    for number, near_m in enumerate((0.0, 0.2, 0.4)):
        rendered(folder, f"way-{number}.png", (0.0, 0.0, 1.5 - near_m))
    begin_at(page, here, {"camera": "way-0.png", "target": "ball"})
    page.locator(".setup-text summary").click()
    page.locator(".setup-text input").fill("unknown")
    go_on(page)
    assert "What colour" in asked(page)
    begin_at(page, here, {**kept(here), "colour": "20,60,60:50,255,255"})
    page.get_by_role("heading", name="How was the camera calibrated?").wait_for()
    page.get_by_role("radio", name="60 deg").check()
    go_on(page)
    assert "Which pictures show that?" in asked(page)
    page.locator(".setup-text input").fill("way-0.png way-1.png@20cm way-2.png@40cm")
    go_on(page)
    page.get_by_text("The ball measures").wait_for()
    assert "What shall happen?" in asked(page)
    assert kept(here)["size"].endswith("mm")


def test_what_is_known_of_the_floor_is_a_sentence_with_blanks(page, here):
    begin_at(page, here, {**LENS, "wish": "near floor", "near_near": "1 m", "near_output": "screen"})
    height = page.get_by_role("textbox", name="How high is the lens above the floor?").first
    height.fill("1 deg")
    go_on(page)
    page.get_by_text("unknown unit 'deg'", exact=False).first.wait_for()
    height.fill("30 cm ± 1 cm")
    go_on(page)
    page.get_by_role("heading", name="All 2 tests pass").wait_for()
    page.get_by_role("button", name="Save only").click()
    page.get_by_text("It is saved.").wait_for()
    assert load_configuration(here.configuration).footings["ball"].height_m == pytest.approx(0.3)


@pytest.mark.parametrize("size", [PHONE, TABLET, DESKTOP])
@pytest.mark.parametrize("answers", [{}, CAMERA, TARGET, COLOUR, LENS, WISH, BLANKS, ALL])
def test_nothing_is_cut_off_or_hard_to_read_in_any_step(browser, here, size, answers):
    with tab(browser, size=size, scheme="dark" if size == TABLET else "light") as page:
        begin_at(page, here, answers)
        page.locator(".setup-stage-picture img[src]" if answers else ".setup-look img").first.wait_for()
        assert not faults_of(page)


@pytest.mark.skipif(not BALLS.exists(), reason="the shared pictures of a tennis ball are not on this machine")
def test_a_real_tennis_ball_is_found_by_a_click_and_the_stick_of_its_colour_is_marked(page, here):
    begin_at(page, here, {"camera": str(BALLS / "116_0.jpg"), "target": "ball", "size": "6.4 cm"})
    # Its place on the screen counts once the picture has its size there.
    page.locator(".setup-stage-picture img[src]").evaluate("image => image.decode()")
    place = page.evaluate(
        "([x, y]) => new DOMPoint(x, y).matrixTransform(document.querySelector('.setup-marks').getScreenCTM())",
        [767, 1018],
    )
    page.mouse.click(place["x"], place["y"])
    page.get_by_text("1 picture counts.").wait_for()
    page.locator(".setup-found").get_by_text(re.compile(r"ball at 76\d,10[12]\d, 8\d px across")).wait_for()
