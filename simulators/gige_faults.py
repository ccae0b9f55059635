"""What can be wrong with a simulated camera, its cable and its link: one verb, `inject`."""

import inspect
from collections import Counter
from collections.abc import Callable

import numpy as np

from simulators.gvsp import Order

SHUFFLED = 8  # packets that a reordering network mixes


class Faults:
    """The faults in force. Every one is set by `inject`, which refuses what it does not know.

    | fault | parameters | effect |
    |---|---|---|
    | drop_ratio | ratio | payload packets lost at random on their first way |
    | drop_packets | packets, frames=1 | these packet numbers (0 is the leader) lost in the next frames |
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
    | mute | on=True | cable out: nothing is answered or sent |
    | clear | | all of the above end |
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.packets_dropped = 0
        self._verbs: dict[str, Callable[..., None]] = {
            "drop_ratio": self._drop_ratio,
            "drop_packets": self._drop_packets,
            "drop_resends": self._drop_resends,
            "duplicate": self._duplicate,
            "pending_ack": self._pending_ack,
            "stale_frame": self._stale_frame,
            "clear": self._clear,
        }
        self._switches = ("resend_unavailable", "reorder", "stuck_exposure", "mute")
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
        self.pending_ms = 0

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

    def on_their_way(self, order: Order) -> Order:
        """The packets of one picture that the network delivers, in the order it delivers them."""
        lost = self._rng.random(order.size) < self._drop
        if self.take("drop_packets"):
            lost |= np.isin(order, list(self._chosen))
        self.packets_dropped += int(np.count_nonzero(lost))
        order = order[~lost]
        if self.on("reorder"):
            order = order[np.argsort(np.arange(order.size) + self._rng.random(order.size) * SHUFFLED)]
        return np.repeat(order, 1 + (self._rng.random(order.size) < self._double))

    def resent(self, order: Order) -> Order:
        """The packets, sent again, that the network delivers."""
        return order[self._rng.random(order.size) >= self._resend_drop]


def _ratio(value: float) -> float:
    if not 0 <= value <= 1:
        raise ValueError(f"a ratio is between 0 and 1 (got {value})")
    return value
