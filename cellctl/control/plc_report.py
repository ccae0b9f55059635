"""The PLC's register map as data: what the daemon answers to `plc`, and what `cellctl plc watch` shows."""

from drivers.plc_tags import Seen, values


def report(seen: Seen, packets: int) -> dict[str, object]:
    """Every value with its ages in ms, what is wrong with the link ("" = nothing), and so many of the last packets."""
    newest = seen.packets[-packets:] if packets else ()
    return {
        "trouble": seen.trouble,
        "values": [
            {
                "address": value.address,
                "name": value.name,
                "value": value.value,
                "unit": value.unit,
                "text": value.text,
                "age_ms": round(value.age_s * 1000),
                "unchanged_ms": round(value.unchanged_s * 1000),
            }
            for value in values(seen)
        ],
        "packets": [{"at_s": round(packet.at_s, 6), "text": str(packet)} for packet in newest],
    }
