"""What the daemon tells everybody who watches: one kind of event per function here, as plain data for JSON."""

from collections.abc import Mapping

Event = Mapping[str, object]


def state_event(state: str, number: int, mode: str, text: str = "") -> Event:
    """The machine is in another state; `text` says why."""
    return {"event": "state", "state": state, "number": number, "mode": mode, "text": text}


def unit_event(unit: str, verdict: str, text: str, data: Mapping[str, object] | None = None) -> Event:
    """A unit has its final record."""
    return {"event": "unit", "unit": unit, "verdict": verdict, "text": text, "data": dict(data or {})}


def progress_event(job: str, text: str, *, asks: str | None = None) -> Event:
    """A job (calibrate, teach) got somewhere; with `asks`, a person must do what the text says, then `proceed`.

    `asks` is the stable name of what is asked for, such as "seat-golden-assembly".
    """
    return {"event": "progress", "job": job, "text": text, "asks": asks}


def job_event(job: str, ok: bool, text: str, result: Mapping[str, object] | None = None) -> Event:
    """A job has ended."""
    return {"event": "job", "job": job, "ok": ok, "text": text, "result": dict(result or {})}
