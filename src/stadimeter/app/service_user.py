"""The user of the service, and becoming it: root may read every file and open every device, the service may not."""

from __future__ import annotations

import grp
import os
import pwd
import re
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from stadimeter.config.extras import PACKAGED

SERVICE_USER = "stadimeter"
CONFIGURATIONS = Path("/etc/stadimeter")
UNITS = ("usr/lib/systemd/system", "etc/systemd/system")


def become_service_user(configuration: Path) -> bool:
    """Go on as the user of the service, for good, if root looks at a configuration of the packaged service.

    Returns:
        Whether the user has changed.
    """
    if os.geteuid() != 0 or not sys.prefix.startswith(PACKAGED):
        return False
    if not configuration.resolve().is_relative_to(CONFIGURATIONS):
        return False
    try:
        become(SERVICE_USER, groups_of_service())
    except KeyError:  # there is no such user
        return False
    return True


def become(user: str, groups: Iterable[str]) -> None:
    """Go on as a user with these groups besides its own, for good. Only root may.

    Raises:
        KeyError: There is no such user.
    """
    entry = pwd.getpwnam(user)
    ids = {entry.pw_gid, *os.getgrouplist(user, entry.pw_gid)}
    for group in groups:
        with suppress(KeyError):  # the service does not start then, which systemd says
            ids.add(grp.getgrnam(group).gr_gid)
    os.setgroups(sorted(ids))
    os.setgid(entry.pw_gid)
    os.setuid(entry.pw_uid)


def groups_of_service(root: Path = Path("/")) -> tuple[str, ...]:
    """Return the supplementary groups of the unit and its drop-ins, which decide which devices it may open."""
    units = [root / folder / "stadimeter.service" for folder in UNITS]
    files = [unit for unit in units if unit.exists()][-1:]  # that of the administrator stands for that of the package
    files += [path for folder in UNITS for path in sorted((root / folder / "stadimeter.service.d").glob("*.conf"))]
    found: list[str] = []
    for file in files:
        with suppress(OSError):
            for line in re.findall(r"^SupplementaryGroups=(.*)$", file.read_text("utf-8", "replace"), re.MULTILINE):
                found = [*found, *line.split()] if line.strip() else []
    return tuple(dict.fromkeys(found))
