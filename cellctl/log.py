"""The log: readable lines for the operator on a stream, JSON lines for machines in a file, and the `step` block.

    log = configure(folder / FILE_NAME, level="info")
    with bound(unit="20261122-000123"), trace() as steps:
        with step(3, "locate base") as found:
            found.text = "base dX -0.003 dY +0.115 mm dT -0.134 deg"

writes `14:03:07.412 unit 20261122-000123 3 locate base     base dX -0.003 ... (31 ms)` and keeps the duration.
"""

import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Literal, NamedTuple, NoReturn, TextIO, cast

import structlog
from structlog.typing import FilteringBoundLogger

from cellctl.log_file import Entry, LogWriter, entry_of, now_text

Level = Literal["debug", "info", "warning", "error"]
Outcome = Literal["done", "failed", "cancelled"]
MB = 1_000_000

log = cast(FilteringBoundLogger, structlog.get_logger())
bind = structlog.contextvars.bind_contextvars  # from now on, every line of this task names these facts
bind = structlog.contextvars.bind_contextvars


class Log:
    """The log of this process, from `configure` to `close`."""

    def __init__(self, writer: LogWriter, handler: logging.Handler) -> None:
        self._writer = writer
        self._handler = handler

    def close(self) -> None:
        """Write what waits and let the file go. May be called twice."""
        logging.getLogger().removeHandler(self._handler)
        structlog.reset_defaults()
        self._writer.close()


def configure(
    path: Path | None,
    level: Level = "info",
    stream: TextIO | None = None,
    *,
    rotate_mb: float = 32.0,
    keep: int = 10,
) -> Log:
    """Send the log of this process to `stream` (default: standard output) and to the file `path`.

    A file beyond `rotate_mb` is put aside as PATH.1, up to PATH.<keep>. Loggers of the standard library come in too.
    """
    writer = LogWriter(path, stream or sys.stdout, rotate_bytes=int(rotate_mb * MB), keep=keep)
    least = logging.getLevelNamesMapping()[level.upper()]
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            _stamp,
            structlog.processors.format_exc_info,
            _Hand(writer.put),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(least),
    )
    return Log(writer, _route_standard_library(least))


def _stamp(_logger: object, _method: str, event: MutableMapping[str, object]) -> MutableMapping[str, object]:
    return {"time": now_text(), "mono_s": round(time.monotonic(), 6), **event}


class _Hand:
    """Last processor: hand the event to the writer thread, as both of its forms."""

    def __init__(self, put: Callable[[Entry], None]) -> None:
        self._put = put

    def __call__(self, _logger: object, _method: str, event: Mapping[str, object]) -> NoReturn:
        self._put(entry_of(event))
        raise structlog.DropEvent


class _FromStandardLibrary(logging.Handler):
    """Takes what libraries log, on one line."""

    def emit(self, record: logging.LogRecord) -> None:
        """Log it as ours, with the library's logger name; a library's bad format string costs only its arguments."""
        try:
            text = record.getMessage()
        except (TypeError, ValueError):
            text = str(record.msg)
        level = max(logging.DEBUG, min(record.levelno // 10 * 10, logging.CRITICAL))
        log.log(level, text, logger=record.name, exc_info=record.exc_info)


def _route_standard_library(least: int) -> logging.Handler:
    handler = _FromStandardLibrary()
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(least)
    logging.getLogger("asyncio").setLevel(logging.WARNING)
    return handler


# -- steps -------------------------------------------------------------------------------------------------


@contextmanager
def bound(**facts: object) -> Iterator[None]:
    """Every line inside names these facts; what was bound inside, by `bind` too, is forgotten at the end."""
    before = structlog.contextvars.get_contextvars()
    bind(**facts)
    try:
        yield
    finally:
        structlog.contextvars.clear_contextvars()
        bind(**before)


class StepTime(NamedTuple):
    """How long a step of the cycle took."""

    number: int
    name: str
    took_ms: float
    outcome: Outcome


@dataclass
class StepLine:
    """What the line at the end of a step will say; `data` is for machines."""

    text: str = "done"
    data: dict[str, object] = field(default_factory=dict)


_steps: ContextVar[list[StepTime] | None] = ContextVar("steps", default=None)


@contextmanager
def trace() -> Iterator[list[StepTime]]:
    """Collect the durations of all steps inside, also of tasks that are started inside."""
    steps: list[StepTime] = []
    token = _steps.set(steps)
    try:
        yield steps
    finally:
        _steps.reset(token)


class step(AbstractContextManager[StepLine]):  # noqa: N801 - reads as a statement: with step(3, "look at base"):
    """Log one step of the cycle with its duration; every line logged inside names it."""

    def __init__(self, number: int, name: str) -> None:
        self._number = number
        self._name = name
        self._line = StepLine()
        self._stack = ExitStack()
        self._began_s = 0.0

    def __enter__(self) -> StepLine:
        # only these two are taken back: a unit that is bound inside a step outlives the step
        self._stack.enter_context(structlog.contextvars.bound_contextvars(step=self._number, name=self._name))
        self._began_s = time.monotonic()
        return self._line

    def __exit__(
        self, _kind: type[BaseException] | None, error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        took_ms = round((time.monotonic() - self._began_s) * 1000, 3)
        with self._stack:
            outcome = self._log_end(error, took_ms)
        steps = _steps.get()
        if steps is not None:
            steps.append(StepTime(self._number, self._name, took_ms, outcome))

    def _log_end(self, error: BaseException | None, took_ms: float) -> Outcome:
        data = {"data": self._line.data} if self._line.data else {}
        if error is None:
            log.info(self._line.text, took_ms=took_ms, outcome="done", **data)
            return "done"
        if isinstance(error, Exception):
            log.warning(f"failed: {error}", took_ms=took_ms, outcome="failed", error=type(error).__name__, **data)
            return "failed"
        log.info("cancelled", took_ms=took_ms, outcome="cancelled", **data)
        return "cancelled"
