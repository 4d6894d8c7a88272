"""The pictures of a data set as thumbnails: read in a thread, only those that a panel asks for, and kept for a while.

A panel asks while it is drawn, where no file may be read; a timer starts the thread.
"""

from __future__ import annotations

import contextlib
import time
from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews
import numpy as np

from generator.files.pictures import Picture
from generator.files.toml import from_dict, to_dict
from generator.model.errors import NlosError
from generator.model.poses import PoseRecord
from generator.model.scene import Scene
from generator.sets import audit
from generator.sets.dataset import Dataset
from generator.sets.manifest import MANIFEST, POSES
from generator.sets.readable import as_read

from ..draft import folder
from ..session import background, state
from . import images

SIDE = 64
"""Most pixels a side of a thumbnail; larger pictures are averaged down."""
_KEPT = 512
"""Thumbnails that are kept."""
_EVERY = 2.0
"""Seconds between two looks whether the set's files have changed."""
_AWAITED = "is not rendered yet"
_IDLE = ("preset", "resolution")
"""Fields of a scene that say nothing about its light."""


@dataclass
class Opened:
    """A data set that is shown.

    Attributes
    ----------
    dataset : Dataset
    voxels : dict of int to list of PoseRecord
        The poses of each voxel that has any, by index.
    stamp : tuple
        Size and time of the set's tables when they were read.
    fault : str
        How the set was changed after it was planned; empty if it was not.
    backdrop : ndarray of shape (height, width, 3), optional
        Background of all pictures, once it has been read.
    """

    dataset: Dataset
    voxels: dict[int, list[PoseRecord]]
    stamp: tuple[Any, ...]
    fault: str = ""
    backdrop: Picture | None = None


@dataclass
class _Shelf:
    opened: Opened | None = None
    name: str = ""
    path: Path | None = None
    words: str = ""
    wanted: dict[str, PoseRecord] = field(default_factory=dict)
    ready: OrderedDict[str, str] = field(default_factory=OrderedDict)  # by file: what is wrong, or nothing
    looked_at: float = -_EVERY
    is_busy: bool = False
    previews: Any = None
    differs: tuple[Any, list[str]] = (None, [])


_shelf = _Shelf()


def opened() -> Opened | None:
    """Return the data set that the panel names, once it has been read."""
    return _shelf.opened


def words() -> str:
    """Return why there is no set to show, or that it is being read; empty if there is one."""
    return _shelf.words


def want(name: str, records: Sequence[PoseRecord] = ()) -> None:
    """Ask for the set in a folder, as the Data Set panel names it, and for thumbnails of some of its poses."""
    _shelf.wanted = {record.file: record for record in records}
    if name != _shelf.name:
        _shelf.name, _shelf.looked_at = name, -_EVERY
    if _is_old() or _lacking():
        state.once(_serve, 0.05)


def thumbnail(record: PoseRecord) -> tuple[int, str]:
    """Return the icon of a pose's picture, 0 if there is none yet; and what is wrong with the picture."""
    fault = _shelf.ready.get(record.file)
    if fault is None:
        return 0, ""
    preview = _shelf.previews.get(record.file) if _shelf.previews else None
    return (preview.icon_id if preview and not fault else 0), fault


def others_than(scene: Scene | None) -> list[str]:
    """Return what of a scene is other than in the scene of the set, by the names of its parts: grid, target ..."""
    if _shelf.opened is None or scene is None:
        return []
    key = (scene, id(_shelf.opened))
    if _shelf.differs[0] != key:
        theirs = _shelf.opened.dataset.meta["scene"]
        with contextlib.suppress(NlosError):  # a set may leave out entries, for what is so by default
            theirs = to_dict(from_dict(Scene, theirs, "scene."))
        theirs, ours = (as_read({"scene": entries})["scene"] for entries in (theirs, to_dict(scene)))
        names = [n for n in (*ours, *theirs) if n not in _IDLE and ours.get(n) != theirs.get(n)]
        _shelf.differs = key, list(dict.fromkeys(names))
    return _shelf.differs[1]


def forget() -> None:
    """Read everything again when it is asked for next."""
    background.drop("browser")
    _shelf.is_busy, _shelf.opened, _shelf.path, _shelf.words, _shelf.looked_at = False, None, None, "", -_EVERY
    _shelf.ready.clear()
    if _shelf.previews is not None:
        _shelf.previews.clear()


def _is_old() -> bool:
    return _shelf.looked_at + _EVERY < time.monotonic()


def _lacking() -> list[PoseRecord]:
    return [record for file, record in _shelf.wanted.items() if file not in _shelf.ready]


def _serve() -> float | None:
    """Start to read what was asked for; return the seconds until another try, None for none."""
    if _shelf.is_busy:
        return 0.1
    if _is_old():
        _look()
    elif _shelf.opened is not None and _lacking():
        _read(_shelf.opened, _lacking())
    return None


def _look() -> None:
    """Read the set's tables, unless they are as they were."""
    try:
        path = folder(bpy.context.scene)
    except NlosError as error:
        forget()
        _shelf.words, _shelf.looked_at = str(error), time.monotonic()
        state.redraw("VIEW_3D")
        return
    if path != _shelf.path:
        forget()
        _shelf.path, _shelf.words = path, "Reading the set ..."
    _shelf.looked_at = time.monotonic()
    before = _shelf.opened

    def then(task: background.Task) -> None:
        _shelf.is_busy = False
        if task.error or task.result is not before:
            _shelf.ready.clear()
            _shelf.opened, _shelf.words = (None, task.error) if task.error else (task.result, "")
        for file in [file for file, fault in _shelf.ready.items() if fault == _AWAITED]:
            del _shelf.ready[file]
        if _lacking():
            state.once(_serve, 0.05)

    _shelf.is_busy = True
    background.Task(lambda task: _open(path, before), then, topic="browser").settle()


def _read(found: Opened, records: list[PoseRecord]) -> None:
    """Read the pictures of some poses."""
    results: deque[tuple[str, Picture | None, str]] = deque()

    def work(task: background.Task) -> None:
        for record in records:
            if task.stop.is_set():
                return
            results.append((record.file, *_picture(found, record)))

    def show(task: background.Task) -> None:
        for _ in range(len(results)):
            _keep(*results.popleft())
        state.redraw("VIEW_3D")

    def then(task: background.Task) -> None:
        _shelf.is_busy = False
        show(task)

    _shelf.is_busy = True
    background.Task(work, then, show, topic="browser").settle()


def _open(path: Path, before: Opened | None) -> Opened:
    """Return the set at a path: the one that was read before, if its tables are the same. Called in a thread."""
    try:
        stamp = tuple((s.st_size, s.st_mtime_ns) for s in ((path / name).stat() for name in (MANIFEST, POSES)))
    except OSError:
        stamp = ()
    if before is not None and stamp and before.dataset.path == path and before.stamp == stamp:
        return before
    dataset = Dataset.open(path, check=False)
    voxels: dict[int, list[PoseRecord]] = {}
    for record in dataset.poses:
        voxels.setdefault(record.voxel, []).append(record)
    for records in voxels.values():
        records.sort(key=lambda record: record.index)
    return Opened(dataset, dict(sorted(voxels.items())), stamp, next(audit.changed(dataset), ""))


def _picture(found: Opened, record: PoseRecord) -> tuple[Picture | None, str]:
    """Return the thumbnail of a pose, or what is wrong with its picture. Called in a thread."""
    dataset = found.dataset
    try:
        if not (dataset.path / record.file).exists():
            return None, _AWAITED
        seen = dataset.see(record)
        if seen.pixels is None:
            return None, seen.fault
        if seen.fault or (record.done and record.pixel_hash != seen.digest):
            return None, seen.fault or "its pixels are not those that were rendered"
        if dataset.own_backgrounds:
            backdrop = dataset.background_of(record)
        else:
            backdrop = dataset.background() if found.backdrop is None else found.backdrop
            found.backdrop = backdrop
        return coloured(seen.pixels - backdrop), ""
    except (NlosError, OSError) as error:
        return None, str(error)


def coloured(difference: Picture) -> Picture:
    """Return a difference picture, (height, width, 3), in the look's colours, as small as a thumbnail."""
    level = difference.mean(axis=2)
    height, width = level.shape
    step = -(-max(height, width) // SIDE)
    rows, columns = height // step, width // step
    if rows and columns:
        level = level[: rows * step, : columns * step].reshape(rows, step, columns, step).mean(axis=(1, 3))
    top = images.scale(level)
    linear = images.signed(level / top if top else level)
    # Buttons show the numbers as they are, whereas the Image Editor converts light to what a screen needs.
    display: Picture = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return display


def _keep(file: str, pixels: Picture | None, fault: str) -> None:
    if _shelf.previews is None:
        _shelf.previews = bpy.utils.previews.new()
    _shelf.ready[file] = fault
    _shelf.ready.move_to_end(file)
    if pixels is not None:
        if file in _shelf.previews:
            del _shelf.previews[file]
        preview = _shelf.previews.new(file)
        rgba = np.ones((*pixels.shape[:2], 4), dtype=np.float32)
        rgba[..., :3] = pixels[::-1]
        preview.image_size = pixels.shape[1::-1]
        preview.image_pixels_float.foreach_set(rgba.ravel())
    while len(_shelf.ready) > _KEPT:
        old, _ = _shelf.ready.popitem(last=False)
        if old in _shelf.previews:
            del _shelf.previews[old]


def register() -> None:
    """Do nothing: sets are read only once a panel asks for one."""


def unregister() -> None:
    """Forget the set and its thumbnails."""
    global _shelf
    forget()
    if _shelf.previews is not None:
        bpy.utils.previews.remove(_shelf.previews)
    _shelf = _Shelf()
    if bpy.app.timers.is_registered(_serve):
        bpy.app.timers.unregister(_serve)
