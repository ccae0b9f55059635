"""What can go wrong at the control socket, on the daemon's side."""


class ControlError(Exception):
    """The control socket cannot be offered; the text says why and what to do."""


class Declined(Exception):
    """A handler says no; the text goes to whoever asked."""
