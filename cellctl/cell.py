"""Acts on the machine's states: starts, ends and cancels work, watches safety, turns a fault into a command.

`machine.py` says which state follows; here is what is done in it. One act per acting state; work (production,
calibration, teaching) is a task of its own, begun in Execute. Stop, Hold and Suspend let a unit in progress end;
Abort cancels whatever runs, and the drivers leave the robot standing.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine
from functools import partial
from typing import Any, Protocol

from cellctl.assembly.hand import COMMAND_WITHIN_S, Devices, lift_free
from cellctl.config import CellConfig
from cellctl.control.events import Event, state_event
from cellctl.faults import CellError, NotReady, Reaction, SafetyLost, fault_for, sentence
from cellctl.learnt.doubts import raise_doubt
from cellctl.log import log
from cellctl.machine import (
    ACTING,
    SC,
    Command,
    Mode,
    NotAllowed,
    State,
    after,
    commands_allowed,
    mode_after,
)
from drivers.errors import Collision, DeviceError

ENDING_WITHIN_S = 25.0  # the service has 30 s to stop
READY_WITHIN_S = 3.0
TICK_S = 0.2
AT_REST = {State.STOPPED, State.ABORTED, State.ABORTING, State.CLEARING}
ENDING = {State.STOPPING, State.HOLDING, State.SUSPENDING, State.COMPLETING}
REACTIONS = {Reaction.SUSPEND: Command.SUSPEND, Reaction.HOLD: Command.HOLD}
GREEN = {State.STARTING, State.EXECUTE, State.UNHOLDING, State.UNSUSPENDING, State.COMPLETING}
RED = {State.ABORTING, State.ABORTED}


class Work(Protocol):
    """What is done in Execute."""

    ends_with_its_unit: bool  # Stop waits for the unit in progress; other work is cancelled

    @property
    def text(self) -> str:
        """What it does, for people."""

    async def run(self, keep_on: Callable[[], bool]) -> None:
        """Do it, as long as keep_on()."""


class Cell:
    """The machine and its devices."""

    def __init__(self, config: CellConfig, devices: Devices, publish: Callable[[Event], None]) -> None:
        self.config = config
        self.devices = devices
        self.state = State.ABORTED
        self.mode = Mode.PRODUCTION
        self.message = "not started yet"
        self.turns = 0  # for the watchdog: how often the main loop came round
        self.good = self.rejected = 0
        self.make_work: Callable[[], Work] | None = None
        self._publish = publish
        self._work: Work | None = None
        self._task: asyncio.Task[None] | None = None
        self._changed = asyncio.Event()
        self._doubt: tuple[str, bool] | None = None  # why the calibrations are to be verified, and whether they must be
        self._acts: dict[State, Callable[[], Awaitable[None]]] = {
            State.CLEARING: self._clear,
            State.RESETTING: self._reset,
            State.STARTING: self._begin,
            State.UNHOLDING: self._begin,
            State.UNSUSPENDING: self._begin,
            State.EXECUTE: self._execute,
            State.STOPPING: self._end_work,
            State.HOLDING: self._end_work,
            State.SUSPENDING: self._end_work,
            State.COMPLETING: self._end_work,
            State.ABORTING: self._abort,
        }
        assert set(self._acts) == ACTING

    # -- asked from outside ------------------------------------------------------------------------------------

    def command(self, command: Command, why: str = "") -> None:
        """Raises NotAllowed when the state does not know this command."""
        state = after(self.state, command)
        if command is Command.START and self.make_work is None:
            raise NotAllowed("start: nothing to do; choose a recipe with `cellctl recipe use NAME`")
        self._enter(state, why or f"{command.title} by command")

    def set_mode(self, mode: Mode) -> None:
        """Raises NotAllowed unless the cell is at rest."""
        self.mode = mode_after(self.state, self.mode, mode)

    def status(self) -> dict[str, Any]:
        """What there is to know, for people and machines."""
        return {
            "cell": self.config.name,
            "state": self.state.title,
            "state_number": int(self.state),
            "mode": self.mode.title,
            "message": self.message,
            "work": self._work.text if self._work else None,
            "good": self.good,
            "rejected": self.rejected,
            "allowed": [command.title for command in commands_allowed(self.state)],
        }

    def count(self, good: bool) -> None:
        """A unit has ended; for the PLC's display."""
        self.good += good
        self.rejected += not good

    async def until_rest(self) -> None:
        """Return when the machine is in a state that waits."""
        while self.state in ACTING:
            await self._change()

    # -- the main loop -----------------------------------------------------------------------------------------

    async def start_up(self, *, clean: bool) -> None:
        """Check the devices. Stopped after a clean stop, else Aborted: then a person decides with Clear."""
        try:
            await self._open_devices()
        except (CellError, DeviceError) as error:
            self._fail(error, State.ABORTED)
            return
        if clean:
            self._enter(State.STOPPED, "devices checked")
        else:
            self._enter(State.ABORTED, "the last run did not end cleanly: look into the cell, then clear and reset")
            self._doubt = ("the last run did not end cleanly, perhaps in motion", False)
            await self._raise_doubt()

    async def run(self) -> None:
        """Act on the states, for ever."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._watch_safety())
            group.create_task(self._show())
            while True:
                await self._act_once()

    async def shut_down(self) -> None:
        """End the unit in progress and come to rest, the arm standing."""
        if self.state not in AT_REST | {State.STOPPING}:
            with contextlib.suppress(NotAllowed):
                self.command(Command.STOP, "the service is stopped")
        try:
            async with asyncio.timeout(ENDING_WITHIN_S):
                await self.until_rest()
        except TimeoutError:
            log.error("the unit in progress did not end in time")
        await self._cancel_work()

    async def _act_once(self) -> None:
        """One state: do its act, or wait for the next one. Every wait in an act has a deadline of its own."""
        state = self.state
        act = self._acts.get(state, self._wait)
        task = asyncio.ensure_future(act())
        changed = asyncio.ensure_future(self._change())
        try:
            while not task.done() and not changed.done():
                self.turns += 1
                await asyncio.wait([task, changed], timeout=TICK_S, return_when=asyncio.FIRST_COMPLETED)
        finally:
            await self._ended(changed)
            await self._ended(task)
        self._judge(state, task)

    async def _wait(self) -> None:
        """The states that do not act."""
        await self._change()

    def _judge(self, state: State, task: "asyncio.Future[None]") -> None:
        """What follows from the end of an act."""
        error = None if task.cancelled() else task.exception()
        if error is not None:
            if not isinstance(error, Exception):
                raise error
            self._fault(error)
        elif self.state is state and state in ACTING and not task.cancelled():
            keeps_its_reason = state in ENDING | {State.ABORTING}
            self._enter(after(state, SC), self.message if keeps_its_reason else f"{state.title} is done")

    def _fault(self, error: Exception) -> None:
        """The faults table decides the command; a fault on the way out aborts."""
        if fault_for(error).code == "X1":
            log.error("software error", exc_info=error)
        if isinstance(error, Collision):
            self._doubt = (str(error), True)
        command = REACTIONS.get(fault_for(error).reaction, Command.ABORT)
        if command not in commands_allowed(self.state):
            command = Command.ABORT
        if command in commands_allowed(self.state):
            self._fail(error, after(self.state, command))
        elif self.state is State.ABORTING:
            self._fail(error, State.ABORTED)

    def _fail(self, error: Exception, state: State) -> None:
        text = sentence(error)
        log.error(text, fault=fault_for(error).code)
        self._enter(state, text)

    def _enter(self, state: State, why: str) -> None:
        if state is State.ABORTING and self._doubt is None and self._moves():
            self._doubt = (f"aborted in motion: {why}", False)
        self.state, self.message = state, why
        self._changed.set()
        self._changed = asyncio.Event()
        log.info(f"state {state.title}", why=why, state_number=int(state))
        self._publish(state_event(state.title, int(state), self.mode.title, why))

    def _change(self) -> Coroutine[Any, Any, object]:
        """The next change counted from this call, not from the first step of whoever awaits it."""
        return self._changed.wait()

    @staticmethod
    async def _ended(task: "asyncio.Future[Any]") -> None:
        """Cancel if still running, and wait until it is gone."""
        task.cancel()
        await asyncio.wait([task])

    # -- what is done in the states ----------------------------------------------------------------------------

    async def _clear(self) -> None:
        """A person has looked into the cell: open everything anew, clear latches and alarms."""
        await self._open_devices()
        plc = self.devices.plc
        await plc.reset_latches(within_s=COMMAND_WITHIN_S)
        image = plc.image
        if not (image.estop_healthy and image.guard_closed and image.air_ok):
            raise SafetyLost("emergency stop, guard or air is still not healthy")
        await self.devices.robot.reset_alarm()

    async def _reset(self) -> None:
        """Power on and lift the arm free."""
        robot = self.devices.robot
        await robot.power_on()
        status = await robot.status()
        if not status.ready:
            raise NotReady(f"robot: {status.why_not_ready}")
        await lift_free(robot, self.config.positions.safe_z_mm)

    async def _begin(self) -> None:
        """Make the work that Execute will run: reads recipe, calibrations and taught reference anew."""
        if self.make_work is None:
            raise NotReady("nothing to do: choose a recipe with `cellctl recipe use NAME`")
        await lift_free(self.devices.robot, self.config.positions.safe_z_mm)
        self._work = self.make_work()

    async def _execute(self) -> None:
        """Run the work; when the state changes first, the ending states decide about it."""
        assert self._work is not None
        if self._task is None:
            self._task = asyncio.create_task(self._work.run(lambda: self.state is State.EXECUTE))
        try:
            await asyncio.shield(self._task)
        finally:
            if self._task.done():  # else the next state decides about it
                self._task = None

    async def _end_work(self) -> None:
        """Let the unit in progress end; other work is cancelled. The arm stands afterwards."""
        if self._task is not None and self._work is not None and self._work.ends_with_its_unit:
            async with asyncio.timeout(ENDING_WITHIN_S):
                await asyncio.wait([self._task])
        await self._cancel_work()

    async def _abort(self) -> None:
        """Stop everything: cancelled moves halt the arm; vacuum is kept, what hangs on the cup must not fall."""
        if self._task is not None:
            self._task.cancel()
        with contextlib.suppress(DeviceError):
            await self.devices.robot.halt()  # at once: a cancelled move waits until the arm stands
        await self._cancel_work()
        with contextlib.suppress(DeviceError):
            await self.devices.plc.stop_conveyor(within_s=COMMAND_WITHIN_S)
        await self._raise_doubt()

    def _moves(self) -> bool:
        """The arm is on its way for us, or was when something stopped it."""
        return self.devices.robot.unfinished and (self._task is not None or self.state in ACTING)

    async def _raise_doubt(self) -> None:
        """Calibrations made before a collision or a broken motion are to be verified."""
        doubt, self._doubt = self._doubt, None
        if doubt is not None:
            why, grave = doubt
            await asyncio.to_thread(partial(raise_doubt, self.config.paths.state, why, grave=grave))
            log.warning(f"the calibrations are to be verified: {why}; `cellctl calibrate verify camera-1`, camera-2")

    async def _cancel_work(self) -> None:
        """Work that is still running is cancelled; why it ended is in the log."""
        task, self._task = self._task, None
        if task is not None:
            await self._ended(task)
            if not task.cancelled() and (error := task.exception()) is not None:
                log.error(sentence(error), fault=fault_for(error).code)

    async def _open_devices(self) -> None:
        """Connect to everything anew, so that nothing is remembered from before a fault."""
        devices = self.devices
        await devices.plc.ready(within_s=READY_WITHIN_S)
        for device in (devices.robot, devices.camera_1, devices.camera_2):
            await device.close()
            await device.open()

    # -- beside the states -------------------------------------------------------------------------------------

    async def _watch_safety(self) -> None:
        """Abort as soon as safety is or was lost while the cell is not at rest."""
        while True:
            if self.state in AT_REST:
                await self._change()
                continue
            unsafe: asyncio.Future[str] = asyncio.ensure_future(self.devices.plc.unsafe())
            changed = asyncio.ensure_future(self._change())
            try:
                both: list[asyncio.Future[Any]] = [unsafe, changed]
                await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
                if unsafe.done() and self.state not in AT_REST:
                    self._fault(self._lost(unsafe.result()))
            finally:
                await self._ended(unsafe)
                await self._ended(changed)

    def _lost(self, why: str) -> Exception:
        """What ended the watch: the PLC that can no longer be seen, or safety itself."""
        try:
            _ = self.devices.plc.image
        except DeviceError as error:
            return error
        return SafetyLost(why)

    async def _show(self) -> None:
        """Machine state, counts and signal tower for the PLC."""
        while True:
            self.devices.plc.show(
                machine_state=int(self.state),
                good=self.good & 0xFFFF,
                rejected=self.rejected & 0xFFFF,
                red=self.state in RED,
                amber=self.state not in RED | GREEN,
                green=self.state in GREEN,
                buzzer=self.state in {State.HELD, State.ABORTED},
            )
            await self._change()
