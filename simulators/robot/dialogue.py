"""What programs print and ask: on the pendant's display, and, when it is set so, on the line."""

from collections import deque
from collections.abc import Callable

from simulators.robot.language.values import Value
from simulators.robot.log import Log


class Dialogue:
    """`tell` says a text to the clients. Questions are answered in the order in which they were asked."""

    def __init__(self, log: Log) -> None:
        self.tell: Callable[[str], None] = lambda text: None
        self._log = log
        self._asking: deque[int] = deque()
        self._answers: dict[int, str] = {}

    @property
    def asks(self) -> bool:
        """Whether a program waits to be told something."""
        return bool(self._asking)

    def say(self, task: int, values: list[Value]) -> None:
        """PRINT."""
        self._log.add("print", task=task, values=values)
        self.tell(" ".join(str(value) for value in values))

    def ask(self, task: int, prompt: Value | None) -> None:
        """INPUT."""
        if prompt is not None:
            self.say(task, [prompt])
        self._asking.append(task)

    def answer(self, text: str) -> None:
        """Somebody answers the oldest question; raises ValueError when there is none."""
        if not self._asking:
            raise ValueError("no program asks for an input")
        self._answers[self._asking.popleft()] = text

    def take(self, task: int) -> str | None:
        """The answer, once it is there."""
        return self._answers.pop(task, None)

    def forget(self, task: int) -> None:
        """The task has been stopped while it asked."""
        if task in self._asking:
            self._asking.remove(task)
