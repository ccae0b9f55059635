"""Annotated pictures of every measurement, written beside the work: a bounded queue and one writer thread.

A picture that finds the queue full is dropped and counted: the line never waits for a disk to draw pictures.
"""

import queue
import threading
from pathlib import Path
from typing import NamedTuple

import cv2

from cellctl.vision import BaseMeasurement, BatteryMeasurement, Edge
from cellctl.vision.annotate import annotate
from cellctl.vision.features import ExpectedCircle, ExpectedEdge
from cellctl.vision.gap import GapMeasurement
from drivers.camera import Pixels

MOST_WAITING = 8
JPEG_QUALITY = 85
Expected = tuple[ExpectedCircle | ExpectedEdge, ...]
Measurement = BaseMeasurement | BatteryMeasurement | Edge | GapMeasurement


class _Job(NamedTuple):
    path: Path
    pixels: Pixels
    measurement: Measurement | None
    expected: Expected
    caption: str


class Pictures:
    """A folder of annotated pictures, `UNIT-CAMERA.jpg`, half size."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.dropped = 0
        self.failed: str | None = None
        self._queue: queue.Queue[_Job | None] = queue.Queue(MOST_WAITING)
        folder.mkdir(parents=True, exist_ok=True)
        self._thread = threading.Thread(target=self._write, name="pictures", daemon=True)
        self._thread.start()

    def keep(
        self,
        unit: str,
        camera: str,
        pixels: Pixels,
        measurement: Measurement | None,
        expected: Expected,
        caption: str,
    ) -> str:
        """Draw and write it soon; returns its file name at once."""
        path = self.folder / f"{unit}-{camera}.jpg"
        try:
            self._queue.put_nowait(_Job(path, pixels, measurement, expected, caption))
        except queue.Full:
            self.dropped += 1
        return path.name

    def close(self) -> None:
        """Write what waits, then end."""
        self._queue.put(None)
        self._thread.join()

    def _write(self) -> None:
        while job := self._queue.get():
            drawn = annotate(job.pixels, job.measurement, job.expected, job.caption)
            try:
                ok, encoded = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
                assert ok
                job.path.write_bytes(encoded.tobytes())
            except OSError as error:
                self.failed = f"{job.path}: {error.strerror}"
