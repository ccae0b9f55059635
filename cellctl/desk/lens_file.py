"""The result of a lens calibration as a file: dated, versioned, sealed, strict."""

from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, Field, model_validator

from cellctl.calibration.lens.quality import common_residual, uncertainty
from cellctl.calibration.lens.report import assumed
from cellctl.calibration.lens.solve import LensResult
from cellctl.calibration.plane_map import Lens
from cellctl.learnt.references import STRICT, Reference, now

NAME = "lens.json"
Square = tuple[tuple[float, ...], ...]


class LensPicture(BaseModel):
    """How one picture fits: where the board was, in the parameters that `own_parameters` names."""

    model_config = STRICT
    name: str
    points: int = Field(ge=0)
    rms_px: float = Field(ge=0)
    own: tuple[float, ...]
    covariance: Square


class LensPictureOut(BaseModel):
    """A picture that was left out."""

    model_config = STRICT
    name: str
    reason: str


class LensFile(Reference):
    """One lens: parameters, how well they are known, and from which pictures. px rms are distances, not per axis."""

    schema_version: Literal[1] = 1
    lens: Lens
    board: str  # as it was described
    picture_width_px: int = Field(gt=0)
    picture_height_px: int = Field(gt=0)
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    covariance: Square
    sd_between_pictures: tuple[float, ...] | None  # jackknife; None for one picture
    taken_for_granted: tuple[str, ...]  # parameters that these pictures do not show
    own_parameters: tuple[str, ...]
    pictures: tuple[LensPicture, ...]
    left_out: tuple[LensPictureOut, ...]
    rms_px: float
    sd_px: float  # of a point, per axis
    hold_out_px: float | None  # None for one picture
    same_in_all_px: float  # of the residual: the board's own
    coverage: float
    known_rms_px: float  # one sigma of where the lens puts a point, where the board was seen
    known_worst_px: float  # and at the worst place of the picture

    @model_validator(mode="after")
    def _of_one_size(self) -> Self:
        count = len(self.parameters)
        if {len(self.values), len(self.covariance), *(len(row) for row in self.covariance)} != {count}:
            raise ValueError(f"values and covariance must be of {count} parameters")
        return self

    @classmethod
    def of(cls, result: LensResult, board: str) -> Self:
        """The file of a result."""
        fit, known = result.fit, uncertainty(result)
        width, height = fit.adjustment.views.picture_px
        return cls(
            made_at=now(),
            lens=fit.adjustment.model.lens,
            board=board,
            picture_width_px=width,
            picture_height_px=height,
            parameters=fit.adjustment.model.parameters,
            values=tuple(fit.shared.tolist()),
            covariance=_square(result.covariance.tolist()),
            sd_between_pictures=None if result.fold_sd is None else tuple(result.fold_sd.tolist()),
            taken_for_granted=assumed(result),
            own_parameters=fit.adjustment.model.own,
            pictures=_pictures(result),
            left_out=tuple(LensPictureOut(name=out.name, reason=out.reason) for out in result.out),
            rms_px=fit.rms_px,
            sd_px=fit.adjustment.sd_px,
            hold_out_px=result.hold_out_px,
            same_in_all_px=common_residual(result)[0],
            coverage=result.coverage,
            known_rms_px=known.rms_px,
            known_worst_px=known.worst_px,
        )

    def keep_in(self, folder: Path) -> Path:
        """Write it as lens.json; what was there before is kept under its date."""
        path = folder / NAME
        if path.exists():
            earlier = self.read(path, "move it away").made_at
            path.rename(path.with_name(f"lens-{earlier:%Y%m%d-%H%M%S}.json"))
        self.save(path)
        return path


def _pictures(result: LensResult) -> tuple[LensPicture, ...]:
    fit = result.fit
    rows = zip(
        result.names,
        fit.used.sum(1).tolist(),
        fit.picture_rms_px.tolist(),
        fit.own.tolist(),
        result.own_covariances.tolist(),
        strict=True,
    )
    return tuple(
        LensPicture(name=name, points=points, rms_px=rms_px, own=tuple(own), covariance=_square(covariance))
        for name, points, rms_px, own, covariance in rows
    )


def _square(rows: list[list[float]]) -> Square:
    return tuple(tuple(row) for row in rows)
