"""Sending a configuration to a fleet, cohort by cohort: first all of a cohort try it, and only then they apply it."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import get_args

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.config.untrusted_file import sha256_of
from stadimeter.core.words import one_line
from stadimeter.errors import ConfigError
from stadimeter.messaging.protocol import Subscription
from stadimeter.workbench.fleet.desired import sign
from stadimeter.workbench.fleet.devices import Fleet
from stadimeter.workbench.fleet.reports import DESIRED, FAILED, Desired, FleetOutcome, FleetReport, Phase

# The devices that have been sent it after each cohort, in percent.
COHORTS_PERCENT = (5, 25, 100)

_LOOK_EVERY_S = 0.2
_NAMED_MAX = 10


def read_committed(file: Path, revision: str = "HEAD", reason: str = "") -> Desired:
    """Read a configuration from git, which is the truth: what is not committed is not sent. It is for no device yet.

    Args:
        reason: Why it is sent; by default the subject of the commit.

    Raises:
        ConfigError: It is in no commit, or was changed since the newest one.
    """
    commit = _git(file, "rev-parse", "--verify", "--end-of-options", f"{revision}^{{commit}}").strip()
    text = _git(file, "show", f"{commit}:./{file.name}")
    if revision == "HEAD" and file.read_bytes() != text.encode():
        raise ConfigError(f"{file} has changes that are not committed; commit them, or name one with --commit")
    return Desired(
        device="",
        sequence=0,
        phase="try",
        cohort="",
        sha256=sha256_of(text),
        commit=commit,
        reason=(reason or _git(file, "log", "-1", "--format=%s", commit).strip())[:200],
        configuration=text,
    )


def signing_key(file: Path) -> Path:
    """Return the key with which git signs commits beside a file; raises ConfigError if it names none."""
    try:
        key = _git(file, "config", "--type=path", "user.signingkey").strip()
    except ConfigError:
        key = ""
    if not key or not Path(key).is_file():
        raise ConfigError("name the key to sign with: --key FILE; git's user.signingkey names no file here")
    return Path(key)


def _git(file: Path, *words: str) -> str:
    command = ["git", "-C", str(file.absolute().parent), *words]
    try:
        done = subprocess.run(command, capture_output=True, check=False)  # noqa: S603 - no shell
    except FileNotFoundError as error:
        raise ConfigError("git is not installed, from which configurations are read") from error
    if done.returncode:
        raise ConfigError(f"{file}: git says: {one_line(done.stderr.decode(errors='replace').strip())}")
    try:
        return done.stdout.decode()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: it is not UTF-8 text") from error


def make_cohorts(devices: Iterable[str], percents: Sequence[int] = COHORTS_PERCENT) -> list[tuple[str, ...]]:
    """Divide devices into cohorts: always the same, and each spread over as many sites as it has devices.

    Args:
        devices: Their names, such as ``hall/press``; all but the last level are the site.
        percents: How many have been sent it after each cohort; the first is never empty.
    """
    sites: dict[str, list[str]] = {}
    for device in sorted(set(devices), key=_shuffled):
        sites.setdefault(device.rpartition("/")[0], []).append(device)
    ranked = [(rank, _shuffled(name), name) for names in sites.values() for rank, name in enumerate(names)]
    order = [name for _, _, name in sorted(ranked)]
    ends = [0, *(-(-len(order) * percent // 100) for percent in percents)]
    return [tuple(order[begin:end]) for begin, end in pairwise(ends)]


def _shuffled(name: str) -> str:
    """Return what brings names into an order that has nothing to do with their meaning."""
    return sha256(name.encode(errors="replace")).hexdigest()


def choose(fleet: Fleet, digest: str, named: Collection[str]) -> tuple[list[tuple[str, ...]], list[str]]:
    """Return the cohorts of the devices that do not run a configuration yet, and in words who is left out.

    Raises:
        ConfigError: A device that is named receives no configurations now.
    """
    receiving = {name: each.configuration for name, each in fleet.devices.items() if each.configuration}
    ready = {name for name in receiving if fleet.devices[name].is_online}
    if missing := set(named).difference(ready):
        raise ConfigError(f"{_some(sorted(missing))}: not online, or without a receiver of configurations")
    done = {name for name, report in receiving.items() if report.runs(digest)}
    notes = {
        "no receiver of configurations, so left out": set(fleet.devices).difference(receiving),
        "not online, so left out": set(receiving).difference(ready),
        "runs it already": ready & done,
    }
    left = [tuple(name for name in cohort if name not in done) for cohort in make_cohorts(named or ready)]
    return left, [f"{words}: {_some(sorted(names))}" for words, names in notes.items() if names and not named]


class Rollout(Struct):
    """Sends one configuration.

    Attributes:
        judge: Takes what a cohort has tried; returns why not to go on, or an empty string.
        tell: Takes a line for people.
        answer_s: How long a device may take for a phase.
        applied: The devices that run it because of this.
    """

    fleet: Fleet
    subscription: Subscription
    judge: Callable[[Mapping[str, FleetOutcome]], str]
    tell: Callable[[str], None]
    answer_s: float
    applied: list[str] = field(default_factory=list)
    _sent: dict[tuple[str, Phase], tuple[Desired, bytes]] = field(default_factory=dict)

    def prepare(self, desired: Desired, cohorts: Sequence[Collection[str]], key: Path) -> None:
        """Sign all that may be sent, by one call; raises ConfigError if that fails, or a message is too long."""
        wanted: dict[tuple[str, Phase], Desired] = {}
        for number, cohort in enumerate(cohorts, start=1):
            for name in cohort:
                # Above what the device has accepted: the time in milliseconds, or more if that had to be.
                report = self.fleet.devices[name].configuration
                before = report.newest.revision.sequence if report is not None and report.newest is not None else 0
                at = {"sequence": max(int(time.time() * 1000), before + 1), "cohort": f"{number} of {len(cohorts)}"}
                for phase in get_args(Phase):
                    wanted[name, phase] = replace(desired, device=f"{self.fleet.root}/{name}", phase=phase, **at)
        messages = sign(wanted.values(), key)
        self._sent = {at: (wanted[at], message) for at, message in zip(wanted, messages, strict=True)}

    def run(self, cohorts: Sequence[Collection[str]]) -> str:
        """Send it to one cohort after the other; return why it was stopped, or an empty string."""
        for number, cohort in enumerate(cohorts, start=1):
            if not cohort:
                continue
            self.tell(f"cohort {number} of {len(cohorts)}: {_some(cohort)}")
            trouble = self._send(cohort, "try") or self.judge(self._outcomes(cohort, "try"))
            if not trouble:
                trouble = self._send(cohort, "apply")
                self.applied += [name for name, each in self._outcomes(cohort, "apply").items() if not _failed(each)]
            if trouble:
                for name in set(cohort).difference(self.applied):
                    self._publish(name, "")  # the broker forgets it: who comes back later does not apply it
                self.subscription.serve(_LOOK_EVERY_S)
                return trouble
        return ""

    def _send(self, cohort: Collection[str], phase: Phase) -> str:
        """Send a phase to a cohort, wait for the answers, and return what went wrong."""
        for name in cohort:
            self._publish(name, self._sent[name, phase][1].decode())
        until_s = time.monotonic() + self.answer_s
        while True:
            outcomes = self._outcomes(cohort, phase)
            failed = {name: why for name, each in outcomes.items() if (why := _failed(each))}
            is_complete = len(outcomes) == len(cohort)
            if failed and (phase == "try" or is_complete):
                return "; ".join(f"{name} {why}" for name, why in list(failed.items())[:_NAMED_MAX])
            if is_complete:
                return ""
            if time.monotonic() > until_s:
                silent = _some([name for name in cohort if name not in outcomes])
                return f"no answer within {self.answer_s:g} s from {silent}"
            self.subscription.serve(_LOOK_EVERY_S)

    def _outcomes(self, cohort: Iterable[str], phase: Phase) -> dict[str, FleetOutcome]:
        """Return what those devices say that have answered."""
        found = {name: self._outcome(name, phase) for name in cohort}
        return {name: outcome for name, outcome in found.items() if outcome is not None}

    def _outcome(self, name: str, phase: Phase) -> FleetOutcome | None:
        report = getattr(self.fleet.devices.get(name), "configuration", None) or FleetReport()
        (desired, message), newest = self._sent[name, phase], report.newest
        if report.rejected.message_sha256 == sha256(message).hexdigest():
            return FleetOutcome(revision=desired, status="refused", by="", sentence=report.rejected.sentence)
        if newest is None or newest.status == "applying":
            return None
        answers = newest.revision.sequence, newest.revision.phase
        return newest if answers == (desired.sequence, phase) else None

    def _publish(self, name: str, payload: str) -> None:
        self.subscription.publish(f"{self.fleet.root}/{name}/{DESIRED}", payload, None)


def _failed(outcome: FleetOutcome) -> str:
    return f"{outcome.status}: {outcome.sentence}" if outcome.status in FAILED else ""


def _some(names: Collection[str]) -> str:
    shown = ", ".join(list(names)[:_NAMED_MAX])
    return f"{shown} and {len(names) - _NAMED_MAX} more" if len(names) > _NAMED_MAX else shown
