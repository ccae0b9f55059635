"""Golden assemblies as figures: their spread within a pair and between pairs, and what is taught by them. Pure."""

import math
from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

from cellctl.assembly.views import Deviation
from cellctl.geometry import Pose, mean_pose, wrap_deg


class Golden(NamedTuple):
    """What one golden assembly gave."""

    pair: int  # from 1
    robot_from_base: Pose
    base_from_battery: Pose
    tool_from_battery: Pose
    second_edge: Deviation | None = None  # what the second looks gave, if there were any
    second_corner: Pose | None = None


class Spread(NamedTuple):
    """One sigma of the seat's place in the base."""

    x_mm: float
    y_mm: float
    t_deg: float

    @property
    def xy_mm(self) -> float:
        """Sigma per axis."""
        return math.sqrt((self.x_mm**2 + self.y_mm**2) / 2)

    def within(self, limit_mm: float, limit_deg: float) -> bool:
        """Whether it is small enough."""
        return self.xy_mm <= limit_mm and self.t_deg <= limit_deg

    @property
    def text(self) -> str:
        """For people."""
        return f"{self.xy_mm * 1000:.1f} um and {self.t_deg * 1000:.1f} mdeg (1 sigma)"


class Assemblies(NamedTuple):
    """All golden assemblies of one teaching; every pair was seated equally often."""

    samples: tuple[Golden, ...]

    @property
    def pairs(self) -> list[list[Golden]]:
        """The assemblies of each pair."""
        return [list(group) for _, group in groupby(self.samples, key=lambda sample: sample.pair)]

    @property
    def pair_means(self) -> list[Pose]:
        """base_from_battery of each pair."""
        return [mean_pose(sample.base_from_battery for sample in pair) for pair in self.pairs]

    @property
    def mean(self) -> Pose:
        """The taught base_from_battery."""
        return mean_pose(self.pair_means)

    @property
    def second_edge(self) -> Deviation | None:
        """Mean of all second looks at the base; None when there were none."""
        seen = [sample.second_edge for sample in self.samples if sample.second_edge is not None]
        return Deviation(*(sum(column) / len(seen) for column in zip(*seen, strict=True))) if seen else None

    @property
    def second_corner(self) -> Pose | None:
        """Mean of all second looks at the battery; None when there were none."""
        seen = [sample.second_corner for sample in self.samples if sample.second_corner is not None]
        return mean_pose(seen) if seen else None

    @property
    def repeat_spread(self) -> Spread:
        """Of one seating, within a pair; 0 when each pair was seated once."""
        off = [
            difference(sample.base_from_battery, mean)
            for pair, mean in zip(self.pairs, self.pair_means, strict=True)
            for sample in pair
        ]
        return _sigma(off, len(self.samples) - len(self.pairs))

    @property
    def pair_spread(self) -> Spread | None:
        """From pair to pair, the repeats' own scatter taken off; None with one pair."""
        means = self.pair_means
        if len(means) < 2:
            return None
        seen = _sigma([difference(mean, self.mean) for mean in means], len(means) - 1)
        noise, repeats = self.repeat_spread, len(self.samples) / len(means)
        x_mm, y_mm, t_deg = (
            math.sqrt(max(0.0, of_means**2 - of_repeats**2 / repeats))
            for of_means, of_repeats in zip(seen, noise, strict=True)
        )
        return Spread(x_mm, y_mm, t_deg)

    def table(self) -> list[str]:
        """Every assembly against the mean of all, then the spreads, for the person who seated them."""
        mean, between = self.mean, self.pair_spread
        rows = [f"{'pair':>4}{'repeat':>8}{'x um':>10}{'y um':>10}{'R mdeg':>10}   against the mean"]
        for number, pair in enumerate(self.pairs, 1):
            for repeat, sample in enumerate(pair, 1):
                rows.append(f"{number:>4}{repeat:>8}{_figures(difference(sample.base_from_battery, mean))}")
        rows.append(f"within a pair {_sigmas(self.repeat_spread)}   1 sigma of one seating")
        if between is None:
            return [*rows, "between pairs: not known, only one was taught"]
        for number, one in enumerate(self.pair_means, 1):
            rows.append(f"{number:>4}    mean{_figures(difference(one, mean))}")
        return [*rows, f"between pairs {_sigmas(between)}   1 sigma"]


def difference(one: Pose, other: Pose) -> Spread:
    """`one` minus `other`, for poses that lie close together."""
    return Spread(one.x_mm - other.x_mm, one.y_mm - other.y_mm, wrap_deg(one.t_deg - other.t_deg))


def _sigma(off: Sequence[Spread], freedom: int) -> Spread:
    if freedom < 1:
        return Spread(0.0, 0.0, 0.0)
    return Spread(*(math.sqrt(sum(value**2 for value in column) / freedom) for column in zip(*off, strict=True)))


def _figures(off: Spread) -> str:
    return f"{off.x_mm * 1000:>+10.1f}{off.y_mm * 1000:>+10.1f}{off.t_deg * 1000:>+10.1f}"


def _sigmas(spread: Spread) -> str:
    return f"{spread.x_mm * 1000:>8.1f}{spread.y_mm * 1000:>10.1f}{spread.t_deg * 1000:>10.1f}"
