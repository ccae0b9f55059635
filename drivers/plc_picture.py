"""The newest picture of the PLC's registers, how old it is, and whether it may be believed."""

import time
from collections.abc import Sequence

from drivers.errors import DeviceError, Garbled, LinkLost, Mismatch, NoAnswer
from drivers.plc_ages import Ages
from drivers.plc_registers import MAP_VERSION, READ_COUNT, PlcImage, decode

DEVICE = "plc"
HEARTBEAT, HEARTBEAT_WITHIN_S = 0, 0.5  # its place among the PLC's words


class PlcPicture:
    """`session` is our own number; `down` is why there is no connection, None while there is one."""

    def __init__(self, session: int, stale_after_s: float, down: DeviceError) -> None:
        self.image: PlcImage | None = None
        self.ages = Ages(READ_COUNT)
        self.down: DeviceError | None = down
        self._session = session
        self._stale_after_s = stale_after_s

    def ours(self, image: PlcImage) -> bool:
        """Whether the PLC serves us."""
        return image.session == self._session

    def take(self, image: PlcImage, at_s: float) -> None:
        """What was asked for at that time of the monotonic clock."""
        self.ages.take(image.words, at_s)
        self.image = image

    def anew(self, image: PlcImage, at_s: float) -> None:
        """The first one of a connection: nothing is known of what happened meanwhile."""
        self.ages.forget()
        self.take(image, at_s)
        self.down = None

    @property
    def age_s(self) -> float:
        """Since the request for it was sent."""
        return time.monotonic() - self.ages.read_at_s

    @property
    def good(self) -> PlcImage:
        """The newest picture; raises the trouble that makes it worthless."""
        trouble = self.trouble()
        if trouble is not None:
            raise trouble.with_traceback(None)
        assert self.image is not None
        return self.image

    def trouble(self) -> DeviceError | None:
        """What makes the newest picture worthless, None when nothing does."""
        image = self.image
        if self.down is not None or image is None:
            return self.down or LinkLost(DEVICE, "nothing was read yet")
        if (age_s := self.age_s) > self._stale_after_s:
            limit = f"limit {self._stale_after_s * 1000:.0f} ms"
            return NoAnswer(DEVICE, f"newest picture is {age_s * 1000:.0f} ms old ({limit}); is run() alive?")
        stood_s = self.ages.read_at_s - self.ages.changed_at_s[HEARTBEAT]  # as pictures show, not since we last looked
        if stood_s > HEARTBEAT_WITHIN_S:
            beat = f"heartbeat (register 100) stands at {image.heartbeat} for {stood_s * 1000:.0f} ms"
            return NoAnswer(DEVICE, f"{beat}; put the PLC into RUN")
        return None if image.session == self._session else self._unserved(image)

    def _unserved(self, image: PlcImage) -> DeviceError:
        served = f"session served (register 102) is {image.session:#06x}, ours is {self._session:#06x}"
        if image.session == 0:
            return NoAnswer(DEVICE, f"{served}; look at the PLC program")
        return Mismatch(DEVICE, f"{served}; end the other client of the PLC and wait 1 s")


def read_picture(words: Sequence[int]) -> PlcImage:
    """Registers 100..131. Raises Garbled for a value without a meaning, Mismatch for another map."""
    found = PlcImage(words).map_version
    if found != MAP_VERSION:  # in another map nothing else means what it says
        text = f"map version (register 101) is {found:#06x}, needed is {MAP_VERSION:#06x}"
        raise Mismatch(DEVICE, f"{text}; load the PLC program of this cellctl")
    try:
        return decode(words)
    except ValueError as error:
        raise Garbled(DEVICE, f"{error}; load the PLC program of this cellctl") from None
