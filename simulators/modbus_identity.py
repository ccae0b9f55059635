"""Read Device Identification, function 43 / 14: who a Modbus server is. Pure.

Source: MODBUS Application Protocol V1.1b3, section 6.21.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from simulators.modbus_bank import ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, ILLEGAL_VALUE, ModbusError
from simulators.modbus_frames import LONGEST_PDU

ENCAPSULATED, READ_IDENTIFICATION = 43, 14
MANDATORY = (0, 1, 2)  # vendor, product code, revision
LAST_OBJECT_OF_CATEGORY = {1: 0x02, 2: 0x7F, 3: 0xFF}  # basic, regular, extended: a stream of objects
ONE_OBJECT = 4
CONFORMITY_LEVEL = 0x83  # extended, stream and individual access
ANSWER_HEAD = 7
LONGEST_OBJECT = LONGEST_PDU - ANSWER_HEAD - 2


@dataclass(frozen=True)
class Identity:
    """Objects by id: the mandatory three, 3..6 URL, product, model and application name, from 128 on one's own."""

    objects: Mapping[int, bytes]

    def __post_init__(self) -> None:
        if missing := [number for number in MANDATORY if number not in self.objects]:
            raise ValueError(f"an identity has objects 0, 1 and 2 (missing {missing})")
        for number, text in self.objects.items():
            if not 0 <= number <= 0xFF or len(text) > LONGEST_OBJECT:
                raise ValueError(f"object {number} has {len(text)} bytes; ids are 0..255, objects <= {LONGEST_OBJECT}")

    def answer(self, pdu: bytes) -> bytes:
        """To one request; struct.error when its length is wrong. Raises ModbusError."""
        if len(pdu) < 2 or pdu[1] != READ_IDENTIFICATION:
            raise ModbusError(ILLEGAL_FUNCTION)
        code, first = struct.unpack(">BB", pdu[2:])
        if code == ONE_OBJECT:
            if first not in self.objects:
                raise ModbusError(ILLEGAL_ADDRESS)
            return self._packed(code, [first])
        if code not in LAST_OBJECT_OF_CATEGORY:
            raise ModbusError(ILLEGAL_VALUE)
        last = LAST_OBJECT_OF_CATEGORY[code]
        start = first if first in self.objects and first <= last else 0  # an unknown one: from the beginning
        return self._packed(code, [number for number in sorted(self.objects) if start <= number <= last])

    def _packed(self, code: int, numbers: list[int]) -> bytes:
        """As many objects as an answer holds, and with which one to go on."""
        body, count = b"", 0
        for number in numbers:
            entry = bytes((number, len(self.objects[number]))) + self.objects[number]
            if ANSWER_HEAD + len(body) + len(entry) > LONGEST_PDU:
                break
            body += entry
            count += 1
        more, following = (0xFF, numbers[count]) if count < len(numbers) else (0, 0)
        head = (ENCAPSULATED, READ_IDENTIFICATION, code, CONFORMITY_LEVEL, more, following, count)
        return bytes(head) + body


ANONYMOUS = Identity({0: b"cellctl", 1: b"simulated server", 2: b"1.0"})
