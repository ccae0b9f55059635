"""What systemd is told (sd_notify), and the watchdog that is fed only while every critical task moves on."""

import asyncio
import math
import os
import socket
import time
from typing import Final, NoReturn

from cellctl.log import log

FEEDS_PER_TIMEOUT: Final = 4


def notify(*assignments: str) -> bool:
    """Tell the service manager, for instance "READY=1", "STATUS=waiting for a base". False when nobody listens.

    Never blocks and never raises: a daemon that cannot report still works.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address[:1] not in ("/", "@"):
        return False
    message = "\n".join(" ".join(text.splitlines()) for text in assignments).encode()
    kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
    try:
        with socket.socket(socket.AF_UNIX, kind) as sender:
            sender.sendto(message, "\0" + address[1:] if address[0] == "@" else address)
    except OSError:
        return False
    return True


def ready(status: str) -> bool:
    """The daemon is up; `status` is what `systemctl status` shows."""
    return notify("READY=1", f"STATUS={status}")


def show(status: str) -> bool:
    """What `systemctl status` shows."""
    return notify(f"STATUS={status}")


def stopping(status: str) -> bool:
    """The daemon is on its way out."""
    return notify("STOPPING=1", f"STATUS={status}")


def watchdog_s() -> float | None:
    """The service's WatchdogSec, or None when systemd watches nothing or somebody else."""
    if os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    text = os.environ.get("WATCHDOG_USEC", "")
    return int(text) / 1e6 if text.isascii() and text.isdecimal() and int(text) > 0 else None


class Progress:
    """Which critical tasks have moved on since the watchdog was last fed."""

    def __init__(self) -> None:
        self._moved: dict[str, bool] = {}

    def register(self, name: str) -> None:
        """From now on this task must move on. Counts as a first move."""
        self._moved[name] = True

    def forget(self, name: str) -> None:
        """This task has ended as it should."""
        self._moved.pop(name, None)

    def mark(self, name: str) -> None:
        """The task has moved on. Raises KeyError for a task that was not registered."""
        if name not in self._moved:
            raise KeyError(f"{name} is not registered as a critical task")
        self._moved[name] = True

    def stuck(self) -> tuple[str, ...]:
        """The tasks that have not moved on since the last feed."""
        return tuple(name for name, moved in self._moved.items() if not moved)

    def fed(self) -> None:
        """Everybody must move on again."""
        self._moved = dict.fromkeys(self._moved, False)


async def feed_watchdog(progress: Progress, within_s: float) -> NoReturn:
    """Feed systemd's watchdog while every critical task moves on within `within_s`; never returns.

    `within_s` may be no longer than half of WatchdogSec, so that one late look does not cost the daemon its life.
    A task that is stuck is named in the log; then nobody is fed, and systemd ends the daemon.
    """
    timeout_s = watchdog_s() or math.inf
    look_every_s = min(within_s, timeout_s / 2) / FEEDS_PER_TIMEOUT
    fed_s = time.monotonic()
    named: tuple[str, ...] = ()
    while True:
        await asyncio.sleep(look_every_s)
        stuck = progress.stuck()
        if not stuck:
            notify("WATCHDOG=1")
            progress.fed()
            fed_s, named = time.monotonic(), ()
        elif stuck != named and time.monotonic() - fed_s > within_s:
            log.error(f"no progress for {time.monotonic() - fed_s:.2f} s: {', '.join(stuck)}", logger="watchdog")
            named = stuck
