"""The simulated camera's registers, and the GenICam description that tells a client where they are.

One table holds each register's address, range and start value; the XML text and the server's range checks are both
made from it. The names are those of the GenICam Standard Features Naming Convention. The XML is served zipped, as
real cameras do.
"""

import io
import zipfile
from typing import NamedTuple

from simulators import genicam_chunks

MONO8 = 0x01080001
PIXEL_FORMATS = {  # codes of the GigE Vision standard and of PFNC
    "Mono8": MONO8,
    "Mono10": 0x01100003,
    "Mono10Packed": 0x010C0004,
    "Mono10p": 0x010A0046,
    "Mono12": 0x01100005,
    "Mono12Packed": 0x010C0006,
    "Mono12p": 0x010C0047,
    "Mono16": 0x01100007,
}
BITS_PER_PIXEL = 16  # where a format's code says how many bits a pixel takes
XML_ADDRESS = 0x80000
XML_NAME = "cellctl_camera"
WIDTH_STEP_PX = 4
HEIGHT_STEP_PX = 2
SMALLEST_WIDTH_PX = 16
SMALLEST_HEIGHT_PX = 2
SMALLEST_PACKET = 220

# Bootstrap registers of the GigE Vision standard.
VERSION, DEVICE_MODE, MAC_HIGH, MAC_LOW = 0x0000, 0x0004, 0x0008, 0x000C
IP_CAPABILITY, IP_IN_USE, CURRENT_IP, CURRENT_MASK = 0x0010, 0x0014, 0x0024, 0x0034
VENDOR, MODEL, DEVICE_VERSION, MAKER_INFO, SERIAL, USER_NAME = 0x0048, 0x0068, 0x0088, 0x00A8, 0x00D8, 0x00E8
DISCOVERY_END = 0x00F8
XML_URL = 0x0200
INTERFACE_COUNT, CHANNEL_COUNT, CAPABILITY = 0x0600, 0x0904, 0x0934
HEARTBEAT_MS, TICK_RATE_HIGH, TICK_RATE_LOW = 0x0938, 0x093C, 0x0940
TIMESTAMP_CONTROL, TIMESTAMP_HIGH, TIMESTAMP_LOW = 0x0944, 0x0948, 0x094C
ACTION_COUNT, ACTION_DEVICE_KEY, ACTION_GROUP_KEY, ACTION_GROUP_MASK = 0x0908, 0x090C, 0x9800, 0x9804
SWITCHOVER_KEY, CONTROL_PRIVILEGE, CONTROLLER_PORT, CONTROLLER_IP = 0x095C, 0x0A00, 0x0A04, 0x0A14
STREAM_PORT, STREAM_PACKET, STREAM_DELAY, STREAM_ADDRESS, STREAM_SOURCE_PORT = 0x0D00, 0x0D04, 0x0D08, 0x0D18, 0x0D1C
TIMESTAMP_LATCH_BIT = 0x2
TICKS_PER_S = 1_000_000_000


class Register(NamedTuple):
    """One 32-bit register. `locked`: not to be written while pictures are being taken; `only`: what it may be."""

    address: int
    start: int = 0
    low: int = 0
    high: int = 0xFFFFFFFF
    step: int = 1
    writable: bool = True
    locked: bool = False
    only: frozenset[int] | None = None


def registers(sensor: tuple[int, int], largest_packet: int) -> dict[str, Register]:
    """All registers of a camera with a sensor of (width, height) px, by feature name."""
    width, height = sensor
    return {
        "Width": Register(0x10000, width, SMALLEST_WIDTH_PX, width, WIDTH_STEP_PX, locked=True),
        "Height": Register(0x10004, height, SMALLEST_HEIGHT_PX, height, HEIGHT_STEP_PX, locked=True),
        "OffsetX": Register(0x10008, 0, 0, width - SMALLEST_WIDTH_PX, WIDTH_STEP_PX),
        "OffsetY": Register(0x1000C, 0, 0, height - SMALLEST_HEIGHT_PX, HEIGHT_STEP_PX),
        "PixelFormat": Register(0x10010, MONO8, locked=True, only=frozenset(PIXEL_FORMATS.values())),
        "BinningHorizontal": Register(0x10014, 1, 1, 1, locked=True),
        "BinningVertical": Register(0x10018, 1, 1, 1, locked=True),
        "ReverseX": Register(0x1001C, 0, 0, 1, locked=True),
        "ReverseY": Register(0x10034, 0, 0, 1, locked=True),
        "AcquisitionMode": Register(0x10020, 0, 0, 0),
        "AcquisitionStart": Register(0x10024, 0, 0, 1),
        "AcquisitionStop": Register(0x10028, 0, 0, 1),
        "AcquisitionFrameRateEnable": Register(0x1002C, 0, 0, 1),
        "FramePeriodUs": Register(0x10030, 100_000, 5_000, 10_000_000),
        "TriggerSelector": Register(0x10040, 0, 0, 0),
        "TriggerMode": Register(0x10044, 0, 0, 1),
        "TriggerSource": Register(0x10048, 0, 0, 2),
        "TriggerActivation": Register(0x1004C, 0, 0, 0),
        "TriggerSoftware": Register(0x10050, 0, 0, 1),
        "ExposureNs": Register(0x10060, 1_000_000, 10_000, 1_000_000_000),
        "ExposureAuto": Register(0x10064, 0, 0, 0),
        "GainMillidB": Register(0x10070, 0, 0, 24_000),
        "GainAuto": Register(0x10074, 0, 0, 0),
        "BlackLevel": Register(0x10078, 0, 0, 255),
        "SensorWidth": Register(0x10080, width, writable=False),
        "SensorHeight": Register(0x10084, height, writable=False),
        "PayloadSize": Register(0x10088, width * height, writable=False),
        "ChunkModeActive": Register(0x10094, 0, 0, 1, locked=True),
        "ChunkSelector": Register(0x10098, 0, 0, 1),
        "ChunkEnable": Register(0x1009C, 1, 1, 1),
        "TestPattern": Register(0x100A0, 0, 0, 4),
        "TemperatureMillideg": Register(0x10090, 41_500, 0, 100_000, writable=False),
        "GevHeartbeatTimeout": Register(HEARTBEAT_MS, 3_000, 500, 600_000),
        "GevTimestampControl": Register(TIMESTAMP_CONTROL),
        "GevTimestampHigh": Register(TIMESTAMP_HIGH, writable=False),
        "GevTimestampLow": Register(TIMESTAMP_LOW, writable=False),
        "ActionDeviceKey": Register(ACTION_DEVICE_KEY),
        "ActionGroupKey": Register(ACTION_GROUP_KEY),
        "ActionGroupMask": Register(ACTION_GROUP_MASK),
        "GevPrimaryApplicationSwitchoverKey": Register(SWITCHOVER_KEY, 0, 0, 0xFFFF),
        "GevPrimaryApplicationSocket": Register(CONTROLLER_PORT, writable=False),
        "GevPrimaryApplicationIPAddress": Register(CONTROLLER_IP, writable=False),
        "GevCCP": Register(CONTROL_PRIVILEGE, 0, 0, 0xFFFFFFFF),
        "GevSCPHostPort": Register(STREAM_PORT, 0, 0, 0xFFFFFFFF),
        "GevSCPS": Register(STREAM_PACKET, 1500, SMALLEST_PACKET, largest_packet, 4),
        "GevSCPD": Register(STREAM_DELAY, 0, 0, 1_000_000),
        "GevSCDA": Register(STREAM_ADDRESS),
    }


CATEGORIES = {
    "DeviceControl": (
        "DeviceVendorName DeviceModelName DeviceManufacturerInfo DeviceVersion DeviceID DeviceSerialNumber "
        "DeviceUserID DeviceTemperature"
    ),
    "ImageFormatControl": (
        "SensorWidth SensorHeight WidthMax HeightMax Width Height OffsetX OffsetY PixelFormat "
        "BinningHorizontal BinningVertical ReverseX ReverseY TestPattern"
    ),
    "AcquisitionControl": (
        "AcquisitionMode AcquisitionStart AcquisitionStop AcquisitionFrameRateEnable AcquisitionFrameRate "
        "TriggerSelector TriggerMode TriggerSource TriggerActivation TriggerSoftware ExposureTime ExposureAuto"
    ),
    "AnalogControl": "Gain GainAuto BlackLevel",
    "ChunkDataControl": "ChunkModeActive ChunkSelector ChunkEnable ChunkExposureTime ChunkGain",
    "ActionControl": "ActionDeviceKey ActionGroupKey ActionGroupMask",
    "TransportLayerControl": (
        "PayloadSize GevSCPSPacketSize GevSCPSFireTestPacket GevSCPD GevHeartbeatTimeout "
        "GevTimestampTickFrequency GevTimestampControlLatch GevTimestampValue"
    ),
}
TEXTS = {
    "DeviceVendorName": (VENDOR, 32, "RO"),
    "DeviceModelName": (MODEL, 32, "RO"),
    "DeviceVersion": (DEVICE_VERSION, 32, "RO"),
    "DeviceManufacturerInfo": (MAKER_INFO, 48, "RO"),
    "DeviceID": (SERIAL, 16, "RO"),
    "DeviceSerialNumber": (SERIAL, 16, "RO"),
    "DeviceUserID": (USER_NAME, 16, "RW"),
}
CHOICES = {
    "PixelFormat": PIXEL_FORMATS,
    "AcquisitionMode": {"Continuous": 0},
    "TriggerSelector": {"FrameStart": 0},
    "TriggerMode": {"Off": 0, "On": 1},
    "TriggerSource": {"Software": 0, "Line0": 1, "Action1": 2},
    "TriggerActivation": {"RisingEdge": 0},
    "TestPattern": {"Off": 0, "Black": 1, "White": 2, "GreyHorizontalRamp": 3, "GreyHorizontalRampMoving": 4},
    "ChunkSelector": {"ExposureTime": 0, "Gain": 1},
    "ExposureAuto": {"Off": 0},
    "GainAuto": {"Off": 0},
}
COMMANDS = {"AcquisitionStart": 1, "AcquisitionStop": 1, "TriggerSoftware": 1}
INTEGERS = (
    "SensorWidth",
    "SensorHeight",
    "Width",
    "Height",
    "OffsetX",
    "OffsetY",
    "PayloadSize",
    "BlackLevel",
    "BinningHorizontal",
    "BinningVertical",
)
SWITCHES = ("AcquisitionFrameRateEnable", "ReverseX", "ReverseY", "ChunkModeActive", "ChunkEnable")
TRANSPORT_INTEGERS = ("GevSCPD", "GevHeartbeatTimeout", "ActionDeviceKey", "ActionGroupKey", "ActionGroupMask")


def _tag(kind: str, name: str, **parts: object) -> str:
    body = "".join(f"<{part}>{value}</{part}>" for part, value in parts.items())
    return f'<{kind} Name="{name}" NameSpace="Standard">{body}</{kind}>'


def _register(name: str, address: int, access: str, length: int = 4) -> str:
    return _tag(
        "IntReg",
        f"{name}Reg",
        Address=hex(address),
        Length=length,
        AccessMode=access,
        pPort="Device",
        Cachable="NoCache",
        Sign="Unsigned",
        Endianess="BigEndian",
    )


def _integer(name: str, register: Register) -> str:
    lock = {"pIsLocked": "TLParamsLocked"} if register.locked else {}
    access = "RW" if register.writable else "RO"
    limits = {"Min": register.low, "Max": register.high, "Inc": register.step}
    return _tag("Integer", name, **lock, pValue=f"{name}Reg", **limits) + _register(name, register.address, access)


def _choice(name: str, register: Register) -> str:
    lock = "<pIsLocked>TLParamsLocked</pIsLocked>" if register.locked else ""
    entries = "".join(_tag("EnumEntry", entry, Value=value) for entry, value in CHOICES[name].items())
    head = f'<Enumeration Name="{name}" NameSpace="Standard">{lock}{entries}<pValue>{name}Reg</pValue></Enumeration>'
    return head + _register(name, register.address, "RW")


def _command(name: str, address: int, value: int) -> str:
    return _tag("Command", name, pValue=f"{name}Reg", CommandValue=value) + _register(name, address, "RW")


def _real(name: str, register: Register, unit: str, to_raw: str, from_raw: str) -> str:
    """A float feature whose register counts in other steps; the formulas are GenICam's, FROM and TO their words."""
    ends = sorted(_ends(register, from_raw))
    converter = _tag(
        "Converter",
        f"{name}Conv",
        FormulaTo=to_raw,
        FormulaFrom=from_raw,
        pValue=f"{name}Reg",
        Slope="Increasing" if from_raw.startswith("TO") else "Decreasing",
    )
    feature = _tag("Float", name, pValue=f"{name}Conv", Min=ends[0], Max=ends[1], Unit=unit)
    return feature + converter + _register(name, register.address, "RW" if register.writable else "RO")


def _ends(register: Register, from_raw: str) -> tuple[float, float]:
    """The feature's values at both ends of the register: the formula is `TO / k` or `k / TO`."""
    left, right = from_raw.split(" / ")
    if left == "TO":
        return register.low / float(right), register.high / float(right)
    return float(left) / register.low, float(left) / register.high


def _bits(name: str, address: int, **where: int) -> str:
    return _tag(
        "MaskedIntReg",
        f"{name}Reg",
        Address=hex(address),
        Length=4,
        AccessMode="RW",
        pPort="Device",
        Cachable="NoCache",
        **where,
        Sign="Unsigned",
        Endianess="BigEndian",
    )


def _transport(table: dict[str, Register]) -> list[str]:
    packet = table["GevSCPS"]
    size = {"Min": packet.low, "Max": packet.high, "Inc": packet.step}
    return [
        _tag("Integer", "GevSCPSPacketSize", pValue="GevSCPSPacketSizeReg", **size),
        _bits("GevSCPSPacketSize", STREAM_PACKET, LSB=31, MSB=16),
        _tag("Command", "GevSCPSFireTestPacket", pValue="GevSCPSFireTestPacketReg", CommandValue=1),
        _bits("GevSCPSFireTestPacket", STREAM_PACKET, Bit=0),
        _tag("Integer", "GevTimestampTickFrequency", pValue="GevTimestampTickFrequencyReg"),
        _register("GevTimestampTickFrequency", TICK_RATE_HIGH, "RO", 8),
        _command("GevTimestampControlLatch", TIMESTAMP_CONTROL, TIMESTAMP_LATCH_BIT),
        _tag("Integer", "GevTimestampValue", pValue="GevTimestampValueReg"),
        _register("GevTimestampValue", TIMESTAMP_HIGH, "RO", 8),
    ]


def _features(table: dict[str, Register], sensor: tuple[int, int]) -> list[str]:
    text = {"pPort": "Device"}
    return [
        *(
            _tag("StringReg", name, Address=hex(at), Length=length, AccessMode=access, **text)
            for name, (at, length, access) in TEXTS.items()
        ),
        _tag("Integer", "TLParamsLocked", Visibility="Invisible", Value=0, Min=0, Max=1),
        _tag("Integer", "WidthMax", Value=sensor[0]),
        _tag("Integer", "HeightMax", Value=sensor[1]),
        *(_integer(name, table[name]) for name in INTEGERS + TRANSPORT_INTEGERS),
        *(_choice(name, table[name]) for name in CHOICES),
        *(_command(name, table[name].address, value) for name, value in COMMANDS.items()),
        *(_tag("Boolean", name, pValue=f"{name}Reg") for name in SWITCHES),
        *(_register(name, table[name].address, "RW") for name in SWITCHES),
        *genicam_chunks.features(),
        _real("AcquisitionFrameRate", table["FramePeriodUs"], "Hz", "1000000 / FROM", "1000000 / TO"),
        _real("ExposureTime", table["ExposureNs"], "us", "FROM * 1000", "TO / 1000"),
        _real("Gain", table["GainMillidB"], "dB", "FROM * 1000", "TO / 1000"),
        _real("DeviceTemperature", table["TemperatureMillideg"], "C", "FROM * 1000", "TO / 1000"),
    ]


def description(table: dict[str, Register], sensor: tuple[int, int]) -> bytes:
    """The GenICam XML of a camera with these registers."""
    groups = "".join(
        f'<Category Name="{name}" NameSpace="Standard">'
        + "".join(f"<pFeature>{feature}</pFeature>" for feature in features.split())
        + "</Category>"
        for name, features in {"Root": " ".join(CATEGORIES), **CATEGORIES}.items()
    )
    head = (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<RegisterDescription ModelName="CellSim" VendorName="Cellctl" ToolTip="Simulated camera" '
        'StandardNameSpace="GEV" SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" '
        'MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        'ProductGuid="0d1f7a52-2f1c-4f0e-9a5a-3b1f2c9c1e01" VersionGuid="0d1f7a52-2f1c-4f0e-9a5a-3b1f2c9c1e02" '
        'xmlns="http://www.genicam.org/GenApi/Version_1_1">\n'
    )
    port = '<Port Name="Device" NameSpace="Standard"><SwapEndianess>No</SwapEndianess></Port>'
    body = "\n".join([groups, *_features(table, sensor), *_transport(table), port])
    return f"{head}{body}\n</RegisterDescription>\n".encode()


def zipped(xml: bytes) -> bytes:
    """The description as the one file of a zip archive."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(f"{XML_NAME}.xml", xml)
    return archive.getvalue()
