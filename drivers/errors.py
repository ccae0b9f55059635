"""What can go wrong on a wire, by cause. Every exception names the device, and says in one sentence what was seen.

`cellctl/faults.py` has a row for each class here; a test walks the subclasses.
"""


class DeviceError(Exception):
    """A device did not do what was asked.

    `device` is the name the operator knows ("plc", "robot", "camera 1"); `detail` is the evidence.
    """

    def __init__(self, device: str, detail: str) -> None:
        super().__init__(f"{device}: {detail}")
        self.device = device
        self.detail = detail


class LinkLost(DeviceError):
    """There is no connection, or it broke."""


class NoAnswer(DeviceError):
    """The device is connected but did not answer, or did not finish, within its deadline."""


class Garbled(DeviceError):
    """The device sent something that its protocol does not allow."""


class Refused(DeviceError):
    """The device understood and said no. `code` is the device's own code ("6.301", "exception 2")."""

    def __init__(self, device: str, code: str, detail: str) -> None:
        super().__init__(device, f"{detail} (code {code})")
        self.code = code


class Collision(Refused):
    """The arm was stopped by something: overload, or away from where it should be."""


class Disturbed(DeviceError):
    """Something that only we should move was moved by somebody else."""


class Mismatch(DeviceError):
    """This is not the device, the version or the session that the configuration names."""


class FrameLost(DeviceError):
    """A picture was taken but did not arrive whole; it may be asked for again while nothing moves."""


class Unavailable(DeviceError):
    """Software that this driver needs is not installed; the detail names the package."""
