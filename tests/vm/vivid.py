"""`make test-vm`: the V4L2 driver, unchanged, against the Linux kernel's own V4L2 core and its test driver vivid.

A virtual machine (QEMU, emulated, so it needs no rights) boots Debian's kernel with the host's files read-only, and
runs tests/vm/guest.py. Prints exact and total pictures for each pixel format, writes build/test-vm.json; exit code 1
unless all are exact.
"""

import argparse
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

from tests.vm.initramfs import build

ROOT = Path(__file__).resolve().parent.parent.parent
CACHE = ROOT / "build" / "vm"
OUT = ROOT / "build" / "test-vm.json"
KERNEL_PACKAGE = "linux-image-amd64"
MODULES = ["virtio_pci", "9pnet_virtio", "9p", "vivid"]
PARAMETERS = {
    "vivid": "n_devs=1 node_types=0x101 num_inputs=1 input_types=3 num_outputs=1 output_types=1 no_error_inj=1"
}
COLUMNS = ("format", "frames", "exact", "exposed_too_early", "stale", "gaps", "damaged", "took_s")


def kernel() -> Path:
    """Debian's newest kernel package, unpacked; fetched from the package mirror once."""
    said = subprocess.run(["apt-cache", "depends", KERNEL_PACKAGE], capture_output=True, text=True, check=True).stdout
    name = next(line.split()[-1] for line in said.splitlines() if "Depends: linux-image-" in line)
    folder = CACHE / name
    if not (folder / "boot").is_dir():
        print(f"fetching {name} (70 MB)", file=sys.stderr)
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(["apt-get", "download", "-qq", name], cwd=folder, check=True)
        package = next(folder.glob("*.deb"))
        subprocess.run(["dpkg-deb", "-x", package.name, "."], cwd=folder, check=True)
        package.unlink()
    return folder


def command(folder: Path, initramfs: Path, processors: int) -> list[str]:
    """QEMU's."""
    image = next((folder / "boot").glob("vmlinuz-*"))
    return [
        "qemu-system-x86_64", "-machine", "q35,accel=tcg", "-cpu", "max", "-smp", str(processors), "-m", "1500",
        "-nographic", "-nodefaults", "-no-reboot", "-serial", "stdio",
        "-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap",
        "-kernel", str(image), "-initrd", str(initramfs), "-append", "console=ttyS0 quiet loglevel=3 panic=-1",
    ]  # fmt: skip


def run(folder: Path, frames: int, within_s: float) -> tuple[list[dict[str, object]], list[str]]:
    """Results of the guest, and everything that it said."""
    python = f"{sys.executable} -B -m tests.vm.guest {frames}"
    initramfs = CACHE / "initramfs.gz"
    modules = next((folder / "lib" / "modules").iterdir())
    initramfs.write_bytes(build(modules, MODULES, PARAMETERS, f"cd {ROOT} && {python}"))
    machine = subprocess.Popen(command(folder, initramfs, 2), stdout=subprocess.PIPE, text=True, errors="replace")
    watchdog = threading.Timer(within_s, machine.kill)
    watchdog.start()
    said, results = [], []
    assert machine.stdout is not None
    began_s = time.monotonic()
    for line in machine.stdout:
        said.append(line.rstrip())
        if "RESULT " in line:
            results.append(json.loads(line.partition("RESULT ")[2]))
            at_s, one = time.monotonic() - began_s, results[-1]
            outcome = one.get("error", f"{one['exact']} of {one['frames']} exact")
            print(f"{at_s:6.1f} s  {one['format']}: {outcome}", file=sys.stderr)
    machine.wait()
    watchdog.cancel()
    return results, said


def main() -> int:
    """Run it; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=16, help="of each pixel format")
    parser.add_argument("--within", type=float, default=500.0, metavar="S", help="the machine is killed after this")
    options = parser.parse_args()
    CACHE.mkdir(parents=True, exist_ok=True)
    began_s = time.monotonic()
    results, said = run(kernel(), options.frames, options.within)
    if not results:
        print("\n".join(said[-40:]), file=sys.stderr)
        print("the virtual machine gave no result; above is what it said last", file=sys.stderr)
        return 1
    print("  ".join(f"{column:>17}" for column in COLUMNS))
    for one in results:
        print("  ".join(f"{one.get(column, '-'):>17}" for column in COLUMNS) + f"  {one.get('error', '')}")
    exact, total = (sum(int(str(one[key])) for one in results) for key in ("exact", "frames"))
    took_s = round(time.monotonic() - began_s, 1)
    print(f"exact {exact} of {total}, boot to power-off {took_s} s")
    OUT.write_text(json.dumps({"exact": exact, "frames": total, "took_s": took_s, "formats": results}, indent=2) + "\n")
    return 0 if exact == total and not any("error" in one or one["exposed_too_early"] for one in results) else 1


if __name__ == "__main__":
    sys.exit(main())
