"""What can be wrong with a simulated camera, its cable and its link: one verb, `inject`."""

import inspect
import time
from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simulators.gvsp import Order

SHUFFLED = 8  # packets that a reordering network mixes
LONGEST_AWAY_S = 60.0


class Faults:
    """The faults in force. Every one is set by `inject`, which refuses what it does not know.

    | fault | parameters | effect |
    |---|---|---|
    | drop_ratio | ratio | payload packets lost at random on their first way |
    | drop_packets | packets, frames=1 | these packet numbers (0 is the leader) lost in the next frames |
    | mtu | size_bytes=0 | packets larger than this are lost, test packets too; 0 ends it |
    | link | mbps=0 | the link has this rate, packets evenly spread; 0: a gigabit's time, in one burst |
    | resend_limit | packets | no more packets of a picture are sent again than these; 0 ends it |
    | drop_resends | ratio | packets that are sent again, lost at random |
    | resend_unavailable | on=True | a request to send again is answered "packet unavailable" |
    | reorder | on=True | packets overtake each other |
    | duplicate | ratio | packets arrive twice |
    | lost_acks | count=1 | the next answers of the control channel are lost |
    | pending_ack | delay_ms | every control answer is announced as pending and comes later; 0 ends it |
    | ignore_trigger | count=1 | the next triggers have no effect |
    | stale_frame | count=1, alone=False | the previous picture is sent again, before the true one or instead of it |
    | wrong_size | count=1 | the next pictures have fewer lines than set |
    | stuck_exposure | on=True | a new exposure time is acknowledged and not taken |
    | refuse_control | on=True | nobody is given control |
    | other_controller | | another program takes control and keeps it |
    | release_control | | whoever has control loses it |
    | reboot | for_s=1.0 | silent for so long (wall time), then as after power-on; its clock begins anew |
    | clock_stands | on=True | reading the camera's clock gives the same time for ever |
    | mute | on=True | cable out: nothing is answered or sent |
    | clear | | all of the above end, but for who has control |
    """

    def __init__(self, rng: np.random.Generator, of_device: dict[str, Callable[..., None]] | None = None) -> None:
        self._rng = rng
        self.packets_dropped = 0
        self._verbs: dict[str, Callable[..., None]] = {
            "drop_ratio": self._drop_ratio,
            "drop_packets": self._drop_packets,
            "drop_resends": self._drop_resends,
            "duplicate": self._duplicate,
            "pending_ack": self._pending_ack,
            "stale_frame": self._stale_frame,
            "mtu": self._mtu,
            "link": self._link,
            "resend_limit": self._resend_limit,
            "clear": self._clear,
            **(of_device or {}),
        }
        self._switches = ("resend_unavailable", "reorder", "stuck_exposure", "clock_stands", "refuse_control", "mute")
        self._counted = ("lost_acks", "ignore_trigger", "wrong_size")
        self._clear()

    def inject(self, fault: str, **params: object) -> None:
        """Put a fault in force; raises ValueError for an unknown fault or parameter."""
        verb = self._verb(fault)
        try:
            inspect.signature(verb).bind(**params)
        except TypeError as error:
            raise ValueError(f"camera fault {fault!r}: {error}") from error
        verb(**params)

    def _verb(self, fault: str) -> Callable[..., None]:
        if fault in self._switches:
            return lambda on=True: self._switch(fault, on)
        if fault in self._counted:
            return lambda count=1: self._count(fault, count)
        if fault not in self._verbs:
            known = ", ".join(sorted([*self._verbs, *self._switches, *self._counted]))
            raise ValueError(f"a camera has no fault {fault!r}; it has {known}")
        return self._verbs[fault]

    def _clear(self) -> None:
        self._left: Counter[str] = Counter()
        self._on: set[str] = set()
        self._drop = self._resend_drop = self._double = 0.0
        self._chosen: frozenset[int] = frozenset()
        self._stale_alone = False
        self.pending_ms = self.mtu_bytes = self.most_resends = 0
        self.link_mbps = 0.0
        self._back_s = 0.0

    def _switch(self, fault: str, on: bool) -> None:
        self._on = self._on | {fault} if on else self._on - {fault}

    def _count(self, fault: str, count: int) -> None:
        self._left[fault] = count

    def _drop_ratio(self, ratio: float) -> None:
        self._drop = _ratio(ratio)

    def _drop_packets(self, packets: list[int], frames: int = 1) -> None:
        self._chosen = frozenset(packets)
        self._left["drop_packets"] = frames

    def _drop_resends(self, ratio: float) -> None:
        self._resend_drop = _ratio(ratio)

    def _duplicate(self, ratio: float) -> None:
        self._double = _ratio(ratio)

    def _pending_ack(self, delay_ms: int) -> None:
        self.pending_ms = delay_ms

    def _stale_frame(self, count: int = 1, alone: bool = False) -> None:
        self._left["stale_frame"] = count
        self._stale_alone = alone

    def _mtu(self, size_bytes: int = 0) -> None:
        self.mtu_bytes = size_bytes

    def _link(self, mbps: float = 0.0) -> None:
        self.link_mbps = mbps

    def _resend_limit(self, packets: int) -> None:
        self.most_resends = packets

    def stay_away(self, for_s: float) -> None:
        """Silent for so long, in wall time."""
        if not 0 <= for_s <= LONGEST_AWAY_S:
            raise ValueError(f"a camera boots in 0 to {LONGEST_AWAY_S} s (got {for_s})")
        self._back_s = time.monotonic() + for_s

    @property
    def silent(self) -> bool:
        """Is nothing heard of the camera now?"""
        return self.on("mute") or time.monotonic() < self._back_s

    def on(self, fault: str) -> bool:
        """Is this switch set?"""
        return fault in self._on

    def take(self, fault: str) -> bool:
        """True so many times as the fault was injected for."""
        if self._left[fault] <= 0:
            return False
        self._left[fault] -= 1
        return True

    def stale(self) -> tuple[bool, bool]:
        """(send the previous picture now, send the true one too)."""
        stale = self.take("stale_frame")
        return stale, not (stale and self._stale_alone)

    def on_their_way(self, order: Order, sizes: Order) -> Order:
        """The packets (of these sizes, in bytes) that the network delivers, in the order it delivers them."""
        lost = (self._rng.random(order.size) < self._drop) | self._too_large(sizes)
        if self.take("drop_packets"):
            lost |= np.isin(order, list(self._chosen))
        self.packets_dropped += int(np.count_nonzero(lost))
        order = order[~lost]
        if self.on("reorder"):
            order = order[np.argsort(np.arange(order.size) + self._rng.random(order.size) * SHUFFLED)]
        return np.repeat(order, 1 + (self._rng.random(order.size) < self._double))

    def resent(self, order: Order, sizes: Order) -> Order:
        """The packets, sent again, that the network delivers."""
        return order[(self._rng.random(order.size) >= self._resend_drop) & ~self._too_large(sizes)]

    def _too_large(self, sizes: Order) -> NDArray[np.bool_]:
        return sizes > self.mtu_bytes if self.mtu_bytes else np.zeros(sizes.size, np.bool_)


def _ratio(value: float) -> float:
    if not 0 <= value <= 1:
        raise ValueError(f"a ratio is between 0 and 1 (got {value})")
    return value
