"""What a command answers: values for programs (``--json``), and lines and tables for people."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, dataclass_transform, get_args, get_origin, get_type_hints

import numpy as np

from generator.cli import volume
from generator.cli.parser import verb_parsers
from generator.cli.terminal import print_table
from generator.model.described import described, documented

T = TypeVar("T")


@dataclass_transform(kw_only_default=True)
def json_object(kind: type[T]) -> type[T]:
    """Make a class a dataclass of described fields, with no method but a constructor: others delay the start."""
    made: type[T] = documented(dataclass(kw_only=True, repr=False, eq=False)(kind))
    return made


@json_object
class Interval:
    """A value with its 95 % confidence interval; ``null`` where it is not known, and where an end is infinite."""

    value: float = described("the value")
    low: float = described("lower end of the interval")
    high: float = described("upper end of the interval")


@dataclass(frozen=True)
class Table:
    """A table for people.

    Attributes
    ----------
    title : str
    headings : sequence of str
    rows : sequence of sequence of str
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Answer:
    """What a command answers.

    Attributes
    ----------
    values : dataclass
        For programs: SI units, each field with its description (`generator.model.described`).
    text : sequence of str or Table
        For people.
    code : int
        Exit code.
    """

    values: Any
    text: Sequence[str | Table] = field(default_factory=list)
    code: int = 0

    def give(self) -> int:
        """Print the answer, as JSON if the command was asked for that; return the exit code."""
        if volume.current().json:
            print(json.dumps(plain(self.values), indent=1, ensure_ascii=False, allow_nan=False))
            return self.code
        for part in self.text:
            if isinstance(part, Table):
                print_table(part.title, part.headings, part.rows)
            else:
                print(part)
        return self.code


def give(options: argparse.Namespace) -> int:
    """Run a verb as loudly as its options ask for, and print its answer; return the exit code."""
    with volume.chosen(options):
        answer: Answer = options.run(options)
    return answer.give()


def plain(value: Any) -> Any:
    """Return a value as JSON knows it: NaN and infinity, which it does not know, become None."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def interval(value: Any) -> Interval:
    """Return anything with value, low and high, or a sequence of these three, as an `Interval`."""
    if isinstance(value, tuple):
        middle, low, high = map(float, value)
        return Interval(value=middle, low=low, high=high)
    return Interval(value=float(value.value), low=float(value.low), high=float(value.high))


def keys(kind: type, prefix: str = "") -> list[tuple[str, str, str]]:
    """Return the keys of an answer: name (of those inside others, with dots), type in JSON's words, description."""
    rows = []
    for name, hint in get_type_hints(kind).items():
        words = next(f.metadata["words"] for f in fields(kind) if f.name == name)
        inner, shown = _type(hint)
        rows.append((f"{prefix}{name}", shown, words))
        if inner is not None and inner is not Interval:
            rows += keys(inner, f"{prefix}{name}{'[]' if shown.startswith('list') else ''}.")
    return rows


_NAMES = {str: "text", Path: "text", int: "whole number", float: "number", bool: "true or false", dict: "object"}


def _type(hint: Any) -> tuple[type | None, str]:
    """Return the dataclass inside a type, and the type in words."""
    origin, args = get_origin(hint), [a for a in get_args(hint) if a is not type(None)]
    if origin in (list, tuple):
        inner, shown = _type(args[0])
        return inner, f"list of {f'({shown})' if ' or ' in shown else shown}"
    if origin is dict:
        inner, shown = _type(args[1])
        return inner, f"object of {shown}" if shown else "object"
    if args:  # or None
        inner, shown = _type(args[0])
        return inner, f"{shown}{',' if ' of ' in shown else ''} or null"
    if hint is Interval:
        return hint, "interval"
    if isinstance(hint, type) and is_dataclass(hint):
        return hint, "object"
    return None, _NAMES.get(hint, "")


def table_of_keys(parser: argparse.ArgumentParser) -> str:
    """Return the keys of the answers of all verbs of a command line, as a table in Markdown."""
    lines = ["| command | key | value | meaning |", "|---|---|---|---|"]
    for verb, one in verb_parsers(parser).items():
        for key, shown, words in keys(one.get_default("answer")):
            lines.append(f"| `{verb}` | `{key}` | {shown} | {words} |")
    return "\n".join(lines)
