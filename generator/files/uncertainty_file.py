"""What is not known exactly of a scene, as a file: ``uncertainty.toml``."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from generator.files.toml import dump_toml, from_dict, read_toml, to_dict
from generator.files.writing import write_text
from generator.model.errors import NlosError
from generator.model.uncertainty import Uncertainty


def read_uncertainty(path: Path) -> Uncertainty:
    """Read a file that `write_uncertainty` or a person wrote.

    Raises
    ------
    NlosError
        The file is missing, or says what cannot be.
    """
    try:
        read: Uncertainty = from_dict(Uncertainty, read_toml(path))
    except NlosError as error:
        words = str(error)
        raise NlosError(words if words.startswith(str(path)) else f"{path}: {words}") from None
    return read


def plain_values(uncertainty: Uncertainty) -> dict[str, Any]:
    """Return an uncertainty as TOML gives it back."""
    plain: dict[str, Any] = tomllib.loads(dump_toml(to_dict(uncertainty)))
    return plain


def write_uncertainty(path: Path, uncertainty: Uncertainty) -> None:
    """Write what is not known exactly of a scene.

    Raises
    ------
    NlosError
        The file cannot be written.
    """
    plain = {name: value for name, value in to_dict(uncertainty).items() if value != ()}
    write_text(path, dump_toml(plain))
