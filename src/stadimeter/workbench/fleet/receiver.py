"""What a device does with a desired configuration: verify, try, apply or refuse, and say so.

=======  ==========================================================================  ============================
phase    what must be so                                                             then it is
=======  ==========================================================================  ============================
any      signed by an allowed signer, for this device, not older than what came      else rejected, and counted
try      `check`, its tests, the replay and the policy find nothing                  tried, else refused
apply    the same, and a run goes by the file that is replaced; afterwards that      applied, else refused, or
         run is as well as before                                                    rolled back
=======  ==========================================================================  ============================

Before the file is replaced, the former text is remembered on the disk. So a power cut meanwhile ends with it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.control.client import ask, find, introduce
from stadimeter.config.atomic_file import write_atomically
from stadimeter.config.untrusted_file import CONFIGURATION_MAX_BYTES, read_untrusted, read_untrusted_text, sha256_of
from stadimeter.core.decision import SafetyMode
from stadimeter.errors import ConfigError, ControlError, StadimeterError, StateError
from stadimeter.workbench.fleet.desired import clock_trouble, verify
from stadimeter.workbench.fleet.policy import FleetPolicy, MotionPermit, compose
from stadimeter.workbench.fleet.reports import Desired, FleetOutcome, FleetReport, Phase, Rejection, Revision, Trial
from stadimeter.workbench.saving import save_files

# A restart of a small Pi takes many seconds. A run that is well for `SETTLE_S` in a row is taken to stay so.
WELL_WITHIN_S = 120.0
SETTLE_S = 5.0
_LOOK_EVERY_S = 0.5

# A configuration with many targets takes a small computer some seconds to check.
_RELOAD_S = 60.0
_SENTENCE_MAX = 500


class FleetMemory(Struct, frozen=True, kw_only=True):
    """What a device remembers beyond the end of the process.

    Attributes:
        sequence: The highest that came with a signature that fits; `sha256` of what came with it.
        file_sha256: Of the file when something was applied last.
        former: The text to put back if the process finds this when it begins; None if nothing was under way.
    """

    sequence: int = 0
    sha256: str = ""
    applied: FleetOutcome | None = None
    file_sha256: str = ""
    newest: FleetOutcome | None = None
    former: str | None = None


class LocalRun:
    """The run on this device that goes by a configuration."""

    def __init__(self, configuration: Path) -> None:
        self._configuration = configuration
        self._ill_before: frozenset[str] = frozenset()

    def look(self) -> None:
        """Take in how the run is before a change; raises ControlError if none answers."""
        self._ill_before = _what_is_ill(ask(find(self._configuration), "status"))

    def apply(self, *, restart: bool) -> None:
        """Have the run go by the file; raises ControlError if it refuses."""
        ask(find(self._configuration), "restart" if restart else "reload", wait_s=_RELOAD_S)

    def await_health(self, running_sha256: str, *, restarted: bool) -> None:
        """Wait until the run is as well as it was; raises ControlError if that takes too long."""
        until_s = (well_since_s := time.monotonic()) + WELL_WITHIN_S
        allowed = self._ill_before | ({SafetyMode.DISARMED} if restarted else set())
        why = ""
        while (now_s := time.monotonic()) < until_s:
            if why := self._why_ill(running_sha256, allowed):
                well_since_s = now_s
            elif now_s - well_since_s >= SETTLE_S:
                return
            time.sleep(_LOOK_EVERY_S)
        raise ControlError(f"the run was not well within {WELL_WITHIN_S:g} s: {why or 'it did not stay so'}")

    def _why_ill(self, running_sha256: str, allowed: frozenset[str]) -> str:
        try:
            socket = find(self._configuration)
            if introduce(socket).digest != running_sha256:
                return "it goes by another configuration"
            status = ask(socket, "status")
        except ControlError as error:
            return str(error)
        ill = _what_is_ill(status) - allowed
        return f"{', '.join(sorted(ill))} {status['safety_reason']}".strip() if ill else ""


def _what_is_ill(status: Mapping[str, Any]) -> frozenset[str]:
    """Return the mode of safety if outputs may not act, else the outputs that may not, such as one that failed."""
    if status["safety"] != SafetyMode.ACTIVE:
        return frozenset({status["safety"]})
    return frozenset(each["output"] for each in status["outputs"] if each["winner"] == "safety")


class Receiver:
    """Takes desired configurations for one device. Used in one thread, save `report`.

    Args:
        device: The base topic of this device.
        try_out: Tries a text in place of the configuration.
    """

    def __init__(
        self,
        configuration: Path,
        policy: FleetPolicy,
        device: str,
        try_out: Callable[[str], Trial],
        run: LocalRun | None = None,
    ) -> None:
        self.device = device
        self._configuration, self._policy, self._try_out = configuration, policy, try_out
        self._run = run or LocalRun(configuration)
        self._memory_file = policy.file_beside(configuration, "json")
        self._permit = MotionPermit(policy.file_beside(configuration, "motion"))
        self._memory = self._remembered()
        self._rejected = Rejection()
        self._tried: tuple[str, str, Trial] | None = None

    def report(self) -> FleetReport:
        """Return what the device runs, and what became of what it was sent."""
        memory, digest = self._memory, ""
        with suppress(StadimeterError):
            digest = sha256(read_untrusted(self._configuration, CONFIGURATION_MAX_BYTES)).hexdigest()
        return FleetReport(
            sha256=digest,
            applied=memory.applied,
            is_edited=memory.applied is not None and memory.file_sha256 != digest,
            newest=memory.newest,
            rejected=self._rejected,
            clock=clock_trouble(),
        )

    def recover(self) -> None:
        """Put the former file back if the process ended during a change."""
        former, newest = self._memory.former, self._memory.newest
        if former is not None and newest is not None:
            sentence = f"it was interrupted while it was applied; {self._put_back(former, restart=True)}"
            self._keep(former=None, newest=replace(newest, status="rolled-back", sentence=sentence))

    def receive(self, message: bytes) -> None:
        """Do what a message wants, which may take minutes; `report` says what came of it."""
        try:
            desired, signer = verify(message, self._policy.allowed_signers)
            self._check_meant(desired)
        except ConfigError as error:
            digest = sha256(message).hexdigest()
            self._rejected = Rejection(digest, _short(error), self._rejected.count + 1)
            return
        if self._is_done(desired):  # it comes again with each new connection
            return
        revision = msgspec.convert(desired, Revision, from_attributes=True)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        outcome = FleetOutcome(revision=revision, status="refused", by=signer, at=now)
        try:
            self._keep(sequence=desired.sequence, sha256=desired.sha256)
            outcome = self._decide(desired, outcome)
        except (StadimeterError, OSError) as error:
            outcome = replace(outcome, sentence=_short(error))
        self._keep(newest=outcome, former=None)

    def _check_meant(self, desired: Desired) -> None:
        known = self._memory.sequence
        if desired.device != self.device:
            raise ConfigError(f"it is signed for {desired.device}, and this is {self.device}")
        if desired.sequence < known:
            raise ConfigError(f"it is older (sequence {desired.sequence}) than what came before ({known})")
        if desired.sequence == known and desired.sha256 != self._memory.sha256:
            raise ConfigError(f"another configuration came with the same sequence, {known}")

    def _is_done(self, desired: Desired) -> bool:
        newest = self._memory.newest
        is_same = newest is not None and newest.revision.sequence == desired.sequence
        return is_same and newest is not None and newest.revision.phase in {desired.phase, "apply"}

    def _decide(self, desired: Desired, outcome: FleetOutcome) -> FleetOutcome:
        own = read_untrusted_text(self._configuration, CONFIGURATION_MAX_BYTES)
        text = compose(own, desired.configuration)
        if self._tried is None or self._tried[:2] != (own, text):  # else it was tried in the phase before
            self._tried = own, text, self._try_out(text)
        trial = self._tried[2]
        outcome = replace(outcome, trial=trial)
        if why := trial.refusal or self._why_not_allowed(trial, desired.phase):
            return replace(outcome, sentence=_short(why))
        return replace(outcome, status="tried") if desired.phase == "try" else self._apply(own, text, trial, outcome)

    def _why_not_allowed(self, trial: Trial, phase: Phase) -> str:
        change = self._policy.change
        if change == "none" and phase == "apply":
            return 'the policy of this device lets a fleet try, and change nothing (change = "none")'
        if change != "all" and trial.settings:
            return f"the policy of this device lets a fleet change rules only, and this changes {_list(trial.settings)}"
        if trial.motion and not self._permit.stands():
            arm = f"`stadimeter fleet arm {self._configuration}`"
            return f"it changes how something moves ({_list(trial.motion)}), which was not armed here with {arm}"
        return ""

    def _apply(self, own: str, text: str, trial: Trial, outcome: FleetOutcome) -> FleetOutcome:
        self._run.look()
        self._keep(former=own, newest=replace(outcome, status="applying"))
        self._write(text, instead_of=own)
        try:
            self._run.apply(restart=trial.needs_restart)
            self._run.await_health(trial.running_sha256, restarted=trial.needs_restart)
        except (StadimeterError, OSError) as error:
            sentence = f"{error}; {self._put_back(own, restart=trial.needs_restart)}"
            return replace(outcome, status="rolled-back", sentence=_short(sentence))
        if trial.motion:
            self._permit.use()
        outcome = replace(outcome, status="applied")
        self._keep(applied=replace(outcome, trial=None), file_sha256=sha256_of(text))
        return outcome

    def _put_back(self, former: str, *, restart: bool) -> str:
        """Write the former file, have the run go by it, and say how that went."""
        try:
            self._write(former)
            self._run.apply(restart=restart)
        except ControlError as error:
            return f"the former file was put back, and no run has taken it over yet ({error})"
        except (StadimeterError, OSError) as error:
            return f"and the former file could not be put back: {error}"
        return "the former file was put back, and the run goes by it"

    def _write(self, text: str, instead_of: str | None = None) -> None:
        """Replace the file, unless it was edited since; what it held is kept among its versions."""
        place = self._configuration.resolve()

        def check() -> None:
            if instead_of not in {None, read_untrusted_text(place, CONFIGURATION_MAX_BYTES)}:
                raise ConfigError("the file was edited on the device meanwhile")

        save_files(place.parent, {place.name: text}, check)

    def _remembered(self) -> FleetMemory:
        try:
            return msgspec.json.decode(self._memory_file.read_bytes(), type=FleetMemory)
        except FileNotFoundError:
            return FleetMemory()
        except (OSError, ValueError) as error:  # to begin anew would let an old message count as new
            words = f"{self._memory_file} is of no use ({error}); delete it to take each configuration that is signed"
            raise StateError(words) from error

    def _keep(self, **changes: Any) -> None:
        memory = replace(self._memory, **changes)
        try:
            write_atomically(self._memory_file, msgspec.json.encode(memory))
        except OSError as error:
            raise StateError(f"{self._memory_file} cannot be written: {error.strerror or error}") from error
        self._memory = memory


def _list(names: Iterable[str]) -> str:
    return ", ".join(names)


def _short(sentence: object) -> str:
    words = " ".join(str(sentence).split())
    return words if len(words) <= _SENTENCE_MAX else f"{words[:_SENTENCE_MAX]}…"
