"""The short form of `make fuzz-robot`'s driver half: broken replies at everything of the driver that reads."""

import pytest

from tests.benchmarks.fuzz_robot_driver import PARSERS, fuzzed


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
async def test_broken_replies_break_no_parser_and_give_no_value_that_is_not_there(dialect):
    found = await fuzzed(dialect, 4000, seed=1)

    assert found["crashes"] == []
    assert found["inputs"] == 4000
    own = {"rcx3": {"pulses", "task", "alarm", "flag"}, "rcx2": {"hand", "position"}}[dialect]
    assert own <= set(found["read"]) <= {*PARSERS, "status", "point table"}
