"""Ways to spoil the contents of sound files of every kind that users hand in, for the fuzzer.

Raw bytes do not get far in a format that has checksums, offsets or archives, so the contents are changed instead, by
the format's own library. Sizes that files claim stay small, and the limits on them are lowered (`LIMIT`). Faults that
the fuzzer finds in others' code are described in words, and no file that shows them is kept.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import zipfile
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import h5py
import numpy as np


class Chance(Protocol):
    """Interface for drawing values from the fuzzer's bytes, such as atheris' FuzzedDataProvider."""

    def ConsumeIntInRange(self, low: int, high: int) -> int: ...
    def ConsumeFloat(self) -> float: ...
    def ConsumeUnicodeNoSurrogates(self, count: int) -> str: ...
    def ConsumeBytes(self, count: int) -> bytes: ...


def pick(chance: Chance, some: Sequence[Any]) -> Any:
    """Return one of some items."""
    return some[chance.ConsumeIntInRange(0, len(some) - 1)]


_MANY = 10**5
LIMIT = 2**20
"""Bytes that any file may hold while the fuzzer runs, in place of `limits.MUCH`."""

NUMBERS = [0, 1, -1, 2, 3, 5, 2**31 - 1, 2**31, 2**62, -(2**63), 0.0, -1.0, 1e308, float("nan"), float("inf")]
DTYPES = ["f8", "f4", "f2", ">f8", "i8", "u8", "i1", ">i4", "?", "c16", "S3", "V5", [("a", "f8"), ("b", "S4")]]
DTYPES += [(np.float64, (3,))]
TEXTS = ["", "{}", "[]", "null", "1e999", "NaN", "[" * 50, '{"a":' * 50, "\x00", "9" * 5000, '"\\ud800"']


def number(chance: Chance) -> Any:
    """Return a number that is likely to hurt."""
    return pick(chance, [*NUMBERS, chance.ConsumeFloat()])


def spoilt_json(chance: Chance, text: str) -> str:
    """Return JSON text with some of it changed."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return str(pick(chance, TEXTS))
    for _ in range(chance.ConsumeIntInRange(1, 3)):
        value = _spoilt(chance, value)
    return json.dumps(value)


def _spoilt(chance: Chance, value: Any) -> Any:
    """Return a plain value with one of its leaves, or all of it, changed."""
    if isinstance(value, dict) and value and chance.ConsumeIntInRange(0, 9):
        key = pick(chance, sorted(value))
        action = chance.ConsumeIntInRange(0, 9)
        rest = {k: v for k, v in value.items() if k != key}
        if action == 0:
            return rest
        if action == 1:
            return {**rest, chance.ConsumeUnicodeNoSurrogates(4): value[key]}
        return {**value, key: _spoilt(chance, value[key])}
    if isinstance(value, list) and value and chance.ConsumeIntInRange(0, 9):
        index = chance.ConsumeIntInRange(0, len(value) - 1)
        action = chance.ConsumeIntInRange(0, 9)
        if action == 0:
            return [*value[:index], *value[index + 1 :]]
        if action == 1:
            return value + value
        return [*value[:index], _spoilt(chance, value[index]), *value[index + 1 :]]
    action = chance.ConsumeIntInRange(0, 6)
    if action == 0:
        return number(chance)
    if action == 1:
        return chance.ConsumeUnicodeNoSurrogates(8)
    if action == 2:
        return [value] * chance.ConsumeIntInRange(0, 5)
    if action == 3:
        return {chance.ConsumeUnicodeNoSurrogates(3): value}
    return pick(chance, [None, True, [], {}, "A", 10**30])


def array(chance: Chance, like: tuple[int, ...]) -> Any:
    """Return an array of any kind and shape."""
    shape = pick(chance, [like, like, like[1:], (*like, 1), (0,), (1,), (2, 2), (), like[:1], (3, *like[1:])])
    kind = pick(chance, DTYPES)
    block = np.zeros(shape, dtype=kind)
    if block.size and block.dtype.kind in "fiuc":
        with np.errstate(all="ignore"):
            block.flat[chance.ConsumeIntInRange(0, block.size - 1)] = np.float64(number(chance)).astype(block.dtype)
    return block


def spoil_hdf5(chance: Chance, file: Any, outside: str) -> None:
    """Change something in an open HDF5 file.

    Parameters
    ----------
    chance : Chance
    file : h5py.File
    outside : str
        Path of a file that readers must not touch.
    """
    names = list(file)
    if chance.ConsumeIntInRange(0, 2) == 0 and len(file.attrs):
        name = pick(chance, sorted(file.attrs))
        old = file.attrs[name]
        action = chance.ConsumeIntInRange(0, 5)
        if action == 0:
            del file.attrs[name]
        elif action == 1:
            file.attrs[name] = array(chance, (2, 2))
        elif action == 2:
            file.attrs[name] = h5py.Empty("f8")
        elif action == 3:
            file.attrs[name] = number(chance)
        elif isinstance(old, str):
            file.attrs[name] = spoilt_json(chance, old).replace("\x00", "")
        else:
            file.attrs[name] = pick(chance, TEXTS).replace("\x00", "")
        return
    if not names:
        return
    name = pick(chance, names)
    shape = getattr(file.get(name), "shape", None) or (3, 3)
    if math.prod(shape) > _MANY:  # a size claimed by an earlier change
        shape = (3, 3)
    link = pick(chance, names)
    action = chance.ConsumeIntInRange(0, 15)
    if action == 15:
        dataset = file[name]
        if not isinstance(dataset, h5py.Dataset) or dataset.is_virtual or dataset.external:
            return  # its data are elsewhere
        if 0 < dataset.size < _MANY and dataset.dtype.kind in "fi":
            data = dataset[()]
            with np.errstate(all="ignore"):
                data.flat[chance.ConsumeIntInRange(0, data.size - 1)] = np.float64(number(chance)).astype(data.dtype)
            file[name][()] = data
        return
    del file[name]
    if action == 1:
        file[name] = array(chance, shape)
    elif action == 2:
        file[name] = h5py.SoftLink(pick(chance, [f"/{link}", "nowhere"]))
    elif action == 3:
        file[name] = h5py.ExternalLink(outside, pick(chance, ["/", "/x", name]))
    elif action == 4:
        file[name] = file[link] if link in file else np.zeros(1)
    elif action == 5:
        file.create_group(name)
    elif action == 6:
        file[name] = np.dtype(pick(chance, DTYPES))
    elif action == 7:
        huge = pick(chance, [(2**22,), (2**20, 4), (2**12, 2**10), (0, 2**20), (2**21,)])
        kind = pick(chance, ["f8", "S1", "i1", "f4"])
        file.create_dataset(name, huge, kind, chunks=tuple(max(1, min(64, n)) for n in huge))
    elif action == 8:
        rows = [np.arange(chance.ConsumeIntInRange(0, 5)) for _ in range(shape[0] if shape[0] < 99 else 3)]
        ragged = file.create_dataset(name, (len(rows),), h5py.vlen_dtype("i4"))
        for i, row in enumerate(rows):
            ragged[i] = row
    elif action == 9:
        file.create_dataset(name, data=[file.ref], dtype=h5py.ref_dtype)
    elif action == 10:
        filters = pick(chance, [{"compression": "gzip"}, {"compression": "lzf"}, {"fletcher32": True}])
        file.create_dataset(name, data=np.zeros(max((1,), shape[:2]), "f8"), **filters)
    elif action == 11:
        file.create_dataset(name, shape, "f8", external=[(outside, 0, h5py.h5f.UNLIMITED)])
    elif action == 12:
        layout = h5py.VirtualLayout(shape, "f8")
        layout[...] = h5py.VirtualSource(outside, "x", shape)
        file.create_virtual_dataset(name, layout)
    elif action == 13:
        file[name] = h5py.Empty("f8")
    elif action == 14:
        count = shape[0] if 0 < shape[0] < 99 else 3
        texts = [chance.ConsumeUnicodeNoSurrogates(3).replace("\x00", "") for _ in range(count)]
        file.create_dataset(name, data=texts, dtype=h5py.string_dtype(pick(chance, ["utf-8", "ascii"])))


def spoilt_hdf5(chance: Chance, sound: bytes, outside: str) -> bytes:
    """Return an HDF5 file with some of its contents changed."""
    image = io.BytesIO(sound)
    with h5py.File(image, "r+") as file:
        for _ in range(chance.ConsumeIntInRange(1, 3)):
            with contextlib.suppress(Exception):  # not every combination can be written
                spoil_hdf5(chance, file, outside)
    return image.getvalue()


def spoilt_zip(
    chance: Chance, sound: bytes, spoil: Callable[[Chance, str, bytes], bytes], *, names: Sequence[str] = ()
) -> bytes:
    """Return an archive with some of its files changed, renamed, doubled or taken away."""
    with zipfile.ZipFile(io.BytesIO(sound)) as file:
        inside = {name: file.read(name) for name in file.namelist()}
    for _ in range(chance.ConsumeIntInRange(1, 3)):
        if not inside:
            break
        name = pick(chance, [*(n for n in names if n in inside), *sorted(inside)])
        action = chance.ConsumeIntInRange(0, 9)
        if action == 0:
            del inside[name]
        elif action == 1:
            inside[pick(chance, ["out", name + "x", *inside])] = inside.pop(name)
        elif action == 2:
            inside[name] = inside[pick(chance, sorted(inside))]
        else:
            inside[name] = spoil(chance, name, inside[name])
    image = io.BytesIO()
    with zipfile.ZipFile(image, "w", pick(chance, [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])) as file:
        for name, data in inside.items():
            file.writestr(name, data)
    return image.getvalue()


def spoilt_npy(chance: Chance, name: str, data: bytes) -> bytes:
    """Return a ``.npy`` file of other values, of another kind or shape, or with a header that claims too much."""
    action = chance.ConsumeIntInRange(0, 3)
    if action == 0:
        return data[: chance.ConsumeIntInRange(0, len(data))]
    if action == 1:
        offset = chance.ConsumeIntInRange(0, max(0, len(data) - 1))
        return data[:offset] + chance.ConsumeBytes(4) + data[offset + 4 :]
    image = io.BytesIO()
    try:
        old = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, EOFError, OSError):
        return data
    if action == 2 and old.size and old.dtype.kind in "fiu":
        new = old.copy()
        with np.errstate(all="ignore"):
            new.flat[chance.ConsumeIntInRange(0, new.size - 1)] = np.float64(number(chance)).astype(new.dtype)
    else:
        new = array(chance, old.shape)
    np.save(image, new)
    text = image.getvalue()
    if chance.ConsumeIntInRange(0, 4) == 0:  # a false claim, in as many bytes
        start = text.find(b"'shape': (")
        if start > 0:
            end = text.index(b")", start)
            claim = pick(chance, [b"99999,", b"256, 256", b"-1,", b"0, 1", b"1,"])
            room = end - start - 10
            text = text[: start + 10] + claim.ljust(room)[:room] + text[end:]
    return text
