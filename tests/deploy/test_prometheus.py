"""A real Prometheus takes the example files, scrapes a real run, and has data for every panel of the dashboard."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
import urllib.parse
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from msgspec import Struct

from stadimeter.app.control.client import ask
from stadimeter.testing.rig import eventually
from stadimeter.web.passwords import PasswordFile
from support.broker import free_port
from support.browser import ROOM, Served, served
from support.metered_run import metered_run
from support.page import OPERATE, served_page
from support.programs import needs, path_of

PROMETHEUS, PROMTOOL = path_of("prometheus"), path_of("promtool")
METRIC = re.compile(r"stadimeter_\w+")
GUIDE = Path(__file__).parents[2] / "docs" / "reference" / "metrics.md"

needs_prometheus = needs("prometheus", "promtool")


class Prometheus(Struct):
    """A Prometheus that runs."""

    url: str

    def get(self, path: str, **query: str) -> Any:
        """Return the data of an answer."""
        with urllib.request.urlopen(f"{self.url}/api/v1/{path}?{urllib.parse.urlencode(query)}", timeout=60) as answer:  # noqa: S310
            return json.load(answer)["data"]

    def value(self, query: str) -> Mapping[tuple[str, ...], float]:
        """Return what a query finds now: by the values of the labels, the number."""
        found = self.get("query", query=query)["result"]
        return {tuple(v for k, v in each["metric"].items() if k != "job"): float(each["value"][1]) for each in found}


@pytest.fixture
def dashboard(deploy: Path) -> Any:
    return json.loads((deploy / "grafana" / "stadimeter-dashboard.json").read_text())


def promtool(*words: object) -> None:
    done = subprocess.run([str(PROMTOOL), *map(str, words)], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def queries_of(dashboard: Any) -> dict[str, str]:
    """Return the queries of a dashboard, by panel and letter."""
    return {
        f"{panel['title']} {target['refId']}": target["expr"]
        for panel in dashboard["panels"]
        for target in panel["targets"]
    }


def test_each_panel_asks_the_chosen_rangefinder(dashboard):
    for panel, query in queries_of(dashboard).items():
        assert len(METRIC.findall(query)) == query.count('{instance=~"$instance"'), panel


def test_dashboard_and_alerts_name_metrics_that_there_are(deploy, dashboard):
    known = set(re.findall(r"^\| `(stadimeter_\w+)`", GUIDE.read_text(), re.MULTILINE))
    known |= {f"stadimeter_{name}_seconds_{part}" for name in ("cycle", "latency") for part in ("sum", "count")}
    alerts = (deploy / "prometheus" / "stadimeter-alerts.yml").read_text()
    for text in (*queries_of(dashboard).values(), *re.findall(r"expr: (.*)", alerts)):
        assert set(METRIC.findall(text)) <= known


@needs_prometheus
def test_each_alert_fires_when_it_shall_and_only_then(deploy):
    tests = Path(__file__).with_name("stadimeter-alerts.test.yml")
    promtool("test", "rules", tests)
    named = re.findall(r"alert: (\w+)", (deploy / "prometheus" / "stadimeter-alerts.yml").read_text())
    assert set(named) == set(re.findall(r"alertname: (\w+)", tests.read_text()))
    assert set(named) == set(re.findall(r"^\| `(Stadimeter\w+)`", GUIDE.read_text(), re.MULTILINE))


@contextmanager
def prometheus(deploy: Path, folder: Path, *targets: tuple[str, str]) -> Iterator[Prometheus]:
    """Start one with the example configuration, which scrapes every second.

    Args:
        targets: The addresses, each with its token; empty for none.
    """
    example = (deploy / "prometheus" / "prometheus.yml").read_text().replace(": 15s", ": 1s")
    head, job = re.split(r"(?=^  - job_name)", example, flags=re.MULTILINE)
    jobs = []
    for number, (address, token) in enumerate(targets):
        (folder / f"{number}.token").write_text(token)
        own = job.replace("job_name: stadimeter", f"job_name: stadimeter-{number}").replace(
            "rangefinder.local:8080", address
        )
        jobs.append(own.replace("/etc/prometheus/stadimeter.token", str(folder / f"{number}.token")))
    file = folder / "prometheus.yml"
    file.write_text(head + "".join(jobs))
    shutil.copy(deploy / "prometheus" / "stadimeter-alerts.yml", folder)
    promtool("check", "config", file)
    address = f"127.0.0.1:{free_port()}"
    storage, listens = f"--storage.tsdb.path={folder / 'tsdb'}", f"--web.listen-address={address}"
    with (folder / "prometheus.log").open("w") as log:
        process = subprocess.Popen([str(PROMETHEUS), f"--config.file={file}", storage, listens], stdout=log, stderr=log)
    here = Prometheus(f"http://{address}")
    try:
        eventually(lambda: _is_ready(here, process, folder / "prometheus.log"))
        yield here
    finally:
        process.terminate()
        process.wait(timeout=120)


def _is_ready(here: Prometheus, process: subprocess.Popen[bytes], log: Path) -> bool:
    assert process.poll() is None, log.read_text()
    try:
        with urllib.request.urlopen(f"{here.url}/-/ready", timeout=60) as answer:  # noqa: S310
            return bool(answer.status == 200)
    except OSError:
        return False


def make_events(here: Served) -> None:
    """Have something happen in a run, so that its counters rise."""
    (path,) = Path(here.environment["XDG_RUNTIME_DIR"]).rglob("*.sock")
    for op in ("stop-outputs", "release-outputs"):
        ask(path, op, {"by": "zoe"})


@needs_prometheus
@pytest.mark.long
@pytest.mark.timeout(900)
def test_every_panel_has_data_of_a_real_run_and_none_when_it_has_ended(deploy, dashboard, tmp_path):
    room, board = tmp_path / "room", tmp_path / "board"
    for folder in (room, board):
        folder.mkdir()
    PasswordFile(room / "stadimeter.passwords").set("operate", OPERATE)
    command = [sys.executable, "-m", "stadimeter", "web", str(room / "stadimeter.toml"), "--metrics-token"]
    token = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True).stdout.strip()
    text = ROOM + '[messenger]\ndriver = "simulated"\n'
    with (
        served(room, text, "--address", "127.0.0.1") as here,
        metered_run(board) as hot,
        served_page(board, socket=hot.control.path) as pi,  # this computer may tell neither temperature nor supply
    ):
        hot.cycle()
        ours, other = here.url.removeprefix("http://"), f"127.0.0.1:{pi.port}"
        with prometheus(deploy, tmp_path, (ours, token), (other, "none is needed")) as server:
            eventually(lambda: len(server.value("stadimeter_up == 1")) == 2)

            def data_of(instance: str, query: str) -> bool:
                asked = query.replace("$instance", instance).replace("$__rate_interval", "15s")
                return any(map(math.isfinite, server.value(asked).values()))

            make_events(here)
            for query in queries_of(dashboard).values():
                instance = other if "stadimeter_processor" in query else ours
                eventually(lambda query=query, instance=instance: data_of(instance, query))
            rules = [each for group in server.get("rules")["groups"] for each in group["rules"]]
            assert [each["lastError"] for each in rules if each.get("lastError")] == []

            assert here.run is not None
            here.run.kill()
            here.run.wait(timeout=120)
            left = f'{{__name__=~"stadimeter_.+", instance="{ours}"}}'
            eventually(lambda: list(server.value(left).values()) == [0.0])  # of stadimeter_up alone
            eventually(lambda: server.value('ALERTS{alertname="StadimeterDown"}'))


@needs_prometheus
@pytest.mark.long
def test_without_the_token_it_gets_nothing(deploy, tmp_path):
    with metered_run(tmp_path) as run, served_page(tmp_path, OPERATE, socket=run.control.path) as site:
        with prometheus(deploy, tmp_path, (f"127.0.0.1:{site.port}", "a guess")) as server:
            eventually(lambda: [each for each in server.get("targets")["activeTargets"] if "401" in each["lastError"]])
            assert not server.value("stadimeter_up")
        assert run.asked == 0
