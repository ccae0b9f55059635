"""What a V4L2 camera tells of itself. It is only asked, so another program may go on streaming from it."""

import asyncio
from contextlib import suppress
from pathlib import Path

from drivers import v4l2_abi as abi
from drivers.errors import DeviceError, Mismatch, NoAnswer
from drivers.v4l2_controls import Controls
from drivers.v4l2_node import KernelNode, asked, formats, meaning, serial_number
from drivers.worker import Worker

WITHIN_S = 5.0
Fact = str | int | float | bool | list[str]


async def facts(name: str, path: str) -> dict[str, Fact]:
    """All that this device has of it, by name with unit. Raises LinkLost, NoAnswer, Mismatch, Refused."""
    worker = Worker(f"{name} facts", asyncio.get_running_loop())
    try:
        async with asyncio.timeout(WITHIN_S):
            return await worker.call(lambda: read_facts(name, path))
    except TimeoutError:
        raise NoAnswer(name, f"{path} did not tell all within {WITHIN_S:g} s") from None
    except OSError as error:
        raise meaning(name, path, error) from error
    finally:
        worker.finish()


def read_facts(name: str, path: str) -> dict[str, Fact]:
    """The same, blocking; raises OSError, too."""
    node = KernelNode(path)
    try:
        found = abi.capability(asked(node, abi.QUERYCAP, abi.blank(abi.QUERYCAP)))
        told: dict[str, Fact] = {"address": path, "model": found.card, "serial": serial_number(path, found.bus)}
        told |= {"bus": found.bus, "driver": found.driver}
        if not found.captures:
            raise Mismatch(name, f"{path} ({found.card}) takes no pictures that can be streamed")
        now = abi.format_set(asked(node, abi.G_FMT, abi.ask_format(0, 0, "    ")))
        told |= {"width_px": now.width_px, "height_px": now.height_px, "pixel_format": now.fourcc.strip()}
        told["pixel_formats"] = [fourcc.strip() for fourcc in formats(node)]
        with suppress(OSError):  # not every device has a rate
            interval_s = abi.picture_interval_s(asked(node, abi.G_PARM, abi.ask_parameters()))
            told |= {"pictures_per_s": round(1 / interval_s, 3)} if interval_s else {}
        return told | _settings(Controls(name, node))
    finally:
        node.close()


def cameras() -> dict[str, tuple[str, str]]:
    """Model and serial number of every device node that takes pictures and may be opened, by its path."""
    found = {}
    for path in sorted(Path("/dev").glob("video*")):
        with suppress(OSError, DeviceError):  # an encoder, say, or another user's
            told = read_facts("", str(path))
            found[str(path)] = (str(told["model"]), str(told["serial"]))
    return found


def _settings(controls: Controls) -> dict[str, Fact]:
    told: dict[str, Fact] = {}
    with suppress(OSError):
        told |= {"exposure_us": controls.exposure_us()} if controls.exposure_us() else {}
    told["software_trigger"] = controls.has_software_trigger
    told["controls"] = [control.name for control in controls.all]
    return told
