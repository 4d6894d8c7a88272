"""The error that users are meant to read, and how it is raised."""

from __future__ import annotations

from collections.abc import Iterable, Mapping


class NlosError(ValueError):
    """Bad input, described in one sentence: what is wrong, where, and what would be right."""


def require(ok: bool, message: str) -> None:
    """Raise NlosError unless a condition holds."""
    if not ok:
        raise NlosError(message)


def instead(name: str, known: Iterable[str] | Mapping[str, str]) -> str:
    """Return what to say beside a name that does not exist: the nearest one that does, or all of them.

    Parameters
    ----------
    name : str
    known : iterable of str, or mapping of str to str
        Names that exist; of a mapping, each with the name to propose for it.
    """
    import difflib  # takes milliseconds to load, for what is seldom needed

    proposed = known if isinstance(known, Mapping) else {one: one for one in known}
    lower = {one.lower(): proposal for one, proposal in proposed.items()}
    if near := difflib.get_close_matches(name.lower(), lower, n=1):
        return f"did you mean {lower[near[0]]}?"
    return f"choose from {', '.join(dict.fromkeys(proposed.values()))}"
