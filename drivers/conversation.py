"""A conversation with an RCX controller: at most one question and one operation in flight, each with a deadline.

The end of an operation may come at any time, also between the data and the OK of a question's answer. After a
time-out or a garbled answer the link is poisoned: which line answers what is no longer known. `open` starts afresh.
"""

import asyncio
import contextlib
from collections.abc import Coroutine, Sequence

from drivers.errors import Collision, DeviceError, Garbled, NoAnswer, Refused
from drivers.exchange import FileOut, Operation, Question
from drivers.link import LineLink
from drivers.listener import Listener
from drivers.rcx import HOLD, STOP, Code, Kind
from drivers.rcx_dialect import Dialect

ANSWER_S = 1.0
STOP_S = 2.0
STOP_AGAIN_S = 0.05
BUSY_PAUSES_S = (0.05, 0.1, 0.2, None)
SILENCE_S = 0.1
MOST_SILENCES = 20
LATE_S = 0.01  # what has arrived while this process was busy is not late
FILE_SILENCE_S = 2.0
LINE_S = 0.02  # in which the controller takes a line of a file


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


class Conversation:
    """Questions and operations over one link."""

    def __init__(self, address: str, dialect: Dialect, *, device: str) -> None:
        self.device = device
        self._dialect = dialect
        self._grammar = dialect.grammar
        self._link = LineLink(address, device=device)
        self._listener = Listener(dialect, self.refusal, self.garbled)
        self._asking = asyncio.Lock()
        self._reader: asyncio.Task[None] | None = None

    @property
    def is_open(self) -> bool:
        """Whether the other side can be talked to."""
        return self._link.is_open

    @property
    def is_serial(self) -> bool:
        """Whether it is a serial line, which keeps the bytes of earlier conversations."""
        return self._link.is_serial

    async def open(self) -> None:
        """Connect and begin to read; raises LinkLost."""
        await self.close()
        await self._link.open()
        self._grammar = self._dialect.grammar
        self._listener = Listener(self._dialect, self.refusal, self.garbled)
        self._reader = asyncio.create_task(self._read(), name=f"{self.device} reader")

    async def close(self) -> None:
        """Stop what runs, take leave as the dialect wants it, hang up; whoever waits for an answer gets LinkLost."""
        if self._listener.operation is not None and self.is_open:
            await self._abort(self._listener.operation, trusted=True)
        with contextlib.suppress(DeviceError):
            if self.is_open and self._dialect.good_bye and not self.is_serial:
                self._link.send(self._dialect.good_bye)
                await self._hung_up()
        await self._link.close()
        reader, self._reader = self._reader, None
        if reader is not None:
            await asyncio.wait((reader,))  # it ends with the link

    async def quiet(self) -> None:
        """Let a network greeting pass, or, on a serial line, the answers to an earlier conversation."""
        if self.is_serial:
            self._link.send("")  # ends a file that was half way in
            await self._silence()
        elif self._reader is not None:
            greeted = asyncio.create_task(self._listener.greeted.wait())
            try:
                waiting = (greeted, self._reader)
                await asyncio.wait(waiting, timeout=self._dialect.greeting_s, return_when=asyncio.FIRST_COMPLETED)
            finally:
                greeted.cancel()

    async def learn(self, line: str) -> None:
        """Ask this, and from its answer whether a query's data is followed by OK, which manuals do not say of all."""
        if self._grammar.ok_after_data:
            await self.ask(line)
            return
        await self.ask(line)
        await self._silence()
        if self._listener.last_kind is Kind.OK:
            self._grammar = self._grammar._replace(ok_after_data=True)

    # -- questions ---------------------------------------------------------------------------------------

    async def ask(self, line: str, *, within_s: float = ANSWER_S, codes_are_data: bool = False) -> list[str]:
        """Send a query and return its data lines. `codes_are_data`: its answer may look like a refusal.

        Raises Refused, NoAnswer, LinkLost, Garbled. When cancelled it first lets the answer come in.
        """
        ends = Kind.OK if self._grammar.ok_after_data else Kind.DATA
        return await self._put(Question(line, ends, codes_are_data=codes_are_data), within_s)

    async def set(self, line: str) -> None:
        """Send a setting; raises as `ask`."""
        if answer := await self._put(Question(line, Kind.OK), ANSWER_S):
            raise self.garbled(line, answer)

    async def fetch(self, line: str) -> list[str]:
        """READ a file: its lines, without BEGIN and END. Raises as `ask`."""
        async with self._asking:
            question = self._listener.question = Question(line, Kind.END)
            try:
                self._send(line)
                return await self._file(question)
            except BaseException as error:
                if not isinstance(error, Refused):
                    self._link.poison("a file did not come whole")
                raise
            finally:
                self._listener.question = None

    async def store(self, line: str, content: Sequence[str]) -> None:
        """WRITE a file; it takes its place when the last line has come. Raises as `ask`."""
        async with self._asking:
            upload = self._listener.question = FileOut(line)
            try:
                await self._upload(upload, content)
            except BaseException as error:
                if upload.halfway or not isinstance(error, Refused):
                    self._link.poison("a file did not go whole")
                raise
            finally:
                self._listener.question = None

    async def _put(self, question: Question, within_s: float) -> list[str]:
        async with self._asking:
            self._listener.question = question
            try:
                self._send(question.line)
                await self._wait(question.done, within_s, f"no answer to {question.line}")
            except asyncio.CancelledError:
                await uncancelled(self._let_come(question))
                raise
            finally:
                self._listener.question = None
            return question.data

    # -- operations --------------------------------------------------------------------------------------

    async def operate(self, line: str, *, within_s: float) -> None:
        """Send an operation and wait at most `within_s` seconds for its end. A busy one is asked three times more.

        One at a time. Cancelled or late, it stops the operation and waits (at most 2 s) until that is reported.
        Raises Refused, NoAnswer, LinkLost, Garbled.
        """
        for pause_s in BUSY_PAUSES_S:
            operation = self._listener.operation = Operation(line)
            try:
                await self._operate(operation, within_s)
                return
            except Refused as refused:
                if pause_s is None or operation.began or not self._dialect.is_busy(refused.code):
                    raise
            except (asyncio.CancelledError, NoAnswer) as error:
                await uncancelled(self._abort(operation, trusted=not isinstance(error, NoAnswer)))
                raise
            finally:
                self._listener.operation = None
            await asyncio.sleep(pause_s)

    async def _operate(self, operation: Operation, within_s: float) -> None:
        line = operation.line
        if self._grammar.answers_in_motion:
            async with self._asking:
                self._send(line)
                await self._wait(operation.accepted, ANSWER_S, f"no RUN after {line}", poison=False)
            await self._wait(operation.finished, within_s, f"no END after {line}", poison=False)
        else:
            async with self._asking:
                self._send(line)
                await self._wait(operation.finished, within_s, f"no OK after {line}", poison=False)

    def stop(self) -> None:
        """Stop the running operation now, out of turn; its own wait sees the end. Raises LinkLost."""
        self._link.tell(STOP)

    def hold(self) -> None:
        """Keep a jog going. Raises LinkLost."""
        self._link.tell(HOLD)

    def garbled(self, line: str, answer: Sequence[str]) -> Garbled:
        """Poison the link because of this answer; returns the error to raise."""
        self._link.poison("a garbled answer came")
        return Garbled(self.device, f"{line} was answered by {list(answer[:2])}")

    def refusal(self, code: Code | None, detail: str) -> Refused:
        """The error for a code of the controller; what the arm reports when it hits something is told apart."""
        if code is None:
            return Refused(self.device, "not ready", detail)
        return (Collision if self._dialect.is_collision(code) else Refused)(self.device, str(code), detail)

    # -- sending and waiting -----------------------------------------------------------------------------

    def _send(self, line: str) -> None:
        self._listener.sent = line
        self._link.send(line)

    async def _wait(
        self, outcome: asyncio.Future[None], within_s: float, complaint: str, *, poison: bool = True
    ) -> None:
        for patience_s in (within_s, LATE_S):
            await asyncio.wait((outcome,), timeout=patience_s)
            if outcome.done():
                outcome.result()
                return
        if poison:
            self._link.poison("an answer did not come in time")
        raise NoAnswer(self.device, f"{complaint} within {within_s:.3g} s")

    async def _upload(self, upload: FileOut, content: Sequence[str]) -> None:
        self._send(upload.line)
        await self._wait(upload.ready, ANSWER_S, f"no READY after {upload.line}")
        upload.halfway = True
        for line in (*content, ""):
            if upload.done.done():
                break  # it was refused
            upload.halfway = line != ""
            self._link.send(line)
            await self._link.drained()
        await self._wait(upload.done, FILE_SILENCE_S + LINE_S * len(content), f"no OK after the file of {upload.line}")

    async def _file(self, question: Question) -> list[str]:
        """Until END, after which nothing comes: a program may have a line END of its own."""
        while True:
            ended = question.data[-1:] == [Kind.END.name]
            question.news.clear()
            try:
                async with asyncio.timeout(SILENCE_S if ended else FILE_SILENCE_S):
                    await question.news.wait()
            except TimeoutError:
                if ended:
                    return question.data[:-1]
                raise NoAnswer(self.device, f"{question.line} stopped after {len(question.data)} lines") from None
            if question.done.done():
                question.done.result()  # raises: a file has no other end

    async def _silence(self) -> None:
        for _ in range(MOST_SILENCES):
            heard = self._listener.heard
            await asyncio.sleep(SILENCE_S)
            if self._listener.heard == heard:
                return

    async def _hung_up(self) -> None:
        if self._reader is not None:
            await asyncio.wait((self._reader,), timeout=STOP_S)

    async def _let_come(self, question: Question) -> None:
        await asyncio.wait((question.done,), timeout=ANSWER_S)
        if not question.done.done():
            self._link.poison("an answer did not come in time")

    async def _abort(self, operation: Operation, *, trusted: bool) -> None:
        """Stop until the end is reported. The command may still be on its way in, so stop again and again."""
        loop = asyncio.get_running_loop()
        deadline_s = loop.time() + STOP_S
        with contextlib.suppress(DeviceError):
            while not operation.finished.done() and loop.time() < deadline_s:
                self.stop()
                await asyncio.wait((operation.finished,), timeout=STOP_AGAIN_S)
        if not (trusted and operation.finished.done()):
            self._link.poison("an operation did not end in time")

    async def _read(self) -> None:
        listener = self._listener
        try:
            while True:
                listener.take(await self._link.line())
        except DeviceError as error:
            listener.fail(error)
