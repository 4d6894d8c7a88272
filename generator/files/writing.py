"""Files that are written whole or not at all, and their hashes."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import os
import re
import socket
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from generator.model.errors import NlosError

HOST = re.sub(r"\W", "_", socket.gethostname())
"""Part of names of temporary files, since folders may be shared and process numbers are unique per machine only."""


def is_alive(pid: int) -> bool:
    """Whether a process of that number runs on this machine; True where that cannot be found out."""
    if os.name == "nt":  # where os.kill would end it
        return True
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        pass
    return True


def fingerprint(settings: Mapping[str, Any]) -> str:
    """Return a short hash of settings, which two sweeps that render the same picture have in common."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, read piece by piece."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield a temporary name in the folder of ``path``; on success flush the file to disk and rename it to ``path``.

    Raises
    ------
    NlosError
        The file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{HOST}-{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise NlosError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        with contextlib.suppress(OSError):  # gone with its folder, or on a disk that has become read-only
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file by temporary name and rename."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")
    # The rename itself is flushed too: a lost picture is rendered again, but without its manifest there is no set.
    with contextlib.suppress(OSError):  # not every system can open a folder
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as comma-separated text."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
