"""`cellctl camera info`: what a camera of the cell tells of itself. It may be at work meanwhile."""

import json
from typing import Any

import click

from cellctl.config import load_config
from cellctl.desk.camera_link import Which, camera_of
from cellctl.desk.commands import run_loop
from cellctl.pictures.files import picture_paths
from drivers import gige_facts, v4l2_facts

UNITS = {"c": "C", "px": "px", "us": "us", "db": "dB", "bytes": "bytes", "ticks": "ticks", "ms": "ms"}


def info(which: Which, *, as_json: bool) -> int:
    """Print it. Raises SettingsError, DeviceError, PictureError."""
    wanted = camera_of(load_config(which.config), which.number)
    if wanted.driver == "files":
        told: dict[str, Any] = {"folder": str(wanted.folder), "pictures": len(picture_paths([wanted.folder]))}
    else:
        facts = v4l2_facts if wanted.driver == "v4l2" else gige_facts
        told = dict(run_loop(facts.facts(which.name, wanted.address)))
    click.echo(json.dumps(told) if as_json else "\n".join(_lines(told)))
    return 0


def _lines(told: dict[str, Any]) -> list[str]:
    named = {key: _named(key) for key in told}
    width = max(len(name) for name, _ in named.values()) + 2
    return [f"{named[key][0]:<{width}}{_text(key, value)}{named[key][1]}" for key, value in told.items()]


def _named(key: str) -> tuple[str, str]:
    """Name and unit of a value for people."""
    name, _, unit = key.rpartition("_")
    return (name.replace("_", " "), f" {UNITS[unit]}") if unit in UNITS else (key.replace("_", " "), "")


def _text(key: str, value: object) -> str:
    if key == "free":
        return "yes" if value else "no, another program controls it"
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
