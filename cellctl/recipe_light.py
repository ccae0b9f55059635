"""What a recipe that was taught from pictures says about them: how they look, and how the parts lie in them."""

from typing import Annotated, Literal

from pydantic import Field

from cellctl.strict_toml import Settings

Level = Annotated[float, Field(ge=0, le=255)]
Side = Annotated[int, Field(ge=64, le=20000)]


class FeatureLight(Settings):
    """One feature as it looks when focus and light are right."""

    blur_px: float = Field(gt=0, le=10, description="Blur of the outline: sigma of the lens' point spread in px")
    contrast: float = Field(gt=0, le=255, description="Grey levels across the outline")
    noise: float = Field(ge=0, le=100, description="Grey levels, 1 sigma, beside the outline")
    dark: Level = Field(description="Grey level on the dark side")
    bright: Level = Field(description="Grey level on the bright side")
    saturated: float = Field(default=0.0, ge=0, le=1, description="Share of the outline that is saturated")


class RecipeLight(Settings):
    """How good pictures look at this exposure: the cell warns when its pictures drift away from it."""

    base_hole: FeatureLight
    base_edge: FeatureLight
    battery_edge_1: FeatureLight
    battery_edge_2: FeatureLight


class PictureView(Settings):
    """How a part lies in the pictures of one camera."""

    mm_per_px: float = Field(ge=0.0005, le=0.2, description="Size of a pixel on the part in mm")
    turn_deg: float = Field(
        ge=-180, le=180, description="Direction of the part's x axis, counter-clockwise as seen from above, from +u"
    )
    seen_from: Literal["above", "below"] = Field(description="Side from which the camera sees the part")
    width_px: Side = Field(description="Width of the pictures in px")
    height_px: Side = Field(description="Height of the pictures in px")


class RecipePictures(Settings):
    """The pictures that the recipe was taught from; `cellctl vision test` expects the parts as they lie there."""

    base: PictureView
    battery: PictureView
