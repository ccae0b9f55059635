"""The thread that waits for a GigE Vision camera's pictures, judges them, and hands them to the event loop."""

import threading
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from drivers.aravis import Arrived, Device, Memory, Stream
from drivers.camera import Counters, Pixels, Setup
from drivers.gige_setup import Payload
from drivers.pixels import PixelError, eight_bit

POLL_S = 0.05
LENT_BUFFERS = 4


class Received(NamedTuple):
    """A picture as it came. `pixels` is None when `flaw` says why it cannot be used."""

    frame_id: int
    device_ns: int  # 0: not known, of an incomplete one
    received_ns: int
    flaw: str
    pixels: Pixels | None
    payload: Pixels
    exposure: tuple[float, float] | None  # us and dB, where the camera sends them along


Reports = tuple[Callable[[Received], None], Callable[[], None]]
"""What is called in the receive thread when a picture came, and when the control is lost."""


class Receiver:
    """From the opening of the stream to its end."""

    def __init__(self, device: Device, setup: Setup, payload: Payload, stream: Stream, reports: Reports) -> None:
        self._device, self._setup, self._payload, self._stream = device, setup, payload, stream
        self._came, self._lost = reports
        self._image_bytes = setup.pixel_format.bytes_for(setup.region.width_px, setup.region.height_px)
        self.packets = Counters()  # sent again on request, and missing for good
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        for _ in range(LENT_BUFFERS):
            stream.push(self._memory())

    def start(self, name: str) -> None:
        """Begin to wait."""
        self._thread = threading.Thread(target=self._receive, name=name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Return when the thread has ended and the stream is closed."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        self._stream.close()

    def _memory(self) -> Memory:
        """Room for one picture, with its pages mapped, so that receiving is not held up by that."""
        memory = np.empty(self._payload.size_bytes, np.uint8)
        memory.fill(0)
        return memory

    def _receive(self) -> None:
        """Hand over what comes, lend new memory, look after the control."""
        while not self._stop.is_set():
            arrived = self._stream.pop(POLL_S)
            if arrived is not None:
                received_ns = time.monotonic_ns()
                self._stream.push(self._memory())
                self._count_packets()
                self._came(self._judged(arrived, received_ns))
            elif not self._device.is_controller:
                return self._lost()

    def _count_packets(self) -> None:
        resent, missing = (self._stream.count(name) for name in ("n_resent_packets", "n_missing_packets"))
        self.packets = Counters(packets_resent=resent, packets_missing=missing)

    def _judged(self, arrived: Arrived, received_ns: int) -> Received:
        """Nobody looks at pixels before the size is found to be right."""
        flaw, pixels, payload = self._flaw(arrived), None, arrived.memory[: self._image_bytes]
        payload.flags.writeable = False
        if not flaw:
            region, pixel_format = self._setup.region, self._setup.pixel_format
            try:
                pixels = eight_bit(payload, pixel_format, region.width_px, region.height_px)
                pixels.flags.writeable = False
            except PixelError as error:
                flaw = f"picture {arrived.frame_id} {error}"
        return Received(arrived.frame_id, arrived.device_ns, received_ns, flaw, pixels, payload, arrived.exposure)

    def _flaw(self, arrived: Arrived) -> str:
        """Why a picture cannot be used, or nothing."""
        number, room = arrived.frame_id, arrived.memory.nbytes
        if arrived.status != "success":
            missing, asked = self.packets.packets_missing, self._stream.count("n_resend_requests")
            return (
                f"picture {number} came incomplete: {arrived.status}, {arrived.received_bytes} of {room} bytes "
                f"(since armed: {missing} packets missing, {asked} asked for again)"
            )
        region, pixel_format = self._setup.region, self._setup.pixel_format
        wanted = (region.width_px, region.height_px, pixel_format.code, room)
        size = (arrived.width, arrived.height, arrived.pixel_format, arrived.received_bytes)
        if size == wanted:
            unsaid = self._payload.with_chunks and arrived.exposure is None
            return f"picture {number} came without the exposure time and gain that belong to it" if unsaid else ""
        return (
            f"picture {number} is {size[0]} x {size[1]} px, format {size[2]:#x}, {size[3]} bytes, "
            f"not {wanted[0]} x {wanted[1]} {pixel_format.name} of {room} bytes"
        )
