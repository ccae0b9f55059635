"""A thread of one device for calls that block, and how threads talk to the event loop."""

import asyncio
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

T = TypeVar("T")


class Worker:
    """A thread for blocking calls in turn. Daemonic: a call that is stuck must not keep the process from ending."""

    def __init__(self, name: str, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._jobs: queue.SimpleQueue[tuple[asyncio.Future[Any], Callable[[], Any]] | None] = queue.SimpleQueue()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def call(self, function: Callable[[], T]) -> "asyncio.Future[T]":
        """Have it called in turn. Cancelling the future does not stop the call."""
        answer: asyncio.Future[T] = self._loop.create_future()
        self._jobs.put((answer, function))
        return answer

    def finish(self) -> None:
        """End the thread after the calls already asked for."""
        self._jobs.put(None)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            answer, function = job
            try:
                result = function()
            except Exception as error:  # not handled here: it is raised where the answer is awaited
                post(self._loop, _fail, answer, error)
            else:
                post(self._loop, _give, answer, result)


def post(loop: asyncio.AbstractEventLoop, function: Callable[..., None], *arguments: object) -> None:
    """Have the loop call it; nothing when the loop is closed, for then nobody waits."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(function, *arguments)


def _give(answer: "asyncio.Future[Any]", result: object) -> None:
    if not answer.done():
        answer.set_result(result)


def _fail(answer: "asyncio.Future[Any]", error: Exception) -> None:
    if not answer.done():
        answer.set_exception(error)
