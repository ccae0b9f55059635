"""Structured Text (IEC 61131-3): the portable subset that `deploy/plc/cell.st` is written in, checked and executed."""
