"""Throw broken input at both simulated robot controllers: no crash, no hang, no growth of memory, one reply per line.

`python -m tests.benchmarks.fuzz_robot` counts a million inputs (--inputs), half of them for each generation, prints a
table and writes build/bench-fuzz-robot.json. An input is a piece of what a client could send: mutilated commands,
programs and files, telnet commands, noise. The whole controller works on it, in a very fast world.
"""

import asyncio
import gc
import random
import sys
import time
from collections import Counter
from pathlib import Path

from simulators.robot import Bench, Options, RobotController
from simulators.robot.framing import ETX, Framer
from simulators.robot.session import Session
from tests.benchmarks.fuzz_run import resident_mib, run

OUT = Path("build/bench-fuzz-robot.json")
COUNTS = {"inputs": lambda r: r["inputs"], "replies": lambda r: r["replies"]}
TIDY_EVERY = 5000
EVERY = 50  # inputs, then the motions that they began go on
PROGRESS_S = 2.0
WORLD_SPEED = 1e6

LINES = (
    *("@MOVE P,P1,S=20,CONT", "@MOVE L,250.0 10.0 20.0 0.0 0.0 0.0 1,VEL=200", "@MOVE C,P1,P2"),
    *("@MOVEI P,1.0 2 3 4 5 6", "@MOVE P,P[SGI1+1],A3=0.0{10.0,5.0},S=50"),
    *("@MOVE P,260.0 0.0 10.0 0.0 0.0 0.0,Z=0.0", "@DRIVE(1,10.00),(2,P1),S=5", "@DRIVEI (3,1000)"),
    *("@PMOVE (0,5),S=20", "@JOGXY 1+", "@JOG X-", "@INCHXY 2-", "@INCH Z+", "@SERVO ON(1)", "@SERVO OFF"),
    *("@MOTOR ON", "@MOTOR PWR", "@ORIGIN", "@ABSRST", "@ALMRST", "@EMGRST", "@STOP", "@RESET", "@RUN T1"),
    *("@RUN <A>", "@LOAD <A>,T1", "@SWI <A>", "@WRITE <A>", "@WRITE PGM", "@WRITE PNT", "@WRITE P5"),
    *("@READ PNT", "@READ <A>", "@READ LOG", "@SEND PNT TO CMU", "NAME=A", "PGN=3", "", "*A:", "GOTO *A"),
    *("IF A%=1 THEN *A ELSE B%=2:C%=3", "FOR I%=1 TO 5 STEP 2", "NEXT I%", "WHILE DI(20)=0", "WEND"),
    *("SELECT CASE A%", "CASE 1,2", "END SELECT", "GOSUB *A", "RETURN", "HALT", "DELAY 10"),
    *("CALL *S(1,A%)", "CALL *S", "SUB *S(A%,B!)", "END SUB", "EXIT SUB", "SHARED A%", "ON ERROR GOTO *A"),
    *("ON ERROR GOTO 0", "RESUME NEXT", "RESUME *A", 'INPUT "n?",A%,T$,P5', "PRINT ERR,ERL", '5,"x",1 2 3 4 5 6'),
    *("@OUTPOS 5000", "@SERVO FREE(3)"),
    *("WAIT DI(20)=1,100", "WAIT ARM", 'PRINT "x"+T$', "DIM A%(3,4)", "A%(1,2)=5*(3-2)^2 MOD 7"),
    *("P100=P1+P[A%]", "LOC1(P5)=1.5", "@P1=250.0 0.0 0.0 0.0 0.0 0.0", "@P2=1000 2000 3000 4000 0 0", "@?P1"),
    *("@?LOC3(P1)", "@LOC2(P1)=9.5", "@?WHRXY", "@? WHERE", "@?MODE", "@?MOD", "@?ALM", "@?SERVO"),
    *("@?TSKMON T1", "@?DI2()", "@?DO2(3)", "@DO2(3)=1", "@DO(23,22)=3", "@SET DO(20)", "@ACCEL(1)=50"),
    *("@ASPEED 30", "@TOLE 80", "@WEIGHTG 1000", "@ARMTYP 1,1", "@RIGHTY", "@CHANGE H1", "@SHIFT S2"),
    *("@H1=30.0 50.0 10.0 R", "@S2=1.0 2.0 3.0 4.0", "@PDEF(0)=3,4,2", "@TEACH 5", "@TCHXY P6", "@AUTO"),
    *("@MANUAL", "@UNIT 1", "@ASGI0=&HFF", "@SGR1=2.5", "@?ASGI0*2+SGR1", "@?SIN(DEGRAD(30))", "@?5/0"),
    *("@ETHER ECHO 1", "@?VER", "@?MSG", "VER"),
)
WORDS = sorted({word for line in LINES for word in line.replace("@", "@ ").split()} | set("()[]{}<>,;:=+-*/^'\"?&$%!"))
NOISE = (b"\xff\xfd\x01", b"\xff\xfa\x18\x00", b"\xff\xff", b"\x16", b"\x1a", b"\0", b"\r", b"\n", b"\r\n", b"\xb1\xb2")


class Nobody:
    """A client's side of a line: counts what it is told."""

    can_hold = True

    def __init__(self):
        self.replies = 0

    def write(self, data):
        self.replies += data.count(b"\n")

    def hold(self, on):
        pass

    def hang_up(self):
        pass

    def drop(self):
        pass


def broken(rng):
    """One input."""
    line = bytearray(rng.choice(LINES).encode("latin-1"))
    kind = rng.random()
    if kind < 0.3:
        line[:] = " ".join(rng.choice(WORDS) for _ in range(rng.randrange(1, 9))).encode("latin-1")
    elif kind < 0.4:
        line[:] = rng.randbytes(rng.randrange(1, 120))
    for _ in range(rng.randrange(0, 4)):
        mutilate(rng, line)
    return bytes(line) + b"\r\n"


def mutilate(rng, line):
    """One accident."""
    at, kind = rng.randrange(len(line) + 1), rng.randrange(6)
    if kind == 0 and line:
        line[at % len(line)] ^= 1 << rng.randrange(8)
    elif kind == 1:
        del line[at : at + rng.randrange(1, 6)]
    elif kind == 2:
        line[at:at] = rng.choice(NOISE)
    elif kind == 3:
        line[at:at] = rng.choice(WORDS).encode("latin-1")
    elif kind == 4:
        line += line[at:]
    else:
        line[at:at] = str(rng.choice((0, -1, 255, 256, 99999, 1e9, 2**31, 1.5))).encode()


class Fuzz:
    """One controller under fire."""

    def __init__(self, dialect, seed):
        self.rng = random.Random(seed)
        self.bench = Bench(speed=WORLD_SPEED)
        self.controller = RobotController(self.bench, dialect=dialect, port=None, options=Options(servo_at_start=True))
        self.carrier = Nobody()
        self.session = Session(self.controller, self.carrier, kind="network")
        self.framer = Framer()
        self.crashes, self.slowest_ms, self.slowest = [], 0.0, b""
        self.inputs = 0

    async def run(self, inputs):
        """So many inputs; what goes wrong is kept."""
        await self.controller.start()
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: self._crashed(context.get("exception")))
        told = time.monotonic()
        gc.disable()
        for _ in range(inputs):
            await self._one(broken(self.rng))
            self.inputs += 1
            if self.inputs % EVERY == 0:
                await asyncio.sleep(0)
                if self.inputs % TIDY_EVERY == 0:
                    gc.collect()  # here, so that it is no input's fault
                if time.monotonic() - told > PROGRESS_S:
                    told = time.monotonic()
                    name = self.controller.machine.dialect.name
                    print(f"\r{name} {self.inputs:9,} of {inputs:,}", end="", file=sys.stderr)
        gc.enable()
        print("\r", end="", file=sys.stderr)
        await self.controller.close()

    async def _one(self, data):
        began = time.thread_time()
        try:
            for event in self.framer.feed(data):
                if isinstance(event, str):
                    await self.controller.desk.obey(self.session, event)
                elif event == ETX:
                    self.controller.control(self.session, event)
        except Exception as error:
            self._crashed(error, data)
        took_ms = (time.thread_time() - began) * 1e3
        if took_ms > self.slowest_ms:
            self.slowest_ms, self.slowest = took_ms, data

    def _crashed(self, error, data=b""):
        self.crashes.append(f"input {self.inputs}: {data!r}: {error!r}")


async def fuzzed(dialect, inputs, seed):
    """The figures of one generation."""
    fuzz = Fuzz(dialect, seed)
    warm = min(inputs // 10, 50_000)
    began = time.monotonic()
    await fuzz.run(warm)
    settled_mib = resident_mib()
    again = Fuzz(dialect, seed + 1)
    await again.run(inputs - warm)
    log = again.controller.log
    groups = Counter(entry.code.rcx3.partition(".")[0] for entry in log.of("refused"))
    return {
        "dialect": dialect,
        "inputs": fuzz.inputs + again.inputs,
        "replies": fuzz.carrier.replies + again.carrier.replies,
        "crashes": fuzz.crashes + again.crashes,
        "slowest_ms": round(max(fuzz.slowest_ms, again.slowest_ms), 2),
        "slowest_input": repr(max((fuzz, again), key=lambda each: each.slowest_ms).slowest),
        "growth_mib": round(resident_mib() - settled_mib, 1),
        "took_s": round(time.monotonic() - began, 1),
        "refused_by_group": dict(sorted(groups.items(), key=lambda item: int(item[0]))),
    }


if __name__ == "__main__":
    sys.exit(run(__doc__.partition("\n")[0], fuzzed, COUNTS, OUT))
