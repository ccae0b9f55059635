"""Why a calibration step was refused. Each says in one sentence what was seen, with its figure, and what to do."""


class CalibrationError(Exception):
    """A calibration step cannot give a result to be trusted.

    `check` is the short name of the check that refused; `detail` is the evidence and the remedy.
    """

    def __init__(self, check: str, detail: str) -> None:
        super().__init__(f"{check}: {detail}")
        self.check = check
        self.detail = detail


class BoardNotFound(CalibrationError):
    """The dot board is not in the picture, or not as it should be.

    `seen` of `wanted` dots were found; `sides` names the sides of the picture over which the board leaves it.
    """

    def __init__(self, check: str, detail: str, *, seen: int = 0, wanted: int = 0, sides: tuple[str, ...] = ()) -> None:
        super().__init__(check, detail)
        self.seen = seen
        self.wanted = wanted
        self.sides = sides


class DegenerateMotion(CalibrationError):
    """The robot did not move enough, or not freely enough, to tell the unknowns apart."""


class PosesDisagree(CalibrationError):
    """No camera explains the pictures together with the robot's poses; `poses` are the indices to blame, if any."""

    def __init__(self, check: str, detail: str, *, poses: tuple[int, ...] = ()) -> None:
        super().__init__(check, detail)
        self.poses = poses


class PlanImpossible(CalibrationError):
    """No set of poses keeps the board in view, the arm in reach and the unknowns apart."""


class UnreadablePoses(CalibrationError):
    """A file of poses is not as it should be; `check` is file:line:column."""


class LensRefused(CalibrationError):
    """The pictures do not tell what the lens is like, or not this lens."""
