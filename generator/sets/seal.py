"""Hashes in a set's manifest, which protect the manifest itself and the other files of the set.

They protect against mistakes - an edited value, a file copied to the wrong place, a faulty disk - and not against
anybody who computes them anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

SEAL = "seal"
"""Table of the manifest that holds the hashes."""
SINCE = 2
"""Format of a data set, and of a bulk set, from which on its manifest has a seal."""
_OWN, _FIELDS = "sha256", "fields"
_DIGITS = 8
"""Digits of a field's own hash, which only has to identify the field: SHA-256 protects the whole."""


def sealed(meta: Mapping[str, Any], **files: str) -> dict[str, Any]:
    """Return a manifest with its seal.

    Parameters
    ----------
    meta : mapping
        Plain values, as they are read back from TOML.
    **files : str
        SHA-256 of the set's other files, by name.
    """
    plain = {name: value for name, value in meta.items() if name != SEAL}
    seal: dict[str, Any] = {**files, _FIELDS: " ".join(sorted(_short(*leaf) for leaf in _leaves(plain)))}
    return {**plain, SEAL: {**seal, _OWN: _long({**plain, SEAL: seal})}}


def broken(meta: Mapping[str, Any]) -> str:
    """Return what was changed in a sealed manifest; empty if it is as it was written, or has no seal."""
    seal = meta.get(SEAL)
    if seal is None:
        return ""
    if not (isinstance(seal, Mapping) and all(isinstance(value, str) for value in seal.values())):
        return f"{SEAL}: must be a table of texts"
    rest = {name: value for name, value in seal.items() if name != _OWN}
    if _long({**meta, SEAL: rest}) == seal.get(_OWN):
        return ""
    known = set(str(seal.get(_FIELDS)).split())
    leaves = list(_leaves({name: value for name, value in meta.items() if name != SEAL}))
    changed = [name for name, value in leaves if _short(name, value) not in known]
    if changed:
        return f"{changed[0]} was changed after the set was planned"
    if len(leaves) < len(known):
        return "a field was taken out after the set was planned"
    return f"its table '{SEAL}' was changed after the set was planned"


def _leaves(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value that is not a table, with its dotted name; an empty table counts as a value."""
    for name, value in table.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _long(value: Any) -> str:
    # `default` is for dates, which TOML has but only a changed manifest holds.
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def _short(name: str, value: Any) -> str:
    return _long([name, value])[:_DIGITS]
