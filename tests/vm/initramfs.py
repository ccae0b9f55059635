"""A Linux root for a virtual machine, in memory: busybox, the modules that are needed, and the script that runs first.

The real root is the host's, read-only over 9p: so the machine has the same Python and the same program as the host.
"""

import gzip
import lzma
import re
from collections.abc import Iterator
from pathlib import Path

DEPENDS = re.compile(rb"\0depends=([^\0]*)\0")
BUSYBOX = Path("/bin/busybox")  # Debian package busybox-static
FOLDERS = ("bin", "modules", "proc", "sys", "dev", "host")
FILE, FOLDER, EXECUTABLE = 0o100644, 0o040755, 0o100755
INIT = """#!/bin/busybox sh
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
{insmod}
mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=524288,cache=loose host /host || echo "no root"
for folder in proc sys dev; do mount --bind /$folder /host/$folder; done
mount -t tmpfs tmpfs /host/run
chroot /host /bin/sh -c '{command}' 2>&1
reboot -f
"""


def build(modules: Path, wanted: list[str], parameters: dict[str, str], command: str) -> bytes:
    """The compressed archive. `modules` is the kernel's folder of modules; `parameters` are of single modules."""
    known = _known(modules)
    order = list(dict.fromkeys(_with_dependencies(known, wanted)))
    insmod = "\n".join(f"insmod /modules/{name}.ko {parameters.get(name, '')}" for name in order)
    files: list[tuple[str, int, bytes]] = [(name, FOLDER, b"") for name in FOLDERS]
    files.append(("bin/busybox", EXECUTABLE, BUSYBOX.read_bytes()))
    files += [(f"modules/{name}.ko", FILE, _content(known[name])) for name in order]
    files.append(("init", EXECUTABLE, INIT.replace("{insmod}", insmod).replace("{command}", command).encode()))
    return gzip.compress(_archive(files), 1)


def _known(modules: Path) -> dict[str, Path]:
    return {path.name.split(".")[0].replace("-", "_"): path for path in modules.rglob("*.ko*")}


def _content(path: Path) -> bytes:
    data = path.read_bytes()
    return lzma.decompress(data) if path.suffix == ".xz" else data


def _with_dependencies(known: dict[str, Path], wanted: list[str]) -> Iterator[str]:
    """Every module after those that it needs. One that is built into the kernel has no file."""
    for name in wanted:
        if name not in known:
            continue
        found = DEPENDS.search(_content(known[name]))
        needed = found[1].decode().replace("-", "_").split(",") if found and found[1] else []
        yield from _with_dependencies(known, needed)
        yield name


def _archive(files: list[tuple[str, int, bytes]]) -> bytes:
    """In the kernel's format: cpio, "newc"."""
    parts = []
    for number, (name, mode, data) in enumerate([*files, ("TRAILER!!!", 0, b"")], 1):
        fields = (number, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(name) + 1, 0)
        head = b"070701" + b"".join(b"%08x" % field for field in fields) + name.encode() + b"\0"
        parts += [_padded(head), _padded(data)]
    return b"".join(parts)


def _padded(data: bytes) -> bytes:
    return data + b"\0" * (-len(data) % 4)
