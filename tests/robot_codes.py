"""The table of the controllers' codes in drivers/README.md: `python -m tests.robot_codes` prints it."""

from drivers.rcx_codes import RCX2, RCX3

HEAD = ("| RCX340 | RCX240 | meaning |", "|---|---|---|")


def table() -> str:
    """One row per meaning, in the order of the newer codes, then what only the older generation has."""
    rows: dict[str, tuple[list[str], list[str]]] = {}
    for generation, codes in enumerate((RCX3, RCX2)):
        for (group, number), words in sorted(codes.items()):
            rows.setdefault(words, ([], []))[generation].append(f"{group}.{number}")
    lines = [f"| {', '.join(newer)} | {', '.join(older)} | {words} |" for words, (newer, older) in rows.items()]
    return "\n".join([*HEAD, *lines])


if __name__ == "__main__":
    print(table())
