"""Every calibration of a camera that was ever accepted, and the candidates that were not: files that only grow.

    calibration/camera-1.json                          the one in use, a copy of one of the next
    calibration/camera-1/20261122-073105-ID.json       accepted once, with its report as .txt and .png
    calibration/camera-1/candidates/...                waiting to be accepted, or refused by the gate

Nothing is overwritten: what goes out of use stays where it is, and what cannot be read any more is put aside.
"""

from pathlib import Path
from typing import Literal, NamedTuple

from cellctl.faults import NotCalibrated
from cellctl.learnt.calibrations import CameraCalibration
from cellctl.learnt.references import Eye, now, sync_folder, write_whole

Standing = Literal["in use", "kept", "waiting", "refused"]
REPORTS = (".txt", ".png")


class Report(NamedTuple):
    """What a person reads about a calibration."""

    text: str
    png: bytes


class Version(NamedTuple):
    """One calibration of the shelf."""

    calibration: CameraCalibration
    standing: Standing
    path: Path

    @property
    def text(self) -> str:
        """Its report, or that there is none."""
        try:
            return self.path.with_suffix(".txt").read_text(encoding="utf-8").rstrip()
        except (OSError, UnicodeDecodeError):
            return "there is no report beside this file"


class Shelf(NamedTuple):
    """All versions of one camera, the newest first, and the files that cannot be read with why."""

    versions: tuple[Version, ...]
    unreadable: tuple[str, ...]

    @property
    def in_use(self) -> Version | None:
        """The one in use."""
        return next((version for version in self.versions if version.standing == "in use"), None)

    def find(self, version_id: str | None, camera: Eye, *standings: Standing) -> Version:
        """The version with this id, or the newest, of these standings. Raises NotCalibrated."""
        known = [version for version in self.versions if not standings or version.standing in standings]
        for version in known:
            if version_id in (None, version.calibration.id):
                return version
        ids = ", ".join(version.calibration.id for version in known) or "none"
        kind = f" that is {' or '.join(standings)}" if standings else ""
        wanted = f" {version_id}" if version_id else ""
        raise NotCalibrated(f"{camera} has no version{wanted}{kind}; there are: {ids}")


def shelf(state: Path, camera: Eye) -> Shelf:
    """Read all versions of a camera."""
    used = _id_in_use(state, camera)
    versions, unreadable = [], []
    for folder, accepted in ((_folder(state, camera), True), (_folder(state, camera) / "candidates", False)):
        for path in sorted(folder.glob("*.json")):
            try:
                calibration = CameraCalibration.read(path, f"move it away, or run `cellctl calibrate {camera}`")
            except NotCalibrated as error:
                unreadable.append(str(error))
                continue
            versions.append(Version(calibration, _standing(calibration, accepted, used), path))
    versions.sort(key=lambda version: version.calibration.made_at, reverse=True)
    return Shelf(tuple(versions), tuple(unreadable))


def add_candidate(state: Path, calibration: CameraCalibration, report: Report) -> Version:
    """Put a new calibration on the shelf, with its report; it is not used yet."""
    camera = calibration.camera
    path = _folder(state, camera) / "candidates" / _name(calibration)
    write_whole(path.with_suffix(".txt"), report.text.encode() + b"\n")
    write_whole(path.with_suffix(".png"), report.png)
    calibration.save(path)
    return Version(calibration, _standing(calibration, False, None), path)


def accept(state: Path, camera: Eye, version_id: str | None = None) -> CameraCalibration:
    """Bring a waiting candidate, or an earlier version, into use. Raises NotCalibrated when there is no such one."""
    standings: tuple[Standing, ...] = ("waiting",) if version_id is None else ("waiting", "kept", "in use")
    chosen = shelf(state, camera).find(version_id, camera, *standings)
    folder = _folder(state, camera)
    if chosen.path.parent != folder:
        for path in (*(chosen.path.with_suffix(suffix) for suffix in REPORTS), chosen.path):
            if path.exists():
                path.replace(folder / path.name)
        sync_folder(folder)
    _put_aside(state, camera)
    chosen.calibration.save(CameraCalibration.path(state, camera))
    return chosen.calibration


def revert(state: Path, camera: Eye) -> CameraCalibration:
    """Bring the accepted version into use that was made before the one in use. Raises NotCalibrated."""
    versions = shelf(state, camera)
    used = versions.in_use
    if used is None:
        raise NotCalibrated(f"no version of {camera} is in use; choose one with `cellctl calibrate accept {camera} ID`")
    for version in versions.versions:
        if version.standing == "kept" and version.calibration.made_at < used.calibration.made_at:
            return accept(state, camera, version.calibration.id)
    raise NotCalibrated(f"{camera} has no accepted version before {used.calibration.id}")


def _standing(calibration: CameraCalibration, accepted: bool, used: str | None) -> Standing:
    if accepted:
        return "in use" if calibration.id == used else "kept"
    return "refused" if calibration.objections else "waiting"


def _put_aside(state: Path, camera: Eye) -> None:
    """What is in use now stays on the shelf, also when it cannot be read or came from elsewhere."""
    path, folder = CameraCalibration.path(state, camera), _folder(state, camera)
    if not path.exists():
        return
    try:
        current = CameraCalibration.read(path, "")
    except NotCalibrated:
        path.replace(folder / f"{now():%Y%m%d-%H%M%S-%f}-unreadable.json")
        return
    kept = folder / _name(current)
    if not kept.exists():
        current.save(kept)


def _id_in_use(state: Path, camera: Eye) -> str | None:
    try:
        return CameraCalibration.read(CameraCalibration.path(state, camera), "").id
    except NotCalibrated:
        return None


def _folder(state: Path, camera: Eye) -> Path:
    return state / "calibration" / camera


def _name(calibration: CameraCalibration) -> str:
    return f"{calibration.made_at:%Y%m%d-%H%M%S}-{calibration.id}.json"
