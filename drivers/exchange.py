"""What a conversation waits for: the answer to a question, the end of an operation, a file. Fed line by line."""

import asyncio
from typing import Protocol

from drivers.errors import DeviceError
from drivers.rcx import Kind

MOST_DATA_LINES = 16
MOST_FILE_LINES = 50_000


class Waiting(Protocol):
    """Somebody who waits for lines."""

    line: str

    def fail(self, error: DeviceError) -> None:
        """It will not come."""


class Question:
    """A query, a setting or a READ. `ends` is the kind of line that completes its answer."""

    def __init__(self, line: str, ends: Kind, *, codes_are_data: bool = False) -> None:
        self.line = line
        self.data: list[str] = []
        self.done = outcome()
        self.news = asyncio.Event()
        self._ends = ends
        self._codes_are_data = codes_are_data

    @property
    def overflows(self) -> bool:
        """Whether more came than any answer has."""
        return len(self.data) > (MOST_FILE_LINES if self._ends is Kind.END else MOST_DATA_LINES)

    def takes(self, kind: Kind, text: str) -> bool:
        """Take a line that belongs to the answer; False for one that does not."""
        if self._ends is Kind.END:
            return self._takes_of_file(kind, text)
        if kind is Kind.OK and (self._ends is Kind.OK or self.data):
            resolve(self.done)
            return True
        if kind is Kind.DATA or (kind is Kind.FAILURE and self._codes_are_data):
            self.data.append(text)
            if self._ends is Kind.DATA:
                resolve(self.done)
            return True
        return False

    def fail(self, error: DeviceError) -> None:
        """It will not come."""
        raise_in(self.done, error)
        self.news.set()

    def _takes_of_file(self, kind: Kind, text: str) -> bool:
        """Whatever comes once it has begun: a line of a program may look like a word of the protocol."""
        if not self.data and kind is Kind.FAILURE:
            return False
        if kind is not Kind.NOTHING and not (kind is Kind.BEGIN and not self.data):
            self.data.append(text)
            self.news.set()
        return True


class FileOut:
    """A WRITE that waits for READY and, when the file has gone, for OK."""

    overflows = False

    def __init__(self, line: str) -> None:
        self.line = line
        self.data: list[str] = []
        self.ready = outcome()
        self.done = outcome()
        self.halfway = False

    def takes(self, kind: Kind, text: str) -> bool:
        """READY and OK; whatever else is no failure is an echo."""
        if kind is Kind.READY:
            resolve(self.ready)
        elif kind is Kind.OK:
            resolve(self.done)
        return kind is not Kind.FAILURE

    def fail(self, error: DeviceError) -> None:
        """It was not taken."""
        raise_in(self.ready, error)
        raise_in(self.done, error)


class Operation:
    """A command that waits for RUN and then for END, or for a single OK at its end."""

    def __init__(self, line: str) -> None:
        self.line = line
        self.accepted = outcome()
        self.finished = outcome()

    @property
    def began(self) -> bool:
        """Whether it was accepted, whatever happened then."""
        return self.accepted.done() and self.accepted.exception() is None

    def take(self, kind: Kind, *, run_before_end: bool) -> None:
        """A line that may belong to it."""
        if kind is Kind.RUN:
            resolve(self.accepted)
        elif kind is Kind.END or (kind is Kind.OK and not (run_before_end and self.accepted.done())):
            resolve(self.accepted)  # some firmware of the newer generation answers ALMRST and SERVO by a single OK
            resolve(self.finished)

    def fail(self, error: DeviceError) -> None:
        """It has not done what it should."""
        raise_in(self.accepted, error)
        raise_in(self.finished, error)


def outcome() -> asyncio.Future[None]:
    """What is waited for; nobody need fetch a failure."""
    future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    future.add_done_callback(lambda done: done.cancelled() or done.exception())
    return future


def resolve(future: asyncio.Future[None]) -> None:
    """It has come; nothing happens when it had already."""
    if not future.done():
        future.set_result(None)


def raise_in(future: asyncio.Future[None], error: DeviceError) -> None:
    """It will not come; nothing happens when it had already."""
    if not future.done():
        future.set_exception(error)
