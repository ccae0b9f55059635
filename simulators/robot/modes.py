"""The modes of operation of both generations."""

from enum import Enum


class Mode(Enum):
    """Who may do what."""

    AUTO = "AUTO"  # programs and clients
    HELD = "HELD"  # automatic, the control right held by the pendant
    MANUAL = "MANUAL"  # the person with the pendant
    PROGRAM = "PROGRAM"  # editing, an older generation's
    SYSTEM = "SYSTEM"  # settings, an older generation's
    RESTRICTED = "RESTRICTED"
