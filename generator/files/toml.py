"""Dataclasses to and from TOML: errors are described in a sentence, and the text is the same on every machine."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from generator.model.errors import NlosError, instead, require


def from_dict(cls: type, data: Mapping[str, Any], where: str = "") -> Any:
    """Build a dataclass from plain TOML values.

    Raises
    ------
    NlosError
        A field is unknown, missing or of the wrong type; the message names it with its dotted path.
    """
    require(isinstance(data, Mapping), f"{where.rstrip('. ') or 'scene'}: must be a table")
    hints = get_type_hints(cls)
    known = {f.name for f in fields(cls)}
    for key in data:
        if key not in known:
            raise NlosError(f"{where}{key}: no such field; {instead(str(key), sorted(known))}")
    try:
        return cls(**{key: _convert(hints[key], value, f"{where}{key}") for key, value in data.items()})
    except TypeError as error:
        raise NlosError(f"{where or 'scene'}: {error}") from None


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return None if value is None else _convert(args[0], value, where)
    if is_dataclass(hint) and isinstance(hint, type):
        require(isinstance(value, Mapping), f"{where}: must be a table")
        return from_dict(hint, value, f"{where}.")
    if origin is tuple:
        require(isinstance(value, list | tuple), f"{where}: must be a list")
        if len(args) == 2 and args[1] is Ellipsis:
            return tuple(_convert(args[0], item, where) for item in value)
        require(len(value) == len(args), f"{where}: must hold {len(args)} values, not {len(value)}")
        return tuple(_convert(arg, item, where) for arg, item in zip(args, value, strict=True))
    if origin is Literal:
        require(value in args, f"{where}: {value!r} must be one of {', '.join(map(str, args))}")
        return value
    if hint is float:
        require(
            isinstance(value, int | float) and not isinstance(value, bool),
            f"{where}: {value!r} must be a number",
        )
        return float(value)
    if hint is int:
        require(
            isinstance(value, int) and not isinstance(value, bool),
            f"{where}: {value!r} must be a whole number",
        )
        return value
    require(isinstance(value, hint), f"{where}: {value!r} must be of type {hint.__name__}")
    return value


def to_dict(value: Any) -> dict[str, Any]:
    """Return a dataclass as plain values, leaving out those that are None (TOML has no null)."""
    plain: dict[str, Any] = _without_none(asdict(value))
    return plain


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return value


def set_field(data: dict[str, Any], assignment: str) -> None:
    """Set one value of a plain scene from ``dotted.name=value``, where value is TOML, or else a text.

    Raises
    ------
    NlosError
        It is not an assignment, or a part of the name is not that of a table.
    """
    name, equals, text = assignment.partition("=")
    keys = name.strip().split(".")
    require(bool(equals) and all(keys), f"--set {assignment!r}: must read NAME=VALUE, for example spot.power=500")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    for key in keys[:-1]:
        data = data.setdefault(key, {})
        require(isinstance(data, dict), f"--set {assignment!r}: {key} is not a table")
    data[keys[-1]] = value


def merge(base: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``base`` with the values of ``over`` laid on top, table by table."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = merge(below, value) if isinstance(below, dict) and isinstance(value, Mapping) else value
    return merged


_DEEP = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){50}""")
"""A key with more parts than any that this software writes: tomllib of Python 3.11 took gigabytes for some."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    NlosError
        The file is missing or is not TOML.
    """
    try:
        text = path.read_text(encoding="utf-8")
        if _DEEP.search(text):
            raise ValueError("a key in it has too many parts")
        return tomllib.loads(text)
    except OSError as error:
        raise NlosError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise NlosError(f"{path}: is not a TOML file ({error})") from None


def dump_toml(data: Mapping[str, Any], prefix: str = "") -> str:
    """Return plain values as TOML text; tables come after the keys of their parent."""
    lines = [f"{_key(key)} = {_value(value)}" for key, value in data.items() if not isinstance(value, Mapping)]
    for key, value in data.items():
        if isinstance(value, Mapping):
            name = f"{prefix}{_key(key)}"
            lines += ["", f"[{name}]", dump_toml(value, f"{name}.")]
    return "\n".join(lines).rstrip() + ("\n" if not prefix else "")


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else _json(key)


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    return _json(value)


def _json(value: Any) -> str:
    # JSON's strings, numbers and booleans are valid TOML, except DEL, which TOML requires to be escaped.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
