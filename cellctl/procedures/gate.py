"""What becomes of a calibration's result: judged, kept with its report, used at once or waiting to be accepted."""

import cv2

from cellctl.calibration.difference import differences, worst_um
from cellctl.calibration.drawing import Picture
from cellctl.calibration.hand_eye import HandEye
from cellctl.calibration.parameters import PARAMETERS
from cellctl.calibration.report import Acceptance, report_text, shortcomings, tool_centre_line, tool_centre_text
from cellctl.calibration.report_picture import Past, report_picture
from cellctl.calibration.tool_centre import ToolCentre
from cellctl.config import CellConfig
from cellctl.faults import CalibrationFailed, NotCalibrated
from cellctl.learnt.calibrations import CameraCalibration, ToolFigures, camera_config, mount_of, read_calibration
from cellctl.learnt.doubts import temperature_now
from cellctl.learnt.references import Eye, now
from cellctl.learnt.versions import Report, accept, add_candidate, shelf


def judged(config: CellConfig, camera: Eye, controller: str, result: HandEye, centre: ToolCentre | None) -> str:
    """Keep the result; what becomes of it, in one sentence. Writes files, so not on the loop.

    Raises CalibrationFailed for one that has not passed the gate: it is kept as a refused candidate.
    """
    limits = acceptance(config)
    objections = [*shortcomings(result, limits), *([] if centre is None else off_centre(config, centre))]
    calibration = _calibration(config, camera, controller, result).model_copy(
        update={"tool": tool_figures(centre) if centre else None, "objections": tuple(objections)}
    )
    found = add_candidate(config.paths.state, calibration, _report(config, calibration, result, centre))
    if objections:
        kept = f"kept as refused candidate {calibration.id}, report: {found.path.with_suffix('.txt')}"
        raise CalibrationFailed(f"{camera}: {'; '.join(objections)} ({kept})")
    brief = [f"{camera}: rms {result.rms_px:.3f} px, hold-out {result.hold_out_um:.1f} um"]
    turned = [tool_centre_line(centre)] if centre else []
    return ", ".join([*brief, *turned, _follows(config, calibration)])


def acceptance(config: CellConfig) -> Acceptance:
    """The limits of cell.toml."""
    limits = config.calibration
    return Acceptance(
        rms_px=limits.max_rms_px,
        hold_out_um=limits.max_hold_out_um,
        absolute_um=limits.max_absolute_um,
        differential_um=limits.max_differential_um,
        robot_factor=limits.max_robot_factor,
    )


def off_centre(config: CellConfig, centre: ToolCentre) -> list[str]:
    """Why the rotation centre by turning and by the map do not agree; empty when they do."""
    limit_um = config.calibration.max_tool_centre_um
    if centre.error_um <= limit_um:
        return []
    return [
        f"the tool's rotation centre by turning lies {centre.error_um:.1f} um from the map's, {limit_um:g} um are "
        "allowed: calibrate camera-2 again, and look for a loose camera or cup if it stays"
    ]


def tool_figures(centre: ToolCentre) -> ToolFigures:
    """The rotation centre as the file keeps it."""
    return ToolFigures(
        centre_px=centre.centre_px,
        map_dx_um=centre.map_dx_um,
        map_dy_um=centre.map_dy_um,
        centre_covariance_um2=_rows(centre.covariance_um2.tolist()),
        eccentricity_mm=(centre.eccentricity_mm.x_mm, centre.eccentricity_mm.y_mm),
        eccentricity_covariance_um2=_rows(centre.eccentricity_covariance_um2.tolist()),
        wobble_rms_um=centre.wobble_rms_um,
        wobble_worst_um=centre.wobble_worst_um,
    )


def png(picture: Picture) -> bytes:
    """A picture as a file's bytes."""
    ok, encoded = cv2.imencode(".png", picture)
    assert ok
    return encoded.tobytes()


def _calibration(config: CellConfig, camera: Eye, controller: str, result: HandEye) -> CameraCalibration:
    return CameraCalibration(
        made_at=now(),
        camera=camera,
        serial=camera_config(config, camera).serial,
        view=camera_config(config, camera).region,
        mount=mount_of(config, camera),
        robot_serial=config.robot.serial,
        robot_controller=controller,
        plane=result.plane_map,
        target=result.board,
        poses=len(result.poses),
        rotation_spread_deg=result.spread.rotation_deg,
        rms_px=result.rms_px,
        hold_out_um=result.hold_out_um,
        predicted_sd_um=result.predicted.absolute_um,
        predicted_differential_um=result.predicted.differential_um,
        slope_px_per_mm=result.slope_px_per_mm,
        robot_factor=result.robot_factor,
        note=result.note,
        parameters=PARAMETERS,
        covariance=_rows(result.covariance.tolist()),
        temperature_c=temperature_now(config.paths.state, config.calibration.temperature_valid_h),
    )


def _report(config: CellConfig, calibration: CameraCalibration, result: HandEye, centre: ToolCentre | None) -> Report:
    """Text and picture, with the figures of all earlier versions."""
    parts = [_heading(calibration), report_text(result, acceptance(config))]
    if centre is not None:
        parts.append(tool_centre_text(centre, result.sd_um(centre.centre_px)))
    earlier = [version.calibration for version in reversed(shelf(config.paths.state, calibration.camera).versions)]
    past = [
        Past(f"{one.made_at:%y-%m-%d}", one.hold_out_um, one.predicted_sd_um, bool(one.objections))
        for one in [*earlier, calibration]
    ]
    return Report("\n".join(parts), png(report_picture(result, past, acceptance(config))))


def _heading(calibration: CameraCalibration) -> str:
    warm = "not known" if calibration.temperature_c is None else f"{calibration.temperature_c:g} C"
    rows = [
        ("camera", f"{calibration.camera}, serial {calibration.serial}, mount {calibration.mount}"),
        ("robot", f"serial {calibration.robot_serial}, controller {calibration.robot_controller}"),
        ("made", f"{calibration.made}, temperature {warm}"),
    ]
    return "\n".join(f"{name:<15} {text}" for name, text in rows)


def _follows(config: CellConfig, calibration: CameraCalibration) -> str:
    """In use at once when nothing usable is replaced by it; else it waits for a person."""
    camera = calibration.camera
    try:
        in_use = read_calibration(config, camera)
    except NotCalibrated:
        accept(config.paths.state, camera, calibration.id)
        return f"in use as {calibration.id}"
    view = camera_config(config, camera)
    away_um = worst_um(differences(calibration.plane, in_use.plane, (view.view_width_px, view.view_height_px)))
    return (
        f"waits as {calibration.id}, up to {away_um:.1f} um from {in_use.id} in use: to use it, "
        f"`cellctl calibrate accept {camera}`, then teach anew"
    )


def _rows(matrix: list[list[float]]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix)
