"""What a GigE Vision camera tells of itself. It is only read, so another program may go on controlling it."""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress

from drivers.aravis import Device
from drivers.aravis_library import AravisError, LibraryMissing
from drivers.errors import LinkLost, NoAnswer, Unavailable
from drivers.worker import Worker

WITHIN_S = 8.0
CLOCK_RUNS_S = 0.005
Fact = str | int | float | bool | list[str]
READ: tuple[tuple[str, str, Callable[[Device, str], Fact]], ...] = (
    ("vendor", "DeviceVendorName", Device.text),
    ("model", "DeviceModelName", Device.text),
    ("version", "DeviceVersion", Device.text),
    ("user_name", "DeviceUserID", Device.text),
    ("temperature_c", "DeviceTemperature", Device.real),
    ("sensor_width_px", "SensorWidth", Device.integer),
    ("sensor_height_px", "SensorHeight", Device.integer),
    ("left_px", "OffsetX", Device.integer),
    ("top_px", "OffsetY", Device.integer),
    ("width_px", "Width", Device.integer),
    ("height_px", "Height", Device.integer),
    ("binning_horizontal", "BinningHorizontal", Device.integer),
    ("binning_vertical", "BinningVertical", Device.integer),
    ("pixel_format", "PixelFormat", Device.text),
    ("pixel_formats", "PixelFormat", Device.choices),
    ("exposure_us", "ExposureTime", Device.real),
    ("gain_db", "Gain", Device.real),
    ("trigger_mode", "TriggerMode", Device.text),
    ("trigger_sources", "TriggerSource", Device.choices),
    ("payload_bytes", "PayloadSize", Device.integer),
    ("packet_bytes", "GevSCPSPacketSize", Device.integer),
    ("packet_delay_ticks", "GevSCPD", Device.integer),
    ("ticks_per_s", "GevTimestampTickFrequency", Device.integer),
    ("heartbeat_ms", "GevHeartbeatTimeout", Device.integer),
)


async def facts(name: str, address: str) -> dict[str, Fact]:
    """All that this camera has of it, by name with unit. Raises LinkLost, NoAnswer, Unavailable."""
    worker = Worker(f"{name} facts", asyncio.get_running_loop())
    try:
        async with asyncio.timeout(WITHIN_S):
            return await worker.call(lambda: _facts(address))
    except TimeoutError:
        raise NoAnswer(name, f"{address} did not tell all within {WITHIN_S:g} s") from None
    except AravisError as error:
        raise LinkLost(name, f"{address}: {error}") from error
    except LibraryMissing as error:
        raise Unavailable(name, str(error)) from error
    finally:
        worker.finish()


def _facts(address: str) -> dict[str, Fact]:
    device = Device(address)
    try:
        told: dict[str, Fact] = {"address": address, "serial": device.serial(), "free": device.is_controller}
        if device.is_controller:
            told["clock"] = _clock(device)
        for key, feature, read in READ:
            if device.has(feature):
                with suppress(AravisError):  # it says that it has it, and does not give it: nothing is known then
                    told[key] = read(device, feature)
        return told
    finally:
        device.close()


def _clock(device: Device) -> str:
    """Only its controller may have it latched."""
    try:
        before = device.ticks()
        time.sleep(CLOCK_RUNS_S)
        return "runs" if device.ticks() != before else "none"
    except AravisError:
        return "none"
