"""Kinds of values in cell.toml: addresses, serial numbers, paths."""

import ipaddress
import os
import re
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, ValidationInfo


def ipv4(text: str) -> str:
    """The same text. Raises ValueError when it is not the address of one device."""
    try:
        address = ipaddress.IPv4Address(text)
    except ValueError:
        raise ValueError("must be an IPv4 address such as 192.168.10.10; names are not looked up") from None
    if address.is_unspecified or address.is_multicast or address.is_reserved:
        raise ValueError("must be the IPv4 address of one device")
    return text


def _below_the_file(text: object, info: ValidationInfo) -> object:
    """Relative paths count from the folder of the file that names them."""
    if not isinstance(text, str):
        return text
    if not text or "\0" in text:
        raise ValueError("must be a path")
    folder = (info.context or {}).get("folder")
    return Path(os.path.normpath(Path(folder, text))) if folder else Path(text)


def _serial(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,16}", text):
        raise ValueError("must be the serial number on the label: up to 16 of A-Z a-z 0-9 . _ -")
    return text


Ipv4 = Annotated[str, AfterValidator(ipv4)]
FilePath = Annotated[Path, BeforeValidator(_below_the_file)]
Serial = Annotated[str, AfterValidator(_serial)]
