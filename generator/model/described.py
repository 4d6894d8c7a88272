"""Figures that are described once: default, help and range, for the command line, Blender's panels and docstrings."""

from __future__ import annotations

from dataclasses import MISSING, field, fields
from typing import Any, TypeVar

from generator.model.errors import require

Kind = TypeVar("Kind", bound=type)


def described(words: str, default: Any = MISSING, *, lo: Any = None, hi: Any = None) -> Any:
    """Return a field of a dataclass with a description.

    Parameters
    ----------
    words : str
        What it is, with its unit; without a capital or a full stop, as help texts are.
    default
        Of the field, if it has one.
    lo, hi : optional
        The least and the largest value, as `check_ranges` demands of it, or of each of its components.
    """
    return field(default=default, metadata={"words": words, "lo": lo, "hi": hi})


def borrowed(kind: type, name: str) -> Any:
    """Return a field like that of another dataclass."""
    one = _of(kind, name)
    return field(default=one.default, metadata=one.metadata)


def documented(kind: Kind) -> Kind:
    """Add to a dataclass's docstring what its fields' descriptions say. To be applied after `dataclass`."""
    rows = [f"{f.name} : {f.type}\n    {_sentence(f.metadata['words'])}" for f in fields(kind) if f.metadata]
    kind.__doc__ = "\n".join([(kind.__doc__ or "").rstrip(), "", "Attributes", "----------", *rows, ""])
    return kind


def words_for(kind: type, name: str) -> str:
    """Return the description of a dataclass's field."""
    return str(_of(kind, name).metadata["words"])


def sentence_for(kind: type, name: str) -> str:
    """Return it with a capital, as Blender shows it."""
    words = words_for(kind, name)
    return words[0].upper() + words[1:]


def default_of(kind: type, name: str) -> Any:
    """Return the default of a dataclass's field."""
    return _of(kind, name).default


def range_of(kind: type, name: str) -> tuple[Any, Any]:
    """Return the least and the largest value of a dataclass's field."""
    found = _of(kind, name).metadata
    return found["lo"], found["hi"]


def check_ranges(settings: Any) -> None:
    """Raise NlosError if a field of a dataclass is outside its range."""
    for one in fields(settings):
        lo, hi = one.metadata.get("lo"), one.metadata.get("hi")
        if lo is None:
            continue
        value = getattr(settings, one.name)
        inside = all(lo <= part <= hi for part in (value if isinstance(value, tuple) else (value,)))
        shown = f"{value:g}" if isinstance(value, float) else value
        require(inside, f"{one.name}: {shown} must be from {_shown(lo)} to {_shown(hi)}")


def _of(kind: type, name: str) -> Any:
    return next(f for f in fields(kind) if f.name == name)


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:] + "."


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
