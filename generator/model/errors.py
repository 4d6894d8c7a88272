"""The error that users are meant to read, and how it is raised."""

from __future__ import annotations


class NlosError(ValueError):
    """Bad input, described in one sentence: what is wrong, where, and what would be right."""


def require(ok: bool, message: str) -> None:
    """Raise NlosError unless a condition holds."""
    if not ok:
        raise NlosError(message)
