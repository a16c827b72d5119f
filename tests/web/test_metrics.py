"""What Prometheus reads at /metrics: the figures of a run that are known, and who may read them."""

import asyncio
import re
import subprocess
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client.parser import text_string_to_metric_families

from stadimeter.app.control.socket_server import ControlSocket
from stadimeter.app.live.metrics import STALE_S
from stadimeter.core.decision import Event, EventKind, RuleStatus, RuleTrace, Severity
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.observation import FrameStamp, OutputFault
from stadimeter.web import page
from stadimeter.web.metrics import exposition
from stadimeter.web.passwords import PasswordFile
from support.command_line import typed
from support.cycle_records import tracked
from support.metered_run import metered_run
from support.page import OPERATE, READ, quicken, served_page
from support.programs import needs

GUIDE = Path(__file__).parents[2] / "docs" / "reference" / "metrics.md"


@pytest.fixture
def run(tmp_path):
    with metered_run(tmp_path) as run:
        yield run


@pytest.fixture
def site(run, tmp_path):
    with served_page(tmp_path, socket=run.control.path) as site:
        yield site


def samples(text):
    """Return the value of every sample, by its name and its labels."""
    return {
        (each.name, *each.labels.values()): each.value
        for family in text_string_to_metric_families(text)
        for each in family.samples
    }


def scraped(site):
    answer = site.get("/metrics")
    assert answer.status == 200, answer.body
    return samples(answer.body.decode())


def fresh(run, site, **changes):
    run.cycle(**changes)
    site.page._answers.clear()
    return scraped(site)


def names(found):
    return {name for name, *_ in found}


def test_the_guide_names_every_metric_and_no_other(run, site):
    fresh(run, site, rules=(RuleTrace(rule="near", status=RuleStatus.IDLE, active=False),))
    text = site.get("/metrics").body.decode()
    told = set(re.findall(r"^\| `(stadimeter_\w+)`", GUIDE.read_text(), re.MULTILINE))
    assert set(re.findall(r"^# TYPE (\w+)", text, re.MULTILINE)) == told


@needs("promtool")
def test_names_and_descriptions_are_as_prometheus_wants_them(run, site):
    fresh(run, site)
    text = site.get("/metrics").body
    checked = subprocess.run(
        ["promtool", "check", "metrics"], input=text, capture_output=True, check=False, timeout=120
    )
    assert (checked.returncode, checked.stdout, checked.stderr) == (0, b"", b"")


def test_it_says_what_the_newest_cycle_found(run, site):
    found = fresh(run, site, output_faults=(OutputFault(output="motor", reason="its cable is out"),))
    assert found["stadimeter_up",] == 1
    assert found["stadimeter_build_info", "hall.toml", "1"] == 1
    assert found["stadimeter_start_time_seconds",] == 9.5
    assert found["stadimeter_target_distance_meters", "ball"] == 2.4321
    assert found["stadimeter_target_distance_sigma_meters", "ball"] == 0.041
    assert found["stadimeter_target_closing_meters_per_second", "ball"] == 0.21
    assert found["stadimeter_target_status", "tracking", "ball"] == 1
    assert found["stadimeter_target_status", "lost", "ball"] == 0
    assert found["stadimeter_output_fault", "motor"] == 1
    assert found["stadimeter_output_fault", "buzzer"] == 0
    assert found["stadimeter_safety_mode", "active"] == 1
    assert found["stadimeter_broker_connected",] == 0
    assert found["stadimeter_deliveries_waiting", "messenger"] == 3
    assert found["stadimeter_deliveries_given_up_total", "messenger"] == 1
    assert found["stadimeter_processor_temperature_celsius",] == 81.5
    assert found["stadimeter_processor_throttled", "under-voltage"] == 1
    assert found["stadimeter_frame_age_seconds",] == pytest.approx(0.034)


def test_a_rule_that_cannot_be_judged_is_not_called_inactive(run, site):
    unknown = RuleStatus.UNKNOWN
    rules = (
        RuleTrace(rule="blind", status=unknown),
        RuleTrace(rule="let-go", status=unknown, active=False),  # by its policy for a lost target
        RuleTrace(rule="held", status=unknown, active=True, inhibits=("shelved",)),
        RuleTrace(rule="quiet", status=RuleStatus.IDLE, active=False, acknowledged=False),
    )
    found = fresh(run, site, rules=rules)
    active = {
        rule: value for (name, *rule), value in found.items() if name == "stadimeter_rule_active" for rule in rule
    }
    assert active == {"held": 1, "quiet": 0}
    assert {found["stadimeter_rule_status", rule, "unknown"] for rule in ("blind", "let-go", "held")} == {1}
    assert found["stadimeter_rule_unacknowledged", "quiet"] == 1
    assert found["stadimeter_rule_unacknowledged", "held"] == 0
    assert found["stadimeter_rule_inhibited", "held"] == 1


def test_the_last_distance_of_a_target_that_is_out_of_sight_is_none_of_now(run, site):
    for status in (TrackStatus.SEARCHING, TrackStatus.LOST):
        found = fresh(run, site, tracks=(tracked(status=status),))
        assert found["stadimeter_target_status", status.value, "ball"] == 1
        assert not {"stadimeter_target_distance_meters", "stadimeter_target_closing_meters_per_second"} & names(found)


def test_a_loop_that_hangs_shows_its_age_and_no_figures_that_look_alive(run, site):
    alive = fresh(run, site)
    run.clock.advance_s(STALE_S + 0.1)
    site.page._answers.clear()
    hung = scraped(site)
    assert hung["stadimeter_up",] == 1
    assert hung["stadimeter_cycle_age_seconds",] == pytest.approx(STALE_S + 0.1)
    assert hung["stadimeter_frame_age_seconds",] == pytest.approx(STALE_S + 0.134)
    gone = names(alive) - names(hung)
    assert {re.match(r"stadimeter_(target|rule|output|safety|frame)", name)[1] for name in gone} == {
        "target", "rule", "output", "safety", "frame",
    }  # fmt: skip
    assert not re.search("target|rule|output|safety|rate", " ".join(names(hung)))


def test_a_camera_that_delivers_nothing_ages_its_picture_alone(run, site):
    fresh(run, site)
    for _ in range(30):
        run.cycle(frame=None)
    found = fresh(run, site, frame=None)
    assert found["stadimeter_frame_age_seconds",] == pytest.approx(3.134)
    assert found["stadimeter_cycle_age_seconds",] == 0
    assert (found["stadimeter_cycles_total",], found["stadimeter_frames_total",]) == (32, 1)


def test_before_the_first_cycle_no_age_says_that_it_is_new(run, site):
    found = scraped(site)
    assert found["stadimeter_cycles_total",] == 0
    assert not {"stadimeter_cycle_age_seconds", "stadimeter_frame_age_seconds"} & names(found)


def test_counters_count_from_the_start(run, site):
    raised = Event(kind=EventKind.RAISED, source="near", at_s=0.0, severity=Severity.ALARM, reason="")
    fresh(run, site, events=(raised, raised), frame=FrameStamp(sequence=1, captured_at_s=0.05))
    found = fresh(run, site, events=(raised,), frame=FrameStamp(sequence=5, captured_at_s=0.1))
    assert found["stadimeter_events_total", "raised"] == 3
    assert found["stadimeter_events_total", "cleared"] == 0  # so that its first one is an increase
    assert found["stadimeter_frames_total",] == 2
    assert found["stadimeter_frames_dropped_total",] == 3
    busy_s = 0.0085
    assert found["stadimeter_cycle_seconds_count",] == 2
    assert found["stadimeter_cycle_seconds_sum",] == pytest.approx(2 * busy_s)
    assert found["stadimeter_cycle_seconds", "0.95"] == pytest.approx(busy_s)
    assert found["stadimeter_latency_seconds_sum",] == pytest.approx(0.05 + 0.1 + 2 * busy_s)
    assert found["stadimeter_latency_seconds", "0.5"] == pytest.approx(0.1 + busy_s)


def test_without_a_run_nothing_is_left_but_that_it_does_not_answer(run, site):
    fresh(run, site)
    run.control.close()
    site.page._answers.clear()
    assert scraped(site) == {("stadimeter_up",): 0}


def test_a_run_that_does_not_answer_in_time_counts_as_none(tmp_path, monkeypatch):
    ended = threading.Event()
    control = ControlSocket(tmp_path / "run.sock", dict, metrics=lambda: str(ended.wait()))
    control.open()
    monkeypatch.setattr(page, "METRICS_WAIT_S", 0.2)
    try:
        with served_page(tmp_path, socket=control.path) as site:
            assert scraped(site) == {("stadimeter_up",): 0}
    finally:
        ended.set()
        control.close()


def test_however_many_ask_at_once_the_run_is_asked_once(run, site, monkeypatch):
    monkeypatch.setattr(page, "FRESH_S", 600)
    run.cycle()

    async def ask_all():
        return await asyncio.gather(*(asyncio.to_thread(scraped, site) for _ in range(20)))

    assert len(asyncio.run(ask_all())) == 20
    assert run.asked == 1


def test_without_the_library_it_says_what_to_install(site, monkeypatch):
    monkeypatch.setattr(page, "find_spec", lambda _name: None)
    answer = site.get("/metrics")
    assert (answer.status, answer.error) == (503, "no-extra")
    assert "stadimeter[metrics]" in answer.data["error"]["message"]


@given(st.lists(st.tuples(st.text(), st.text(), st.floats(allow_nan=False, allow_infinity=False))))
def test_any_text_may_be_a_label(given_samples):
    told = [("", {"rule": rule, "status": status}, value) for rule, status, value in given_samples]
    text = exposition([("stadimeter_rule_status", "gauge", "What a rule does.", told)]).decode()
    lines = [line for line in text.split("\n") if line.startswith("stadimeter_rule_status{")]
    assert len(lines) == len(given_samples)


class TestWithAPassword:
    """Who may read them then."""

    @pytest.fixture
    def site(self, run, tmp_path, monkeypatch):
        quicken(monkeypatch)
        with served_page(tmp_path, OPERATE, READ, socket=run.control.path) as site:
            yield site

    @pytest.fixture
    def token(self, site):
        return site.page.access.file.passwords().token("metrics")

    def test_a_stranger_gets_nothing_and_one_who_may_watch_reads_them(self, site):
        assert site.get("/metrics").status == 401
        site.log_in(READ)
        assert site.get("/metrics").status == 200

    def test_the_token_opens_them_and_nothing_else(self, site, token):
        headers = {"Authorization": f"Bearer {token}"}
        for authorization in (f"bearer {token}", headers["Authorization"]):
            assert site.get("/metrics", Authorization=authorization).status == 200
        for path in ("/", "/api/v1/status", "/api/v1/session", "/metrics/", "//metrics", "/static/../metrics"):
            assert site.get(path, **headers).status == 401, path
        assert site.ask("POST", "/api/v1/outputs/stop", {}, headers).status == 401

    def test_another_token_opens_nothing(self, site, token):
        broken = (f"Basic {token}", f"Bearer {token[:-1]}", f"Bearer {token}0", token)
        for wrong in ("", "Bearer", "Bearer ", "Bearer é", *broken):
            assert site.get("/metrics", Authorization=wrong).status == 401, wrong
        for cookie in (token, f"metrics.{token}", f"1.9999999999.a.{token}"):
            site.cookies[site.page.access._cookie] = cookie
            assert site.get("/metrics").status == 401

    def test_a_new_password_ends_the_token(self, site, token):
        PasswordFile(site.page.access.file.path).set("read", "another one")
        assert site.get("/metrics", Authorization=f"Bearer {token}").status == 401

    def test_the_command_prints_the_token(self, site, token, tmp_path):
        done = typed("web", tmp_path / "page.toml", "--metrics-token")
        assert (done.returncode, done.stdout, done.stderr) == (0, token + "\n", "")

    def test_the_token_of_alarms_is_printed_and_is_another_one(self, site, token, tmp_path):
        done = typed("web", tmp_path / "page.toml", "--alarms-token")
        passwords = PasswordFile(site.page.access.file.path).passwords()
        assert (done.returncode, done.stdout, done.stderr) == (0, passwords.token("alarms") + "\n", "")
        assert token not in done.stdout


def test_without_a_password_there_is_no_token_to_print(tmp_path):
    done = typed("web", tmp_path / "page.toml", "--metrics-token")
    assert done.returncode == 2
    assert "without a token" in done.stderr
