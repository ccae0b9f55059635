"""The driver on a line that splits, merges, delays, doubles and corrupts bytes: it may give up, it never believes."""

import asyncio
import random
from contextlib import asynccontextmanager

import pytest

import drivers.conversation
import drivers.rcx2
import drivers.robot_motion
from drivers.errors import DeviceError
from drivers.reach import Limits
from drivers.robot import Point, Robot
from tests.robot_bench import controller_on
from tests.robot_log import moves_heard

PLACES = [Point(260, 20, 10, 5), Point(250, 100, 30, 45), Point(220, -90, 0, -30)]


@pytest.fixture(autouse=True)
def brisk(monkeypatch):
    for name, patience_s in (("ANSWER_S", 0.2), ("STOP_S", 0.4), ("SILENCE_S", 0.05)):
        monkeypatch.setattr(drivers.conversation, name, patience_s)
    for name, patience_s in (("SLACK_S", 0.2), ("SETTLE_S", 0.05), ("STAND_S", 0.5)):
        monkeypatch.setattr(drivers.robot_motion, name, patience_s)
    monkeypatch.setattr(drivers.rcx2.Rcx2, "greeting_s", 0.05)


class Splitting:
    """Every byte by itself."""

    async def carry(self, data, write):
        for k in range(len(data)):
            write(data[k : k + 1])
            await asyncio.sleep(0)


class Merging:
    """What comes within 10 ms comes together."""

    async def carry(self, data, write):
        await asyncio.sleep(0.01)
        write(data)


class Delaying:
    """Each piece up to 30 ms late, the order kept."""

    def __init__(self):
        self.rng = random.Random(1)

    async def carry(self, data, write):
        await asyncio.sleep(self.rng.random() * 0.03)
        write(data)


class Doubling:
    """Now and then a piece comes twice."""

    def __init__(self):
        self.rng = random.Random(2)

    async def carry(self, data, write):
        write(data * (2 if self.rng.random() < 0.1 else 1))


class Corrupting:
    """Now and then a byte is another letter; never a digit, which nobody could tell from the truth."""

    def __init__(self):
        self.rng = random.Random(3)

    async def carry(self, data, write):
        spoilt = bytearray(data)
        if self.rng.random() < 0.05:
            spoilt[self.rng.randrange(len(spoilt))] = self.rng.choice(b"#~\xb1xQ")
        write(bytes(spoilt))


class Losing:
    """Now and then a piece does not come."""

    def __init__(self):
        self.rng = random.Random(4)

    async def carry(self, data, write):
        if self.rng.random() > 0.06:
            write(data)


@asynccontextmanager
async def proxy(port, toward_robot, toward_driver):
    """A TCP line between driver and controller; yields its address."""
    lines = []

    async def pump(reader, writer, way):
        try:
            while data := await reader.read(4096):
                await way.carry(data, writer.write)
        except OSError:
            pass
        finally:
            writer.close()

    async def serve(reader, writer):
        there_reader, there_writer = await asyncio.open_connection("127.0.0.1", port)
        both = [pump(reader, there_writer, toward_robot), pump(there_reader, writer, toward_driver)]
        lines.extend(asyncio.create_task(one) for one in both)

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
        yield f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    for line in lines:
        line.cancel()
    if lines:
        await asyncio.wait(lines)


@asynccontextmanager
async def robot_over(dialect, toward_robot, toward_driver, speed=20):
    async with controller_on(speed, dialect=dialect, servo_at_start=True) as (bench, controller):
        bench.controller = controller
        async with proxy(controller.port, toward_robot, toward_driver) as address:
            robot = Robot(address, limits=Limits(), dialect=dialect)
            try:
                yield bench, robot
            finally:
                await robot.close()


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
@pytest.mark.parametrize("way", [Splitting, Merging, Delaying])
async def test_how_bytes_arrive_changes_nothing(dialect, way, monkeypatch):
    monkeypatch.setattr(drivers.conversation, "ANSWER_S", 1.0)
    async with robot_over(dialect, way(), way(), speed=5) as (bench, robot):  # a busy computer is not a late robot
        await robot.open()
        for place in PLACES:
            assert await robot.move(place, speed_pct=100) == pytest.approx(place, abs=0.0051)
            assert bench.position() == pytest.approx(place, abs=0.0051)
        assert (await robot.status()).ready
    assert len(moves_heard(bench.controller.log)) == len(PLACES)


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
@pytest.mark.parametrize("way", [Doubling, Corrupting, Losing])
async def test_a_bad_line_makes_the_driver_give_up_but_never_believe(dialect, way):
    done = given_up = 0
    async with robot_over(dialect, Merging(), way()) as (bench, robot):
        for place in PLACES * 20:
            try:
                if not robot.is_open:
                    await robot.open()
                here = await robot.move(place, speed_pct=100)
            except DeviceError:
                given_up += 1
                continue
            done += 1
            assert here == pytest.approx(place, abs=0.02)
            assert bench.position() == pytest.approx(place, abs=0.02)
            if done > 1 and given_up > 1:
                break
    assert done > 0
    assert given_up > 0


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
async def test_a_spoilt_command_is_refused_or_moves_to_where_the_driver_sees_that_it_is_wrong(dialect):
    async with robot_over(dialect, Corrupting(), Merging()) as (bench, robot):
        for place in PLACES * 4:
            try:
                if not robot.is_open:
                    await robot.open()
                await robot.move(place, speed_pct=100)
            except DeviceError:
                continue
            assert bench.position() == pytest.approx(place, abs=0.02)
