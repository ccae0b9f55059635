"""The least that a PLC must do to keep the register contract, in the memory of any server. Imports nothing.

It belongs to the foreign servers, so it shares no code with the driver or the simulated PLC.
"""

PHOTO, VACUUM_REACHED, CLAMPED, BATTERY = 1, 2, 4, 8
READY, ALL_SAFE = 1, 0xF
SUCKING = 0x10000 - 700  # -70.0 kPa


def scan(words):
    """One PLC cycle on registers 0..131."""
    words[100] = (words[100] + 1) & 0xFFFF
    words[101], words[102], words[103], words[104] = 0x0100, words[1], READY, ALL_SAFE
    if words[3] != words[107]:
        _obey(words, words[4])
        words[107] = words[108] = words[3]
    sucking = words[6] & 1
    words[105] = (words[105] & ~VACUUM_REACHED) | BATTERY | (VACUUM_REACHED if sucking else 0)
    words[115] = SUCKING if sucking else 0
    words[116], words[117] = 100, 1


def _obey(words, command):
    if command == 1:
        words[110] = (words[110] + 1) & 0xFFFF
        words[113] = 500 + words[110]
        words[105] |= PHOTO | CLAMPED
    elif command in (2, 3):
        words[105] &= ~(PHOTO | CLAMPED)
    words[109] = 0 if command in (1, 2, 3, 4, 5) else 2
