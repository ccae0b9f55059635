"""What the command line says, and which exit code it ends with, when something does not work.

Errors that a person can mend become sentences; anything else is a software error and keeps its traceback. The
classes are looked up only when there is an error: a command that works imports none of them.
"""

import os
import sys
from contextlib import AbstractContextManager
from types import TracebackType

import click

REFUSED = 1
NOT_REACHABLE = 69
WRONG_SETTINGS = 78
INTERRUPTED = 130


class Sentences(AbstractContextManager[None]):
    """Ends the program with a sentence and an exit code instead of a traceback."""

    def __exit__(
        self, _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        if isinstance(error, click.ClickException):
            error.show()
            raise SystemExit(error.exit_code)
        if isinstance(error, click.Abort | KeyboardInterrupt):
            raise SystemExit(INTERRUPTED)
        if isinstance(error, BrokenPipeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nothing complains at the end either
            raise SystemExit(REFUSED)
        if isinstance(error, Exception) and (code := _code(error)) is not None:
            sys.stderr.write(f"{error}\n")
            raise SystemExit(code)


def _code(error: Exception) -> int | None:
    """The exit code of an error that a person can mend, else None."""
    from cellctl.control.errors import ControlError
    from cellctl.desk.client import NotReachable, RequestFailed
    from cellctl.desk.tail import NoLog
    from cellctl.faults import CellError
    from cellctl.lessons.values import CannotTeach
    from cellctl.pictures.files import PictureError
    from cellctl.strict_toml import SettingsError
    from drivers.errors import DeviceError

    if isinstance(error, SettingsError):
        return WRONG_SETTINGS
    if isinstance(error, NotReachable):
        return NOT_REACHABLE
    if isinstance(error, RequestFailed | ControlError | CellError | DeviceError | NoLog | PictureError | CannotTeach):
        return REFUSED
    return None
