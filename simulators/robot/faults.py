"""What can be made to go wrong on the controller's line. Mishaps of the robot itself are in `mishaps`."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from simulators.robot.codes import Code

FLAGS = ("split_bytes", "apart", "coalesce", "interleave", "mute")
COUNTS = ("lost_end", "garbage", "cut", "double", "corrupt")
HELD_BACK_S = 0.05
NOISE_BYTES = 12


@dataclass
class LineFaults:
    """How replies are spoilt. Counts go down with use; flags stay until they are switched off."""

    rng: np.random.Generator
    now: Callable[[], float]
    code_of: Callable[[str], Code]
    lost_end: int = 0  # so many ends of operations are not said
    garbage: int = 0  # so many replies have noise before them
    cut: int = 0  # so many replies lack their line end
    double: int = 0  # so many replies come twice
    corrupt: int = 0  # so many replies have one bit wrong
    split_bytes: bool = False  # byte by byte
    apart: bool = False  # data and OK, which come as one, each by itself
    coalesce: bool = False  # replies are held back and come together
    interleave: bool = False  # an end waits for the next question and comes between its data and its OK
    mute: bool = False  # nothing is sent
    failures: list[Code] = field(default_factory=list)  # instead of an end, one per operation
    refusals: list[Code] = field(default_factory=list)  # instead of obeying, one per line
    late_run_s: list[float] = field(default_factory=list)  # world seconds, one per operation
    late_end_s: list[float] = field(default_factory=list)
    late_greeting_s: list[float] = field(default_factory=list)
    stalled_until_s: float = 0.0  # no byte passes

    def set(self, fault: str, *, on: bool = True, count: int = 1, code: str = "", by_s: float = 1.0) -> bool:
        """Switch a fault; False when there is none of this name. Raises ValueError for a code that there is not."""
        queues = {"late_run": self.late_run_s, "late_end": self.late_end_s, "late_greeting": self.late_greeting_s}
        if fault in FLAGS:
            setattr(self, fault, on)
        elif fault in COUNTS:
            setattr(self, fault, count)
        elif fault in ("ng_instead_of_end", "ng"):
            codes = self.failures if fault == "ng_instead_of_end" else self.refusals
            codes += [self.code_of(code or "17.910")] * count
        elif fault in queues:
            queues[fault] += [by_s] * count
        elif fault == "stall":
            self.stalled_until_s = self.now() + by_s
        else:
            return False
        return True

    def stalled_s(self) -> float:
        """How long no byte will pass."""
        return max(self.stalled_until_s - self.now(), 0.0)

    def holding_back_s(self) -> float:
        """How long replies are kept."""
        return max(self.stalled_s(), HELD_BACK_S if self.coalesce else 0.0)

    def spoilt(self, line: str) -> bytes:
        """This line as it is sent."""
        data = bytearray(line.encode("latin-1", "replace"))
        if data and _used(self, "corrupt"):
            data[int(self.rng.integers(len(data)))] ^= 1 << int(self.rng.integers(7))
        if not _used(self, "cut"):
            data += b"\r\n"
        if _used(self, "double"):
            data *= 2
        if _used(self, "garbage"):
            data[:0] = self.rng.integers(0x80, 0xFE, NOISE_BYTES, dtype=np.uint8).tobytes() + b"\r\n"
        return bytes(data)


def _used(faults: LineFaults, count: str) -> bool:
    """Whether one more of these is due."""
    left = getattr(faults, count)
    setattr(faults, count, max(left - 1, 0))
    return bool(left)


def taken(queue: list[float]) -> float:
    """The next delay of these, 0 when there is none."""
    return queue.pop(0) if queue else 0.0
