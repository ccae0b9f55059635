"""Many pictures in packs on two processes. What is done stays on disk: an interrupted part goes on where it was."""

import hashlib
import itertools
import json
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2

PROCESSES, PACK = 2, 20
DONE = Path("build/bench-vision")
SOURCES = (
    "cellctl/vision/*.py",
    *(f"simulators/{name}.py" for name in ("optics", "parts", "place", "render", "shapes")),
    "tests/vision_*.py",
    "tests/hostile_*.py",
    *(f"tests/benchmarks/vision/{name}.py" for name in ("contest", "errors", "paper", "peers", "regions", "trials")),
)
Work = Callable[[range], Any]


@cache
def version() -> str:
    """Of the finders, of what they are shown and of how they are judged: figures of another one do not count."""
    digest = hashlib.sha256(cv2.__version__.encode())
    for path in itertools.chain.from_iterable(sorted(Path().glob(pattern)) for pattern in SOURCES):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def in_packs(work: Work, pictures: int, name: str) -> Iterator[Any]:
    """What `work` makes of each pack of numbers, as plain JSON, in any order. `work` is a function of a module."""
    packs = [range(first, min(first + PACK, pictures)) for first in range(0, pictures, PACK)]
    if len(packs) < 2:
        yield from map(work, packs)
        return
    DONE.mkdir(parents=True, exist_ok=True)
    path = DONE / f"{name}-{version()}.jsonl"
    done = _kept(path)
    left = [pack for pack in packs if (pack.start, pack.stop) not in done]
    yield from (done[pack.start, pack.stop] for pack in packs if pack not in left)
    shown = pictures - sum(map(len, left))
    with path.open("a", encoding="utf-8") as file:
        for pack, result in _worked(work, left):
            file.write(json.dumps([pack.start, pack.stop, result]) + "\n")
            file.flush()
            shown += len(pack)
            print(f"\r{name}: {shown} of {pictures}", end="", file=sys.stderr, flush=True)
            yield result
    print(file=sys.stderr)


def _worked(work: Work, packs: list[range]) -> Iterator[tuple[range, Any]]:
    """Packs and what was made of them, as they are done. The first that fails ends all."""
    with ProcessPoolExecutor(PROCESSES, get_context("spawn")) as pool:
        tasks = {pool.submit(work, pack): pack for pack in packs}
        try:
            for task in as_completed(tasks):
                yield tasks[task], task.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _kept(path: Path) -> dict[tuple[int, int], Any]:
    """Results of an earlier run; a last line that was cut off is taken away."""
    lines = path.read_text("utf-8").splitlines(keepends=True) if path.exists() else []
    if lines and not lines[-1].endswith("\n"):
        path.write_text("".join(lines[:-1]), encoding="utf-8")
        lines.pop()
    return {(first, last): result for first, last, result in map(json.loads, lines)}
