"""Files of what the cell has learnt about itself: strict, sealed, written whole or not at all.

A file is `{"sha256": ..., "content": {...}}`. The seal proves that what is read is what was written: a flipped bit in
a digit would else be a good file with a wrong number in it. Such files are not edited by hand; learn anew instead.
"""

import hashlib
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal, Self, TypeVar

from pydantic import AwareDatetime, BaseModel, ConfigDict, ValidationError
from pydantic_core import from_json

from cellctl.faults import NotCalibrated

Eye = Literal["camera-1", "camera-2"]
CAMERAS: tuple[Eye, Eye] = ("camera-1", "camera-2")
LARGEST_FILE = 1024 * 1024
STRICT = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

R = TypeVar("R", bound="Reference")


class Reference(BaseModel):
    """A frozen file of learnt values."""

    model_config = STRICT
    newest_schema: ClassVar[int] = 1

    schema_version: int
    made_at: AwareDatetime

    @property
    def sha256(self) -> str:
        """Hash of the content."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()

    @property
    def id(self) -> str:
        """Short content hash; unit records name it."""
        return self.sha256[:12]

    @property
    def made(self) -> str:
        """When it was made, for people."""
        return f"{self.made_at.astimezone(UTC):%Y-%m-%d %H:%M} UTC"

    def save(self, path: Path) -> None:
        """Write durably, whole or not at all."""
        sealed = _Sealed[Any](sha256=self.sha256, content=self.model_dump(mode="json"))
        write_whole(path, sealed.model_dump_json(indent=1).encode() + b"\n")

    @classmethod
    def read(cls, path: Path, remedy: str) -> Self:
        """Raises NotCalibrated with the remedy when there is no such file or it cannot be trusted."""
        try:
            with path.open("rb") as file:
                return cls.unsealed(file.read(LARGEST_FILE + 1))
        except FileNotFoundError:
            raise NotCalibrated(f"{path} does not exist: {remedy}") from None
        except (OSError, ValueError) as error:
            raise NotCalibrated(f"{path} cannot be used ({_first_words(error)}): {remedy}") from None

    @classmethod
    def unsealed(cls, raw: bytes) -> Self:
        """The content of a file's bytes. Raises ValueError unless it is exactly what was once written."""
        if len(raw) > LARGEST_FILE:
            raise ValueError(f"larger than {LARGEST_FILE} bytes")
        cls._check_schema(from_json(raw, allow_inf_nan=False))
        sealed: _Sealed[Self] = _Sealed[cls].model_validate_json(raw)  # type: ignore[valid-type]
        if sealed.sha256 != sealed.content.sha256:
            raise ValueError("damaged or edited: the content is not what was written")
        return sealed.content

    @classmethod
    def _check_schema(cls, file: object) -> None:
        content = file.get("content", file) if isinstance(file, dict) else None
        version = content.get("schema_version") if isinstance(content, dict) else None
        if isinstance(version, int) and version < cls.newest_schema:
            raise ValueError(f"of an earlier release: schema {version}, this one reads {cls.newest_schema}")
        if isinstance(version, int) and version > cls.newest_schema:
            raise ValueError(f"of a later release: schema {version}, this one reads {cls.newest_schema}")


class _Sealed(BaseModel, Generic[R]):
    """The outer layer of a file."""

    model_config = STRICT
    sha256: str
    content: R


def now() -> datetime:
    """Time stamp of a new reference."""
    return datetime.now(UTC)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file durably: it is there whole, or as it was before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.part")
    with part.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make renames in a folder durable."""
    descriptor = os.open(folder, os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _first_words(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}".removeprefix(": ")
    return (getattr(error, "strerror", None) or str(error)).splitlines()[0]
