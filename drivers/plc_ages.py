"""How old each value of a block of registers is: since it was read, and since it was last seen to change. Pure."""

from collections.abc import Sequence
from operator import ne


class Ages:
    """A block that is read again and again, always whole. Times in seconds of one clock that never jumps."""

    def __init__(self, count: int) -> None:
        self.words: Sequence[int] = [0] * count
        self.read_at_s = 0.0
        self.changed_at_s = [0.0] * count
        self._known = False

    def take(self, words: Sequence[int], at_s: float) -> None:
        """The block as it was asked for at that time."""
        before = self.words
        if not self._known:
            self.changed_at_s = [at_s] * len(words)
        elif words[1:] != before[1:]:
            for at, changed in enumerate(map(ne, words, before)):
                if changed:
                    self.changed_at_s[at] = at_s
        elif words[0] != before[0]:  # the heartbeat alone, most of the time
            self.changed_at_s[0] = at_s
        self.words, self.read_at_s, self._known = words, at_s, True

    def forget(self) -> None:
        """Nothing is known of what happened meanwhile: the next block counts as changed everywhere."""
        self._known = False
