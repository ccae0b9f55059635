"""A conversation with an RCX controller: at most one question and one operation in flight, each with a deadline.

The end of an operation may come at any time, also between the data and the OK of a question's answer. After a
time-out or a garbled answer the link is poisoned: which line answers what is no longer known. `open` starts afresh.
"""

import asyncio
import contextlib
from collections.abc import Coroutine

from drivers.errors import Collision, DeviceError, Garbled, NoAnswer, Refused
from drivers.link import LineLink
from drivers.rcx import STOP, Code, Kind, classify, parse_failure
from drivers.rcx_codes import COLLISIONS

ANSWER_S = 1.0
STOP_S = 2.0
GREETING_S = 0.5
SILENCE_S = 0.1
MOST_SILENCES = 20
MOST_DATA_LINES = 16
EVENT_GROUP = 1
QUESTION_GROUPS = (0, 4, 5, 14)  # codes that a query or a setting can earn


async def uncancelled(work: Coroutine[None, None, None]) -> None:
    """Do this to its end even when cancelled meanwhile; the cancellation is raised afterwards. Must be bounded."""
    task = asyncio.create_task(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait((task,))
        except asyncio.CancelledError as error:
            cancelled = error
    task.result()
    if cancelled is not None:
        raise cancelled


class _Question:
    """A query or a setting that waits for OK."""

    def __init__(self, line: str) -> None:
        self.line = line
        self.data: list[str] = []
        self.done = _outcome()

    def fail(self, error: DeviceError) -> None:
        _raise_in(self.done, error)


class _Operation:
    """A command that waits for RUN and then for END."""

    def __init__(self, line: str) -> None:
        self.line = line
        self.accepted = _outcome()
        self.finished = _outcome()

    def finish(self) -> None:
        _resolve(self.accepted)
        _resolve(self.finished)

    def fail(self, error: DeviceError) -> None:
        _raise_in(self.accepted, error)
        _raise_in(self.finished, error)


class Conversation:
    """Questions and operations over one link."""

    def __init__(self, address: str, *, device: str) -> None:
        self.device = device
        self._link = LineLink(address, device=device)
        self._question: _Question | None = None
        self._operation: _Operation | None = None
        self._asking = asyncio.Lock()
        self._greeted = asyncio.Event()
        self._reader: asyncio.Task[None] | None = None
        self._lines_heard = 0

    @property
    def is_open(self) -> bool:
        """Whether the other side can be talked to."""
        return self._link.is_open

    async def open(self) -> None:
        """Connect and begin to read; raises LinkLost."""
        await self.close()
        await self._link.open()
        self._greeted.clear()
        self._reader = asyncio.create_task(self._read(), name=f"{self.device} reader")

    async def close(self) -> None:
        """Hang up; whoever waits for an answer gets LinkLost."""
        await self._link.close()
        reader, self._reader = self._reader, None
        if reader is not None:
            await asyncio.wait((reader,))  # it ends with the link

    async def quiet(self) -> None:
        """Let a network greeting pass, or, on a serial line, the answers to an earlier conversation."""
        if self._link.is_serial:
            await self._silence()
        elif self._reader is not None:
            greeted = asyncio.create_task(self._greeted.wait())
            try:
                waiting = (greeted, self._reader)
                await asyncio.wait(waiting, timeout=GREETING_S, return_when=asyncio.FIRST_COMPLETED)
            finally:
                greeted.cancel()

    async def ask(self, line: str) -> list[str]:
        """Send a query or a setting and return the data lines before its OK.

        Raises Refused, NoAnswer, LinkLost, Garbled. When cancelled it first lets the answer come in.
        """
        async with self._asking:
            question = self._question = _Question(line)
            try:
                self._link.send(line)
                await self._wait(question.done, ANSWER_S, f"no answer to {line}")
            except asyncio.CancelledError:
                await uncancelled(self._let_come(question))
                raise
            finally:
                self._question = None
            return question.data

    async def operate(self, line: str, *, within_s: float) -> None:
        """Send an operation, wait for RUN, and for END at most `within_s` seconds.

        One at a time. Cancelled or late, it stops the operation and waits (at most 2 s) until that is reported.
        Raises Refused, NoAnswer, LinkLost, Garbled.
        """
        operation = self._operation = _Operation(line)
        try:
            async with self._asking:
                self._link.send(line)
                await self._wait(operation.accepted, ANSWER_S, f"no RUN after {line}", poison=False)
            await self._wait(operation.finished, within_s, f"no END after {line}", poison=False)
        except (asyncio.CancelledError, NoAnswer) as error:
            await uncancelled(self._abort(operation, trusted=not isinstance(error, NoAnswer)))
            raise
        finally:
            self._operation = None

    def stop(self) -> None:
        """Stop the running operation now, out of turn; its own wait sees the end. Raises LinkLost."""
        self._link.tell(STOP)

    def garbled(self, line: str, answer: list[str]) -> Garbled:
        """Poison the link because of this answer; returns the error to raise."""
        self._link.poison("a garbled answer came")
        return Garbled(self.device, f"{line} was answered by {answer}")

    async def _wait(
        self, outcome: asyncio.Future[None], within_s: float, complaint: str, *, poison: bool = True
    ) -> None:
        try:
            async with asyncio.timeout(within_s):
                await asyncio.shield(outcome)
        except TimeoutError:
            if poison:
                self._link.poison("an answer did not come in time")
            raise NoAnswer(self.device, f"{complaint} within {within_s:.3g} s") from None

    async def _silence(self) -> None:
        for _ in range(MOST_SILENCES):
            heard = self._lines_heard
            await asyncio.sleep(SILENCE_S)
            if self._lines_heard == heard:
                return

    async def _let_come(self, question: _Question) -> None:
        await asyncio.wait((question.done,), timeout=ANSWER_S)
        if not question.done.done():
            self._link.poison("an answer did not come in time")

    async def _abort(self, operation: _Operation, *, trusted: bool) -> None:
        """Stop until the end is reported. The command may still be on its way in, so stop again after RUN."""
        with contextlib.suppress(DeviceError):
            self.stop()
            if not operation.accepted.done():
                await asyncio.wait((operation.accepted,), timeout=ANSWER_S)
                self.stop()
            await asyncio.wait((operation.finished,), timeout=STOP_S)
        if not (trusted and operation.finished.done()):
            self._link.poison("an operation did not end in time")

    async def _read(self) -> None:
        try:
            while True:
                self._take(await self._link.line())
        except DeviceError as error:
            for waiting in (self._question, self._operation):
                if waiting is not None:
                    waiting.fail(error)

    def _take(self, line: str) -> None:
        self._lines_heard += 1
        kind = classify(line)
        if kind is Kind.NOTHING:
            self._greeted.set()
        elif kind is Kind.FAILURE:
            self._take_failure(line)
        elif self._question is not None and kind in (Kind.OK, Kind.DATA):
            self._take_answer(self._question, kind, line)
        elif self._operation is not None:
            self._take_progress(self._operation, kind)

    def _take_answer(self, question: _Question, kind: Kind, line: str) -> None:
        if kind is Kind.OK:
            _resolve(question.done)
        elif len(question.data) < MOST_DATA_LINES:
            question.data.append(line.strip())
        else:
            question.fail(self.garbled(question.line, question.data[:2]))

    def _take_progress(self, operation: _Operation, kind: Kind) -> None:
        if kind is Kind.RUN:
            _resolve(operation.accepted)
        elif kind is Kind.END or (kind is Kind.OK and not operation.accepted.done()):
            operation.finish()  # some firmware answers ALMRST and SERVO by a single OK

    def _take_failure(self, line: str) -> None:
        code = parse_failure(line)
        waiting = self._who_failed(code)
        if waiting is None:
            return
        if code is None:
            waiting.fail(self.garbled(waiting.line, [line]))
        else:
            waiting.fail(refusal(self.device, str(code), f"{waiting.line}: {code.meaning}"))

    def _who_failed(self, code: Code | None) -> _Question | _Operation | None:
        question, operation = self._question, self._operation
        if question is None or question.done.done():
            return operation
        if operation is None or operation.finished.done():
            # a stop may still be reported for a motion that an earlier conversation had begun
            return None if code is not None and code.group == EVENT_GROUP else question
        return question if code is not None and _of_question(code) and not question.data else operation


def refusal(device: str, code: str, detail: str) -> Refused:
    """The error for a code of the controller; what the arm reports when it hits something is told apart."""
    return (Collision if code in COLLISIONS else Refused)(device, code, detail)


def _of_question(code: Code) -> bool:
    return code.group in QUESTION_GROUPS or (code.group == 6 and 200 <= code.number < 300)


def _outcome() -> asyncio.Future[None]:
    future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    future.add_done_callback(lambda done: done.cancelled() or done.exception())  # nobody need fetch a failure
    return future


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def _raise_in(future: asyncio.Future[None], error: DeviceError) -> None:
    if not future.done():
        future.set_exception(error)
