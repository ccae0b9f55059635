"""`cellctl camera list`: which cameras answer on this computer's networks, and which of them are the cell's."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import click

from cellctl.config import CellConfig, load_config
from cellctl.desk.camera_link import camera_of
from cellctl.desk.commands import run_loop
from drivers.gige_discovery import Sighting, discover
from drivers.v4l2_facts import cameras

HEAD = ("address", "serial", "maker", "model", "name", "MAC", "heard on", "in the cell")
NOTHING = "no camera answered; `cellctl camera check` says what may be wrong with the network"


class Row(NamedTuple):
    """One camera. `cell`: what it is in cell.toml, or why it is not."""

    address: str
    serial: str
    maker: str
    model: str
    user_name: str
    mac: str
    card: str
    cell: str


def list_cameras(config_path: Path | None, *, as_json: bool, within_s: float) -> int:
    """Print them; 1 when a camera of the cell is not among them. Raises SettingsError."""
    config = load_config(config_path) if config_path is not None else None
    asked = _gige_addresses(config)
    sightings = run_loop(discover(within_s=within_s, addresses=list(asked)))
    rows = [_row(sighting, config) for sighting in sightings] + _video_rows(config)
    missing = [number for address, number in asked.items() if address not in {row.address for row in rows}]
    if as_json:
        listed = [row._asdict() for row in rows]
        click.echo(json.dumps({"cameras": listed, "missing": [f"camera {number}" for number in missing]}))
    else:
        click.echo("\n".join(_table(rows)) if rows else NOTHING)
        for address, number in asked.items():
            if number in missing:
                click.echo(f"camera {number} of the cell does not answer at {address}: `cellctl camera check {number}`")
    return 1 if missing else 0


def _gige_addresses(config: CellConfig | None) -> dict[str, int]:
    cameras = [(number, camera_of(config, number)) for number in (1, 2)] if config is not None else []
    return {camera.address: number for number, camera in cameras if camera.driver == "gige"}


def _row(sighting: Sighting, config: CellConfig | None) -> Row:
    camera, nic = sighting.camera, sighting.nic
    card = f"{nic.name} {nic.interface}" if nic is not None else "its address"
    place = str(camera.address)
    cell = _cell(place, camera.serial, config)
    return Row(place, camera.serial, camera.vendor, camera.model, camera.user_name, camera.mac, card, cell)


def _cell(address: str, serial: str, config: CellConfig | None) -> str:
    for number in (1, 2) if config is not None else ():
        assert config is not None
        wanted = camera_of(config, number)
        same = wanted.address == address, wanted.serial == serial
        if all(same):
            return f"camera {number}"
        if any(same):
            return f"camera {number}? cell.toml says {wanted.serial} at {wanted.address}"
    return "-"


def _video_rows(config: CellConfig | None) -> list[Row]:
    """Devices of the kernel's video system that take pictures."""
    return [
        Row(path, serial, "-", model, "-", "-", "-", _cell(path, serial, config))
        for path, (model, serial) in cameras().items()
    ]


def _table(rows: Sequence[Row]) -> list[str]:
    lines = [HEAD, *rows]
    widths = [max(len(line[column]) for line in lines) for column in range(len(HEAD))]
    return ["  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip() for line in lines]
