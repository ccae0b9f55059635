"""What people ask of the daemon, and the work that follows from it.

Chosen recipe and run length are kept here. Recipe, calibrations and taught reference are read anew for every piece
of work, so an edited file counts from the next start on and never in the middle of a unit.
"""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

from cellctl.assembly.hand import Devices, Hand
from cellctl.assembly.sight import Sight
from cellctl.assembly.unit import Job
from cellctl.cell import Cell, Work
from cellctl.config import CellConfig
from cellctl.control.errors import Declined
from cellctl.control.events import Event, progress_event
from cellctl.control.plc_report import report
from cellctl.control.requests import (
    CalibrateRequest,
    CalibrationUseRequest,
    CommandRequest,
    DriftAnewRequest,
    HysteresisRequest,
    ModeRequest,
    PlcRequest,
    ProceedRequest,
    RecipeUseRequest,
    Request,
    StatusRequest,
    TeachRequest,
    TemperatureRequest,
    UnitsLeftRequest,
    VerifyRequest,
)
from cellctl.faults import CellError, NotReady
from cellctl.journal import Journal
from cellctl.learnt.calibrations import CameraCalibration, read_calibration
from cellctl.learnt.doubts import Temperature
from cellctl.learnt.references import now
from cellctl.learnt.standing import objections, standing_texts
from cellctl.learnt.taught import read_taught, taught_in_use
from cellctl.learnt.versions import accept, revert
from cellctl.log import log
from cellctl.machine import Command, Mode, State
from cellctl.monitoring.light_watch import LightWatch
from cellctl.monitoring.watch import Watch, begin_anew
from cellctl.pictures.writer import Pictures
from cellctl.procedures.calibrate import Calibration
from cellctl.procedures.hysteresis import HysteresisTest
from cellctl.procedures.teach import Teaching
from cellctl.procedures.verify import VerificationWork
from cellctl.production import Production
from cellctl.recipe import Recipe, list_recipes, load_recipe
from cellctl.strict_toml import SettingsError

PERSON_WITHIN_S = 3600.0
CHOSEN = "recipe-in-use"
CHANGES_ALLOWED = {State.STOPPED, State.IDLE, State.ABORTED, State.COMPLETE}


@dataclass
class Person:
    """Somebody at the cell who is asked to do something, and says `proceed`."""

    asked: str | None = None
    _done: asyncio.Event = field(default_factory=asyncio.Event)

    async def ask(self, job: str, publish: Callable[[Event], None], what: str, text: str) -> None:
        """Return when a person has done it. Raises NotReady when nobody does within the hour."""
        self.asked = text
        self._done.clear()
        log.info(f"please {text}, then: cellctl proceed")
        publish(progress_event(job, text, asks=what))
        try:
            async with asyncio.timeout(PERSON_WITHIN_S):
                await self._done.wait()
        except TimeoutError:
            raise NotReady(f"nobody did what was asked for: {text}") from None
        finally:
            self.asked = None

    def proceed(self) -> None:
        """Raises Declined when nothing was asked."""
        if self.asked is None:
            raise Declined("nothing was asked for; there is nothing to proceed with")
        self._done.set()


class Session:
    """Answers requests and makes work."""

    def __init__(self, config: CellConfig, devices: Devices, journal: Journal, pictures: Pictures) -> None:
        self._config = config
        self._devices = devices
        self._journal = journal
        self._pictures = pictures
        self._person = Person()
        self._units = 0
        self._chosen = _read_chosen(config)

    def attach(self, cell: Cell, publish: Callable[[Event], None]) -> None:
        """The cell to act on, and where events go."""
        self.cell = cell
        self._publish = publish

    async def handle(self, request: Request) -> Mapping[str, object]:
        """Answer one request. Raises Declined or NotAllowed."""
        match request:
            case StatusRequest():
                return {**self.status(), **await self._standing()}
            case PlcRequest():
                return report(self._devices.plc.seen(), request.packets)
            case CalibrationUseRequest():
                return await self._use_calibration(request)
            case DriftAnewRequest():
                await self._drift_anew()
            case TemperatureRequest():
                await asyncio.to_thread(_enter_temperature, self._config, request.celsius)
            case _:
                self._act(request)
        return self.status()

    def _act(self, request: Request) -> None:
        """What is done at once, without the disk."""
        match request:
            case CommandRequest():
                self.command(request.command)
            case ModeRequest():
                self.cell.set_mode(request.mode)
            case RecipeUseRequest():
                self._use(request.name)
            case UnitsLeftRequest():
                self._units = request.count
            case ProceedRequest():
                self._person.proceed()
            case CalibrateRequest() | TeachRequest() | VerifyRequest() | HysteresisRequest():
                self._maintain(request)

    def status(self) -> dict[str, object]:
        """Machine, recipe, and what a person is asked for."""
        return {**self.cell.status(), "recipe": self._chosen, "asks": self._person.asked}

    async def _standing(self) -> dict[str, str]:
        """Calibrations and golden assembly: in use since when, or why not. From the disk, so not for every request."""
        try:
            recipe = self._recipe()[1] if self._chosen else None
        except Declined as error:
            return {"golden assembly": str(error)}
        return await asyncio.to_thread(standing_texts, self._config, recipe)

    async def stale(self) -> list[str]:
        """What a person should know of calibrations and golden assembly before starting."""
        try:
            recipe = self._recipe()[1] if self._chosen else None
        except Declined as error:
            return [str(error)]
        return await asyncio.to_thread(objections, self._config, recipe)

    async def _use_calibration(self, request: CalibrationUseRequest) -> Mapping[str, object]:
        """Accept or revert, at rest only. The reply says what follows from it."""
        if self.cell.state not in CHANGES_ALLOWED:
            raise Declined(f"a calibration cannot change in {self.cell.state.title}; stop the cell first")
        state = self._config.paths.state
        try:
            if request.what == "revert":
                used = await asyncio.to_thread(revert, state, request.camera)
            else:
                used = await asyncio.to_thread(accept, state, request.camera, request.calibration)
        except CellError as error:
            raise Declined(str(error)) from error
        log.info(f"{request.camera}: calibration {used.id} of {used.made} is in use from the next start on")
        return {"camera": request.camera, "in use": used.id, "made": used.made, **await self._standing()}

    async def _drift_anew(self) -> None:
        """Forget the drift, at rest only: production keeps it in mind."""
        if self.cell.state not in CHANGES_ALLOWED:
            raise Declined(f"the drift is watched in {self.cell.state.title}; stop the cell first")
        _, recipe = self._recipe()
        try:
            taught = await asyncio.to_thread(taught_in_use, self._config, recipe)
            await asyncio.to_thread(begin_anew, self._config.paths.state, taught.id)
        except CellError as error:
            raise Declined(str(error)) from error
        log.info(f"drift of {recipe.model} is watched anew from the next start on")

    def command(self, command: Command, why: str = "") -> None:
        """By the socket or by a button. Raises Declined or NotAllowed."""
        if command is Command.START and self.cell.state is State.IDLE:
            self._recipe()  # a recipe that cannot be read is refused here, not in the middle of starting
            self.cell.set_mode(Mode.PRODUCTION)
            self.cell.make_work = self._production
        self.cell.command(command, why)

    def _maintain(self, request: CalibrateRequest | TeachRequest | VerifyRequest | HysteresisRequest) -> None:
        if self.cell.state is not State.IDLE:
            raise Declined(f"this is possible in Idle only, the cell is in {self.cell.state.title}; reset it first")
        self._recipe()
        self.cell.set_mode(Mode.MAINTENANCE)
        self.cell.make_work = partial(self._maintenance, request)
        self.cell.command(Command.START)

    def _use(self, name: str) -> None:
        if self.cell.state not in CHANGES_ALLOWED:
            raise Declined(f"the recipe cannot change in {self.cell.state.title}; stop the cell first")
        _load(self._config, name)
        self._chosen = name
        path = self._config.paths.state / CHOSEN
        path.write_text(name + "\n", encoding="ascii")

    # -- work --------------------------------------------------------------------------------------------------

    def _production(self) -> Work:
        name, recipe = self._recipe()
        calibrations = self._calibrations()
        taught = read_taught(self._config, recipe, calibrations)
        job = Job(
            config=self._config,
            name=name,
            recipe=recipe,
            calibrations=calibrations,
            taught=taught,
            hand=self._hand(recipe),
            sight=self._sight(recipe, calibrations),
            journal=self._journal,
            watch=Watch.resumed(self._config.paths.state, recipe, taught.id),
            light=LightWatch.resumed(self._config.paths.state, recipe, taught.id),
        )
        return Production(job, self._publish, self._units, self.cell.count)

    def _maintenance(self, request: CalibrateRequest | TeachRequest | VerifyRequest | HysteresisRequest) -> Work:
        """The job that was asked for."""
        config, (_, recipe), publish = self._config, self._recipe(), self._publish
        match request:
            case TeachRequest():
                return self._teaching(request.repeats, request.pairs)
            case VerifyRequest():
                return VerificationWork(config, request.camera, recipe, self._hand(recipe), publish)
            case HysteresisRequest():
                return HysteresisTest(config, recipe, self._hand(recipe), request.repeats, publish)
        return Calibration(config, request.what, recipe, self._hand(recipe), publish)

    def _teaching(self, repeats: int, pairs: int) -> Work:
        name, recipe = self._recipe()
        calibrations = self._calibrations()
        return Teaching(
            config=self._config,
            name=name,
            recipe=recipe,
            calibrations=calibrations,
            hand=self._hand(recipe),
            sight=self._sight(recipe, calibrations),
            repeats=repeats,
            pairs=pairs,
            ask=partial(self._person.ask, "teach", self._publish),
            publish=self._publish,
        )

    def _hand(self, recipe: Recipe) -> Hand:
        return Hand(self._devices, self._config.positions, recipe.motion, recipe.pick, recipe.place)

    def _sight(self, recipe: Recipe, calibrations: tuple[CameraCalibration, CameraCalibration]) -> Sight:
        first, second = calibrations
        return Sight(first.plane, second.plane, recipe, self._pictures)

    def _calibrations(self) -> tuple[CameraCalibration, CameraCalibration]:
        return read_calibration(self._config, "camera-1"), read_calibration(self._config, "camera-2")

    def _recipe(self) -> tuple[str, Recipe]:
        if self._chosen is None:
            names = ", ".join(list_recipes(self._config.paths.recipes)) or "none yet"
            raise Declined(f"no recipe is chosen; choose one with `cellctl recipe use NAME` (there are: {names})")
        return self._chosen, _load(self._config, self._chosen)


def _load(config: CellConfig, name: str) -> Recipe:
    try:
        return load_recipe(config.paths.recipes, name)
    except SettingsError as error:
        raise Declined("; ".join(error.lines)) from error


def _enter_temperature(config: CellConfig, celsius: float) -> None:
    Temperature(made_at=now(), celsius=celsius).save(Temperature.path(config.paths.state))


def _read_chosen(config: CellConfig) -> str | None:
    try:
        return (config.paths.state / CHOSEN).read_text(encoding="ascii").strip() or None
    except (OSError, UnicodeDecodeError):
        return None
