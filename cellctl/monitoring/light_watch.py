"""Follows focus and light of both cameras through production, and warns before measurements suffer.

All that is known is kept in every unit's record, so it survives a restart; it begins anew with every golden assembly
and with every change of the recipe's [light].
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from pydantic import BaseModel, ValidationError

from cellctl.desk.records import latest_kept
from cellctl.journal_file import FILE_NAME
from cellctl.learnt.references import CAMERAS, STRICT, Eye
from cellctl.log import log
from cellctl.monitoring.light import FIRST_PICTURES, QUIET_AGAIN, Cause, Trend, Warn, after, warnings
from cellctl.recipe import Recipe
from cellctl.recipe_light import RecipeLight
from cellctl.vision.features import Appearance

FEATURES: dict[str, str] = {  # of the cameras, and their tables in the recipe's [light]
    "camera-1 hole": "base_hole",
    "camera-1 edge": "base_edge",
    "camera-2 edge 1": "battery_edge_1",
    "camera-2 edge 2": "battery_edge_2",
}


class Kept(BaseModel):
    """What a unit's record keeps: what it is counted from, every feature's trend, the warnings in force."""

    model_config = STRICT
    of: str
    trends: dict[str, Trend]
    warned: dict[str, tuple[Warn, ...]]


@dataclass
class LightWatch:
    """The trends since one golden assembly, by feature."""

    of: str
    least_contrast: float
    trends: dict[str, Trend]
    warned: dict[str, tuple[Warn, ...]] = field(default_factory=dict)

    @classmethod
    def resumed(cls, state: Path, recipe: Recipe, taught: str) -> Self:
        """Where the last unit with this golden assembly left off, or from the beginning."""
        of, least = f"{taught}-{_id(recipe.light)}", recipe.limits.min_contrast
        last = latest_kept(state / FILE_NAME, "light", of)
        if last is not None:
            try:
                kept = Kept.model_validate_json(last[1])
            except ValidationError as error:
                log.warning(f"focus and light are watched anew: the record of unit {last[0]} cannot be used: {error}")
            else:
                return cls(of, least, kept.trends, kept.warned)
        return cls(of, least, _beginning(recipe.light))

    def see(self, camera: Eye, looks: Mapping[str, Appearance]) -> None:
        """One more picture of a camera; a warning that is new or over is logged."""
        before = self._worst(camera)
        for name, look in looks.items():
            self._follow(f"{camera} {name}", look)
        now = self._worst(camera)
        for cause in now.keys() - before.keys():
            log.warning(now[cause])
        for cause in before.keys() - now.keys():
            log.info(f"{camera}: {cause} is as it should be again")

    def _follow(self, feature: str, look: Appearance) -> None:
        known = {warn.cause for warn in self.warned.get(feature, ())}
        self.trends[feature] = after(self.trends.get(feature, Trend()), look)
        found = warnings(self.trends[feature], self.least_contrast)
        self.warned[feature] = tuple(
            warn for warn in found if warn.severity >= (QUIET_AGAIN if warn.cause in known else 1.0)
        )

    def _worst(self, camera: Eye) -> dict[Cause, str]:
        """The warnings in force, one sentence per cause."""
        mine = [(warn, name) for name, found in self.warned.items() if name.startswith(camera) for warn in found]
        return {
            warn.cause: f"{name}: {warn.sentence}" for warn, name in sorted(mine, key=lambda each: each[0].severity)
        }

    @property
    def sentences(self) -> list[str]:
        """All warnings in force."""
        return [sentence for camera in CAMERAS for sentence in self._worst(camera).values()]

    def record(self) -> dict[str, object]:
        """For the record of a unit."""
        return Kept(of=self.of, trends=self.trends, warned=self.warned).model_dump(mode="json")


def standing_text(state: Path, recipe: Recipe, taught: str) -> str:
    """How it stands with focus and light, for people. Reads files."""
    watch = LightWatch.resumed(state, recipe, taught)
    if watch.sentences:
        return "; ".join(watch.sentences)
    pictures = min((trend.pictures for trend in watch.trends.values()), default=0)
    learning = any(trend.taught is None for trend in watch.trends.values())
    return (
        f"as taught ({pictures} pictures)"
        if not learning
        else f"being learnt ({pictures} of {FIRST_PICTURES} pictures)"
    )


def _beginning(light: RecipeLight | None) -> dict[str, Trend]:
    """Trends without a picture; how features should look is known when the recipe says it."""
    if light is None:
        return {feature: Trend() for feature in FEATURES}
    tables = light.model_dump()
    return {feature: Trend(taught=Appearance(**tables[table])) for feature, table in FEATURES.items()}


def _id(light: RecipeLight | None) -> str:
    return hashlib.sha256(light.model_dump_json().encode()).hexdigest()[:8] if light else "learnt"
