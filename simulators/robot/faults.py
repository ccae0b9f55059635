"""What can be made to go wrong on the controller's line. Faults of the controller itself are its own."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

NG = re.compile(r"NG=(\d+)\.(\d+)")


@dataclass
class LineFaults:
    """How replies are spoilt. Counts go down with use; flags stay until they are switched off."""

    rng: np.random.Generator
    lost_end: int = 0  # so many ENDs are not sent
    ng_instead_of_end: list[str] = field(default_factory=list)  # codes, one per operation
    late_run_s: list[float] = field(default_factory=list)  # world seconds, one per operation
    garbage: int = 0  # so many replies have noise before them
    split_bytes: bool = False  # byte by byte
    coalesce: bool = False  # replies are held back and come together
    interleave: bool = False  # END waits for the next query and comes between its data and its OK
    padded_codes: bool = False  # NG=06.204
    almrst_ok: bool = False  # ALMRST is answered by OK
    mute: bool = False  # nothing is sent

    def set(self, fault: str, *, on: bool = True, count: int = 1, code: str = "17.910", by_s: float = 1.0) -> None:
        """Raises ValueError for what there is not."""
        if fault in ("split_bytes", "coalesce", "interleave", "padded_codes", "almrst_ok", "mute"):
            setattr(self, fault, on)
        elif fault in ("lost_end", "garbage"):
            setattr(self, fault, count)
        elif fault == "ng_instead_of_end":
            self.ng_instead_of_end += [code] * count
        elif fault == "late_run":
            self.late_run_s += [by_s] * count
        else:
            raise ValueError(f"the robot has no fault {fault!r}")

    def ending(self, ending: str) -> str | None:
        """How an operation really ends; None when that stays unsaid."""
        if ending != "END":
            return ending
        if self.lost_end:
            self.lost_end -= 1
            return None
        return f"NG={self.ng_instead_of_end.pop(0)}" if self.ng_instead_of_end else ending

    def spoilt(self, line: str) -> Iterator[bytes]:
        """The pieces in which this reply is written."""
        if self.mute:
            return
        found = NG.fullmatch(line) if self.padded_codes else None
        text = f"NG={int(found[1]):02}.{int(found[2]):03}" if found else line
        data = text.encode("latin-1") + b"\r\n"
        if self.garbage:
            self.garbage -= 1
            data = self.rng.integers(0x80, 0xFE, 12, dtype=np.uint8).tobytes() + b"\r\n" + data
        yield from (data[k : k + 1] for k in range(len(data))) if self.split_bytes else (data,)
