"""What a robot's controller tells of itself: for whoever connects it, and for whoever has to mend it."""

import json
from collections.abc import Awaitable
from typing import Any

import click

from cellctl.desk.commands import run_loop
from cellctl.desk.robot_link import AtDesk, Which, at_desk
from drivers.errors import Refused
from drivers.rcx import parse_failure
from drivers.reach import SIDES

UNSAID = "does not say"
SHOWN_ALARMS = 10

Facts = dict[str, dict[str, Any]]


def info(which: Which, *, as_json: bool) -> int:
    """Print it; always 0. Raises ClickException, SettingsError, DeviceError."""
    facts = run_loop(_told(which))
    click.echo(json.dumps(facts) if as_json else _text(facts))
    return 0


async def _told(which: Which) -> Facts:
    async with at_desk(which) as desk:
        return await _facts(desk)


async def _facts(desk: AtDesk) -> Facts:
    robot = desk.robot
    identity = await robot.identity()
    return {
        "controller": {
            "address": desk.address,
            "dialect": robot.dialect.name,
            "version": identity.version or UNSAID,
            "configuration": identity.configuration or UNSAID,
            "serial": desk.serial or "the protocol knows none; cell.toml names the arm's",
        },
        "state": await _state(desk),
        "position": await _position(desk),
        "limits": _limits(desk),
        "settings": _settings(await _lines(robot.files.read("PRM"))),
        "memory": await _memory(desk),
        "alarms": await _alarms(desk),
    }


async def _state(desk: AtDesk) -> dict[str, Any]:
    status = await desk.robot.status()
    return {
        "mode": status.mode.value,
        "emergency stop": "pressed" if status.emergency_stop else "released",
        "alarm": f"{status.alarm} {status.alarm_means}".strip() or "none",
        "motor power": _on(status.motor_on),
        "servo": _on(status.servo_on),
        "origin": "complete" if status.origin_done else "incomplete",
        "ready": status.why_not_ready or "yes",
    }


async def _position(desk: AtDesk) -> dict[str, Any]:
    position = await desk.robot.posture()
    names = ("x_mm", "y_mm", "z_mm", "r_deg")
    pulses = await desk.robot.points.here()
    return {
        **dict(zip(names, position.point, strict=True)),
        "hand": SIDES[position.hand],
        "pulses": " ".join(map(str, pulses)),
    }


def _limits(desk: AtDesk) -> dict[str, Any]:
    """Ours, which every target is checked against before anything is sent."""
    limits = desk.robot.limits
    return {
        "reach_mm": f"{limits.inner_reach_mm:g} .. {limits.outer_reach_mm:g}",
        "z_mm": f"{limits.z_min_mm:g} .. {limits.z_max_mm:g}",
        "r_deg": f"{limits.r_min_deg:g} .. {limits.r_max_deg:g}",
        "arms_mm": f"{limits.arm_1_mm:g} + {limits.arm_2_mm:g}",
    }


async def _memory(desk: AtDesk) -> dict[str, Any]:
    files = desk.robot.files
    kinds = {"points": "PNT", "hands": "HND", "shifts": "SFT", "pallets": "PLT", "variables": "VAR", "programs": "DIR"}
    return {name: len(await _lines(files.read(kind))) for name, kind in kinds.items()}


async def _alarms(desk: AtDesk) -> dict[str, Any]:
    """The latest of the controller's log, the newest first, with what their codes mean."""
    latest = (await _lines(desk.robot.files.read("LOG")))[-SHOWN_ALARMS:]
    return {str(number): _explained(desk, line) for number, line in enumerate(reversed(latest), 1)}


def _explained(desk: AtDesk, line: str) -> str:
    """An entry of the log ends with its code."""
    code = parse_failure(line.rpartition(",")[2])
    return line if code is None else f"{line}  {desk.robot.dialect.meaning(code)}"


async def _lines(read: Awaitable[list[str]]) -> list[str]:
    """A file of the controller; none when this controller does not have it."""
    try:
        return await read
    except Refused:
        return []


def _settings(lines: list[str]) -> dict[str, str]:
    """By name; what an axis has of its own, as ACCEL(1)=100, in the order of the axes."""
    found: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition("=")
        name = name.partition("(")[0].strip()
        found[name] = f"{found.get(name, '')} {value.strip()}".strip()
    return found


def _on(is_on: bool) -> str:
    return "on" if is_on else "off"


def _text(facts: Facts) -> str:
    lines: list[str] = []
    for section, entries in facts.items():
        lines += [f"{section}" if not lines else f"\n{section}"]
        lines += [f"  {name:<16}{_shown(value)}" for name, value in entries.items()] or ["  none"]
    return "\n".join(lines)


def _shown(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
