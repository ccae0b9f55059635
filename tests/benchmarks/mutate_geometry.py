"""Plant a sign error in every term of cellctl/geometry.py, one at a time: the whole-cell tests must notice each.

`python -m tests.benchmarks.mutate_geometry` works on copies of the tree; it prints a line per planted error and
fails when one of them goes unnoticed. `--fast` judges by the geometry's own tests instead.
"""

import ast
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
TARGET = Path("cellctl/geometry.py")
PARTS = ("cellctl", "drivers", "simulators", "recipes", "deploy", "tests", "pyproject.toml")
WHOLE = ("tests/test_whole.py", "-k", "ten_rows")
OWN = ("tests/test_geometry.py",)
WITHIN_S = 180


class Planter(ast.NodeTransformer):
    """Turns the sign of term number `wanted`: + to -, - to +, or -x to x."""

    def __init__(self, wanted: int) -> None:
        self.wanted = wanted
        self.seen = -1
        self.where = ""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.Add | ast.Sub) and self._this(node):
            node.op = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.USub) and self._this(node):
            return node.operand
        return node

    def _this(self, node: ast.expr) -> bool:
        self.seen += 1
        if self.seen != self.wanted:
            return False
        self.where = f"line {node.lineno}: {ast.unparse(node)}"
        return True


def planted(source: str) -> Iterator[tuple[str, str]]:
    """Every term once: (where, source with that sign turned)."""
    wanted = 0
    while True:
        planter = Planter(wanted)
        tree = planter.visit(ast.parse(source))
        if not planter.where:
            return
        yield planter.where, ast.unparse(tree)
        wanted += 1


def noticed(source: str, tests: tuple[str, ...]) -> bool:
    """Whether the tests fail on a tree with this geometry."""
    with tempfile.TemporaryDirectory() as folder:
        for part in PARTS:
            here, there = ROOT / part, Path(folder) / part
            shutil.copytree(here, there) if here.is_dir() else shutil.copy(here, there)
        (Path(folder) / TARGET).write_text(source, encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
        try:
            run = subprocess.run(command, cwd=folder, capture_output=True, timeout=WITHIN_S, check=False)
        except subprocess.TimeoutExpired:
            return True
        return run.returncode != 0


def main() -> int:
    """Print a line per planted error; 0 when all were noticed."""
    tests = OWN if "--fast" in sys.argv else WHOLE
    results = {}
    for where, source in planted((ROOT / TARGET).read_text(encoding="utf-8")):
        results[where] = noticed(source, tests)
        print(f"{'noticed ' if results[where] else 'MISSED  '} {where}", flush=True)
    missed = [where for where, was in results.items() if not was]
    print(f"{len(results) - len(missed)} of {len(results)} sign errors noticed by {' '.join(tests)}")
    out = ROOT / "build" / "bench-geometry-signs.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps({"planted": len(results), "missed": missed}, indent=1) + "\n", encoding="utf-8")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
