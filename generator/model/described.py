"""Settings whose default, help and range are written once for command line, Blender's panels and docstrings."""

from __future__ import annotations

import ast
from dataclasses import MISSING, field, fields
from typing import Any, TypeVar

import numpy as np

from generator.model.errors import require

Kind = TypeVar("Kind", bound=type)


def described(words: str, default: Any = MISSING, *, lo: Any = None, hi: Any = None) -> Any:
    """Return a field of a dataclass with a description.

    Parameters
    ----------
    words : str
        What the field is, with its unit; without a capital or a full stop, as help texts are written.
    default
        Default of the field, if it has one.
    lo, hi : optional, both or neither
        Least and largest value of the field, or of each of its components; `check_ranges` enforces them.
    """
    return field(default=default, metadata={"words": words, "lo": lo, "hi": hi})


def borrowed(kind: type, name: str) -> Any:
    """Return a field with the default and the description of another dataclass's field."""
    source = _of(kind, name)
    return field(default=source.default, metadata=source.metadata)


def documented(kind: Kind) -> Kind:
    """Add the descriptions of a dataclass's fields to its docstring. To be applied after `dataclass`."""
    rows = [f"{f.name} : {f.type}\n    {sentence(f.metadata['words'])}." for f in fields(kind) if f.metadata]
    kind.__doc__ = "\n".join([(kind.__doc__ or "").rstrip(), "", "Attributes", "----------", *rows, ""])
    return kind


def words_for(kind: type, name: str) -> str:
    """Return the description of a dataclass's field."""
    return str(_of(kind, name).metadata["words"])


def sentence_for(kind: type, name: str) -> str:
    """Return the description of a dataclass's field with a capital, as Blender shows it."""
    return sentence(words_for(kind, name))


def sentence(words: str) -> str:
    """Return words with a capital."""
    return words[0].upper() + words[1:]


def default_of(kind: type, name: str) -> Any:
    """Return the default of a dataclass's field."""
    return _of(kind, name).default


def range_of(kind: type, name: str) -> tuple[Any, Any]:
    """Return the least and the largest value of a dataclass's field."""
    metadata = _of(kind, name).metadata
    return metadata["lo"], metadata["hi"]


def choices_of(kind: type, name: str) -> tuple[Any, ...]:
    """Return what a dataclass's field may be, if its annotation (text, which is not evaluated) is a `Literal`."""
    annotation = str(_of(kind, name).type)
    if not annotation.startswith("Literal["):
        return ()
    choices: tuple[Any, ...] = ast.literal_eval(f"({annotation.removeprefix('Literal[')[:-1]},)")
    return choices


def check_ranges(settings: Any) -> None:
    """Raise NlosError if a field of a dataclass, or a component of one, is outside its range, or one is missing."""
    for one in fields(settings):
        lo, hi = one.metadata.get("lo"), one.metadata.get("hi")
        if lo is None:
            continue
        value = getattr(settings, one.name)
        parts = [value] if np.ndim(value) == 0 else list(value)
        wanted = len(one.default) if isinstance(one.default, tuple) else 1
        require(len(parts) == wanted, f"{one.name}: {value} must be {wanted} numbers")
        shown = f"{value:g}" if isinstance(value, float) else value
        inside = all(lo <= part <= hi for part in parts)
        require(inside, f"{one.name}: {shown} must be from {_shown(lo)} to {_shown(hi)}")


def _of(kind: type, name: str) -> Any:
    return next(f for f in fields(kind) if f.name == name)


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
