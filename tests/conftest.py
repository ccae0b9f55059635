"""What all tests share: no test leaves a task behind; one commissioned cell per session."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import cv2
import pytest

from tests.whole_cell import commission


@pytest.fixture(autouse=True)
async def no_leftover_tasks(request: pytest.FixtureRequest) -> AsyncIterator[None]:
    """Every test must end the tasks that it began."""
    before = asyncio.all_tasks()
    yield
    this = asyncio.current_task()
    left = {task for task in asyncio.all_tasks() - before if not task.done() and task is not this}
    if left:
        await asyncio.wait(left, timeout=1.0)
    assert not {task for task in left if not task.done()}, "tasks left over"


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """OpenCV works with one thread, as in production and in the benchmarks."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


@pytest.fixture(scope="session")
def learnt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """State folder of a cell that calibrated both cameras and was taught x85."""
    return commission(tmp_path_factory.mktemp("commissioned"))
