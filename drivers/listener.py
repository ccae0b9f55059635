"""What is made of the lines that a controller sends: whose they are, of a question, of an operation, or of nobody."""

import asyncio
from collections.abc import Callable, Sequence

from drivers.errors import DeviceError
from drivers.exchange import FileOut, Operation, Question, Waiting
from drivers.rcx import CONTROL, Code, Kind, classify, parse_failure
from drivers.rcx_dialect import Dialect

QUESTION_GROUPS = (0, 4, 5, 14)  # codes that a query or a setting can earn


class Listener:
    """Hears one connection, from its beginning to its end. `question` and `operation` are those that wait.

    `refusal` makes the error for a code, `garbled` the one for an answer that is none, after which nothing is trusted.
    """

    def __init__(
        self,
        dialect: Dialect,
        refusal: Callable[[Code, str], DeviceError],
        garbled: Callable[[str, Sequence[str]], DeviceError],
    ) -> None:
        self.question: Question | FileOut | None = None
        self.operation: Operation | None = None
        self.greeted = asyncio.Event()
        self.heard = 0
        self.last_kind = Kind.NOTHING
        self.sent = ""
        self._dialect, self._refusal, self._garbled = dialect, refusal, garbled

    def take(self, line: str) -> None:
        """One line."""
        self.heard += 1
        text = line.translate(CONTROL).strip()
        if self.sent and text == self.sent:
            return  # an echo; no answer begins with @
        self.last_kind = kind = classify(text)
        question = self.question
        if question is not None and question.takes(kind, text):
            if question.overflows:
                question.fail(self._garbled(question.line, question.data))
        elif kind is Kind.NOTHING:
            self.greeted.set()
        elif kind is Kind.FAILURE:
            self._take_failure(text)
        elif self.operation is not None:
            self.operation.take(kind, run_before_end=self._dialect.grammar.run_before_end)

    def fail(self, error: DeviceError) -> None:
        """Nothing will come any more."""
        for waiting in (self.question, self.operation):
            if waiting is not None:
                waiting.fail(error)

    def _take_failure(self, line: str) -> None:
        code = parse_failure(line)
        waiting = self._who_failed(code)
        if waiting is None:
            return
        if code is None:
            waiting.fail(self._garbled(waiting.line, [line]))
        else:
            waiting.fail(self._refusal(code, f"{waiting.line}: {self._dialect.meaning(code)}"))

    def _who_failed(self, code: Code | None) -> Waiting | None:
        question, operation = self.question, self.operation
        if question is None or question.done.done():
            return operation
        if operation is None or operation.finished.done():
            # a stop may still be reported for a motion that an earlier conversation had begun
            return None if code is not None and self._dialect.is_event(code) else question
        return question if code is not None and _of_question(code) and not question.data else operation


def _of_question(code: Code) -> bool:
    return code.group in QUESTION_GROUPS or (code.group == 6 and 200 <= code.number < 300)
