"""One logged event as the line that an operator reads. Used while logging and when the log file is read back."""

from collections.abc import Mapping
from datetime import datetime

FILE_NAME = "cellctl.jsonl"
WHO_WIDTH = 37
LOUD = {"warning": "WARNING ", "error": "ERROR ", "critical": "ERROR "}


def operator_line(event: Mapping[str, object]) -> str:
    """Time, unit and step, what happened and why, how long it took, what to do.

    Knows the fields time, level, unit, step, name, logger, event, why, took_ms, remedy; all others are for machines.
    """
    loud = LOUD.get(str(event.get("level")), "")
    remedy = f" -> {event['remedy']}" if event.get("remedy") else ""
    took = f" ({event['took_ms']:.0f} ms)" if isinstance(event.get("took_ms"), int | float) else ""
    why = f": {event['why']}" if event.get("why") else ""
    text = " ".join(f"{event.get('event', '')}{why}".split())
    return f"{_clock(event)} {_who(event):<{WHO_WIDTH}} {loud}{text}{took}{remedy}"


def _clock(event: Mapping[str, object]) -> str:
    """The local time of day in milliseconds; a line whose time cannot be read still is a line."""
    try:
        return datetime.fromisoformat(str(event.get("time"))).astimezone().strftime("%H:%M:%S.%f")[:-3]
    except (ValueError, OverflowError):
        return "--:--:--.---"


def _who(event: Mapping[str, object]) -> str:
    words = [f"unit {event['unit']}"] if event.get("unit") else [str(event.get("logger") or "cell")]
    words += [str(event[key]) for key in ("step", "name") if event.get(key) is not None]
    return " ".join(words)
