"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

__all__ = ["write_whole"]


def write_whole(path: str | os.PathLike[str], data: bytes) -> None:
    """Write ``data`` to a temporary file beside ``path``, then rename it; nothing is left on failure."""
    path = Path(path)
    part = path.parent / f".{secrets.token_hex(8)}.part"
    try:
        with open(part, "xb") as file:  # made with the permissions that the user's umask gives
            file.write(data)
        os.replace(part, path)
    except BaseException:  # an interruption too
        part.unlink(missing_ok=True)
        raise
