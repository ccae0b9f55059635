"""What README.md says is so."""

import re
from pathlib import Path

import pytest

from cellctl.machine import diagram

ROOT = Path(__file__).resolve().parent.parent
NAMED = r"`((?:cellctl|drivers|simulators|deploy|tests)/[\w./]+)`"
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_state_diagram_is_the_table() -> None:
    (drawn,) = re.findall(r"```mermaid\n(.*?)\n```", README, re.DOTALL)
    assert drawn == diagram()


@pytest.mark.parametrize(
    "name", sorted(set(re.findall(r"`((?:cellctl|drivers|simulators|deploy|tests)/[\w./]+)`", README)))
)
def test_what_it_names_exists(name: str) -> None:
    assert (ROOT / name.partition("::")[0]).exists()


@pytest.mark.parametrize("target", sorted(set(re.findall(r"make ([a-z][a-z-]+)", README))))
def test_the_targets_it_names_are_in_the_makefile(target: str) -> None:
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def test_the_six_steps_it_tells_are_the_functions_of_the_cycle() -> None:
    cycle = (ROOT / "cellctl" / "cycle.py").read_text(encoding="utf-8")
    for number, name in re.findall(r"^(\d)\. `(\w+)`", README, re.MULTILINE):
        assert f"def {name}(" in cycle, f"step {number}"
