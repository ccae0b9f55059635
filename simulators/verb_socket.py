"""Verbs over a unix socket, for people and tests at a simulator: one JSON object a line, answered by one.

`{"do": "inject", "component": "robot", "fault": "lost_end"}` is answered by `{"ok": true, ...}` or `{"error": "..."}`.
"""

import asyncio
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

LONGEST_LINE = 1 << 20

Answer = dict[str, Any]
Verb = Callable[..., Answer | None]


class VerbSocket:
    """Serves one socket that only its owner may open."""

    def __init__(self, verbs: Mapping[str, Verb], path: Path) -> None:
        self._verbs, self._path = verbs, path

    async def start(self) -> None:
        """Listen."""
        self._path.unlink(missing_ok=True)
        self._server = await asyncio.start_unix_server(self._serve, self._path, limit=LONGEST_LINE)
        os.chmod(self._path, 0o600)

    async def close(self) -> None:
        """Stop listening."""
        self._server.close()
        self._path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await reader.readline():
                writer.write(json.dumps(self._answer(line), default=str).encode() + b"\n")
                await writer.drain()
        except (ConnectionError, ValueError):
            pass  # the other side went away, or sent a line without end
        finally:
            writer.close()

    def _answer(self, line: bytes) -> Answer:
        try:
            asked = json.loads(line)
            verb = self._verbs[asked.pop("do")]
            return {"ok": True, **(verb(**asked) or {})}
        except KeyError as error:
            return {"error": f"unknown: {error}; there are: {', '.join(self._verbs)}"}
        except (ValueError, TypeError, AttributeError) as error:
            return {"error": str(error)}
