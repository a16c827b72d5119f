"""Trying a configuration over what a device has recorded, in a process of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.workbench.fleet import trial
from stadimeter.workbench.fleet.policy import load_policy
from stadimeter.workbench.fleet.trial import try_apart, try_out
from stadimeter.workbench.replay.replay import decisions, read_recording, replay_run
from support.command_line import typed
from support.simulated_run import SIMULATED_BALL

OWN = f"""{SIMULATED_BALL}
[rules.near]
actuator = "motor"
when = {{ below = "1 m" }}
on_delay = "0 s"
[world]
path = [{{ at = "0 s", x = "2 m", y = "0 m" }}]
loop = false
"""
WIDER = OWN.replace("1 m", "3 m")


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the configuration of a device that has recorded ten seconds, with its policy beside it."""
    folder = tmp_path_factory.mktemp("device")
    path = folder / "a.toml"
    path.write_text(OWN)
    (folder / "recordings").mkdir()
    (folder / "fleet.toml").write_text('allowed_signers = "signers"\nrecording = "recordings"\n')
    words = ("--seconds", 10, "--speed", 0, "--no-state", "--journal", folder / "recordings" / "run.jsonl")
    done = typed("run", path, *words)
    assert done.returncode == 0, done.stderr
    return path


def test_the_difference_of_decisions_is_counted(device: Path) -> None:
    policy = load_policy(device.with_name("fleet.toml"))
    same, wider = (try_out(device, policy, text).differences for text in (OWN, WIDER))
    assert same is not None
    assert (same.recording, same.differing, same.percent, dict(same.events)) == ("run.jsonl", 0, 0.0, {})
    assert same.cycles > 200
    assert same.minutes == pytest.approx(10 / 60, abs=0.02)
    assert wider is not None
    assert wider.events == {"near": {"raised added": 1}}
    assert 0.9 * wider.cycles < wider.outputs["motor"] <= wider.differing < wider.cycles
    assert wider.percent > 90


def test_only_the_last_of_a_long_recording_is_replayed(device: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = read_recording(device.parent / "recordings" / "run.jsonl")
    times_s = [cycle.now_s() for cycle in recording.cycles()]
    assert times_s == [cycle.observation().now_s for cycle in recording.cycles()]
    plan = replay_run(recording, None).configuration.plan
    assert len(list(decisions(recording, plan, from_s=times_s[-10]))) == 10
    monkeypatch.setattr(trial, "LAST_S", 4.0)
    found = try_out(device, load_policy(device.with_name("fleet.toml")), WIDER).differences
    assert found is not None
    assert found.minutes == pytest.approx(4 / 60, abs=0.01)


@pytest.mark.long
def test_a_trial_in_a_process_of_its_own_gives_the_same_and_its_end_is_a_refusal(
    device: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = device.with_name("fleet.toml")
    apart, here = try_apart(device, policy, WIDER), try_out(device, load_policy(policy), WIDER)
    assert apart.differences is not None
    assert here.differences is not None
    assert (apart.differences.events, apart.running_sha256) == (here.differences.events, here.running_sha256)
    ended = try_apart(device, tmp_path / "none.toml", WIDER).refusal
    assert ended.startswith("to try it ended with code 1: ")
    monkeypatch.setattr(trial, "TRIAL_S", 0.001)
    assert try_apart(device, policy, WIDER).refusal == "to try it took longer than 0.001 s"


def test_other_settings_for_a_broker_that_does_not_answer_are_refused(device: Path) -> None:
    policy = load_policy(device.with_name("fleet.toml"))
    lost = OWN + '[messenger]\ndriver = "mqtt"\nport = 1\n'
    assert try_out(device, policy, lost).refusal.startswith(
        "by its [messenger] this device would not be reached any more"
    )
