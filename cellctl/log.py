"""The log: readable lines for the operator on a stream, JSON lines for machines in a file, and the `step` block.

    log = configure(folder / FILE_NAME, level="info")
    with bound(unit="20261122-000123"), trace() as steps:
        with step(3, "locate base") as found:
            found.text = "base dX -0.003 dY +0.115 mm dT -0.134 deg"

writes `14:03:07.412 unit 20261122-000123 3 locate base     base dX -0.003 ... (31 ms)` and keeps the duration.
"""

import json
import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal, NamedTuple, NoReturn, TextIO, cast

import structlog
from structlog.typing import FilteringBoundLogger

from cellctl.lines import operator_line
from cellctl.log_file import Entry, LogWriter

Level = Literal["debug", "info", "warning", "error"]
MB = 1_000_000

log = cast(FilteringBoundLogger, structlog.get_logger())
bound = structlog.contextvars.bound_contextvars  # with bound(unit="..."): every line inside names the unit


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
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
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
    now = datetime.now().astimezone().isoformat(timespec="milliseconds")
    return {"time": now, "mono_s": round(time.monotonic(), 6), **event}


class _Hand:
    """Last processor: hand the event to the writer thread, as both of its forms."""

    def __init__(self, put: Callable[[Entry], None]) -> None:
        self._put = put

    def __call__(self, _logger: object, _method: str, event: Mapping[str, object]) -> NoReturn:
        text = json.dumps(event, default=str, ensure_ascii=False, separators=(",", ":"))
        self._put(Entry(operator_line(event), text))
        raise structlog.DropEvent


class _FromStandardLibrary(logging.Handler):
    """Takes what libraries log, on one line."""

    def emit(self, record: logging.LogRecord) -> None:
        """Log it as ours, with the library's logger name."""
        log.log(record.levelno, record.getMessage(), logger=record.name, exc_info=record.exc_info)


def _route_standard_library(least: int) -> logging.Handler:
    handler = _FromStandardLibrary()
    root = logging.getLogger()
    root.addHandler(handler)
    root.setLevel(least)
    logging.getLogger("asyncio").setLevel(logging.WARNING)
    logging.getLogger("pymodbus").setLevel(logging.WARNING)
    return handler


# -- steps -------------------------------------------------------------------------------------------------


class StepTime(NamedTuple):
    """How long a step of the cycle took."""

    number: int
    name: str
    took_ms: float
    outcome: Literal["done", "failed", "cancelled"]


@dataclass
class StepLine:
    """What the line at the end of a step will say; `data` is for machines."""

    text: str = "done"
    data: dict[str, object] = field(default_factory=dict)


_trace: ContextVar[list[StepTime] | None] = ContextVar("trace", default=None)


@contextmanager
def trace() -> Iterator[list[StepTime]]:
    """Collect the durations of all steps inside, also of tasks that are started inside."""
    steps: list[StepTime] = []
    token = _trace.set(steps)
    try:
        yield steps
    finally:
        _trace.reset(token)


@contextmanager
def step(number: int, name: str) -> Iterator[StepLine]:
    """Log one step of the cycle with its duration; every line logged inside names it."""
    line = StepLine()
    began_s = time.monotonic()
    with bound(step=number, name=name):
        try:
            yield line
        finally:
            _end_of_step(number, name, line, (time.monotonic() - began_s) * 1000)


def _end_of_step(number: int, name: str, line: StepLine, took_ms: float) -> None:
    error = sys.exception()
    steps = _trace.get()
    if error is None:
        outcome: Literal["done", "failed", "cancelled"] = "done"
        log.info(line.text, took_ms=round(took_ms, 3), outcome=outcome, **line.data)
    elif isinstance(error, Exception):
        outcome = "failed"
        log.warning(f"failed: {error}", took_ms=round(took_ms, 3), outcome=outcome, error=type(error).__name__)
    else:
        outcome = "cancelled"
        log.info("cancelled", took_ms=round(took_ms, 3), outcome=outcome)
    if steps is not None:
        steps.append(StepTime(number, name, round(took_ms, 3), outcome))
