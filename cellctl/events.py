"""What the daemon tells everybody who watches: one kind of event per function here, as plain data for JSON."""

from collections.abc import Mapping

from cellctl.machine import Mode, State

Event = Mapping[str, object]


def state_event(state: State, mode: Mode, why: str) -> Event:
    """The machine is in another state."""
    return {"event": "state", "state": state.title, "state_number": int(state), "mode": mode.title, "why": why}


def unit_event(unit: str, verdict: str, sentence: str, data: Mapping[str, object]) -> Event:
    """A unit has its final record; `data` is what was measured."""
    return {"event": "unit", "unit": unit, "verdict": verdict, "sentence": sentence, "data": dict(data)}


def progress_event(job: str, text: str, *, asks: str | None = None) -> Event:
    """A job (calibrate, teach) got somewhere; with `asks`, a person must do what the text says, then `proceed`.

    `asks` is the stable name of what is asked for, such as "seat-golden-assembly".
    """
    return {"event": "progress", "job": job, "text": text, "asks": asks}


def job_event(job: str, ok: bool, text: str, result: Mapping[str, object] | None = None) -> Event:
    """A job has ended."""
    return {"event": "job", "job": job, "ok": ok, "text": text, "result": dict(result or {})}
