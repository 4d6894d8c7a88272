"""The error that users are meant to read, and how it is raised."""

from __future__ import annotations


class NlosError(ValueError):
    """Bad input, told in one sentence: what is wrong, where, and what would be right."""


def require(ok: bool, message: str) -> None:
    """Raise NlosError unless something holds."""
    if not ok:
        raise NlosError(message)
