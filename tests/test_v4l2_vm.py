"""The memory image of the virtual machine: every module after those it needs, in an archive that the kernel reads."""

import gzip
import lzma
from pathlib import Path

import pytest

from tests.vm.initramfs import build


def module(folder: Path, name: str, depends: str, *, packed: bool = False) -> None:
    content = b"\x7fELF...\0license=GPL\0depends=" + depends.encode() + b"\0vermagic=6.1\0"
    path = folder / (f"{name}.ko.xz" if packed else f"{name}.ko")
    path.write_bytes(lzma.compress(content) if packed else content)


def listed(archive: bytes) -> dict[str, bytes]:
    """Files of a "newc" archive, read by its description in the kernel's documentation."""
    files, at = {}, 0
    while True:
        assert archive[at : at + 6] == b"070701"
        fields = [int(archive[at + 6 + 8 * n : at + 14 + 8 * n], 16) for n in range(13)]
        size, name_size = fields[6], fields[11]
        name = archive[at + 110 : at + 110 + name_size - 1].decode()
        begin = -(-(at + 110 + name_size) // 4) * 4
        if name == "TRAILER!!!":
            return files
        files[name] = archive[begin : begin + size]
        at = -(-(begin + size) // 4) * 4


@pytest.fixture
def busybox(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Debian's is not needed to see what is packed."""
    program = tmp_path / "busybox"
    program.write_bytes(b"a program")
    monkeypatch.setattr("tests.vm.initramfs.BUSYBOX", program)


def test_modules_are_loaded_after_those_that_they_need(tmp_path: Path, busybox: None):
    folder = tmp_path / "modules"
    folder.mkdir()
    module(folder, "camera", "video-core,buffers", packed=True)
    module(folder, "video-core", "")
    module(folder, "buffers", "video-core,builtin")
    files = listed(gzip.decompress(build(folder, ["camera"], {"camera": "count=2"}, "run it")))
    loads = [line for line in files["init"].decode().splitlines() if line.startswith("insmod")]
    assert [line.strip() for line in loads] == [
        "insmod /modules/video_core.ko",
        "insmod /modules/buffers.ko",
        "insmod /modules/camera.ko count=2",
    ]
    assert files["modules/camera.ko"].startswith(b"\x7fELF")
    assert files["bin/busybox"] == b"a program"
    assert b"'run it'" in files["init"]
