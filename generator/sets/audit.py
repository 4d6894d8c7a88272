"""Reads all of a data set again, and says where it is not what it says of itself.

What a set says is held by hashes (`generator.sets.seal`) or follows from its seed, so each fault is named where it
is: a label that was changed in ``poses.csv`` is that file's, not the picture's.
"""

from __future__ import annotations

import contextlib
import os
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from generator.files.writing import fingerprint
from generator.model.engines import traits_of
from generator.model.poses import PoseRecord, noise_seed
from generator.sets import seal
from generator.sets.manifest import FORMAT, LOG, MANIFEST, PLAN, POSES, SCENE, plan_hash, scene_hash
from generator.sets.readable import RENDER_AGAIN, rendered

if TYPE_CHECKING:
    from generator.sets.dataset import Dataset

PUT_BACK = "put the file back as it was"

_ROUNDING = 1e-9
"""Relative, of angles and places."""
_NAMED = 3
"""Faults of one kind that are told file by file."""


def changed(dataset: Dataset) -> Iterator[str]:
    """Look for what was changed after a set was planned: manifest, plan, scene, backgrounds, files of others.

    Pictures of poses are not read.

    Yields
    ------
    str
        One sentence per fault, which begins with the file that it is in.
    """
    path = dataset.path
    if words := manifest_fault(dataset.meta, FORMAT):
        yield f"{path / MANIFEST}: {words}; {PUT_BACK}"
        return  # all else is judged by it
    if not (holds := plan_holds(dataset)):
        line, words = next(plan_faults(dataset), (0, _NOT_PLANNED))
        yield f"{path / POSES}{_line(line)}: {words}; {PUT_BACK}"
    if words := scene_fault(path / SCENE, dataset.seal.get("scene", "")):
        yield words
    for name in dataset.background_names:
        seen = dataset.see_background(name)
        if seen.pixels is not None and seen.fault:
            yield f"{path / name}: {seen.fault}; {RENDER_AGAIN}"
    if holds:  # else nobody knows which files are its own
        planned = {pose.file for pose in dataset.poses}
        yield from foreign(path, {MANIFEST, POSES, SCENE, LOG, PLAN, *dataset.background_names, *planned})


def plan_holds(dataset: Dataset) -> bool:
    """Whether ``poses.csv`` says what was planned; of a set without seal, as far as it can be told from its seed."""
    told = dataset.seal.get("poses")
    return plan_hash(dataset.poses) == told if told else not any(plan_faults(dataset))


def manifest_fault(meta: Mapping[str, Any], newest: int) -> str:
    """Return what of a manifest was changed after its set was planned; empty if nothing was, as far as it tells."""
    if meta["format"] == newest and seal.SEAL not in meta:
        return f"lacks the table '{seal.SEAL}'"
    if words := seal.broken(meta):
        return words
    return "" if fingerprint(meta["sweep"]) == meta["fingerprint"] else "its table 'sweep' was changed"


def scene_fault(path: Path, digest: str) -> str:
    """Return how a set's scene is not the one it was planned with; empty if it is, or no hash tells."""
    if not digest:
        return ""
    if not path.is_file():
        return f"{path}: the scene is missing; put the file back"
    same = scene_hash(path) == digest
    return "" if same else f"{path}: is not the scene that this set was planned with; {PUT_BACK}"


def foreign(path: Path, known: Collection[str]) -> list[str]:
    """Return a fault for each file in a set's folders that is none of its own; hidden files are left out.

    Parameters
    ----------
    path : Path
        Of the set.
    known : collection of str
        Its own files, relative to that; their folders are looked into.
    """
    folders = {str(Path(file).parent) for file in known} - {"."}
    found = []
    for folder in ("", *sorted(folders)):
        with contextlib.suppress(FileNotFoundError, NotADirectoryError), os.scandir(path / folder) as inside:
            found += [f"{folder}/{entry.name}".lstrip("/") for entry in inside if not _is_hidden(entry.name)]
    own = {*known, *folders}
    return [f"{path / name}: is no file of this set; take it away" for name in sorted(found) if name not in own]


def _is_hidden(name: str) -> bool:
    """Whether a file is one of our runs' and temporary ones, or of those that file managers leave."""
    return name.startswith(".") or name.lower() in ("thumbs.db", "desktop.ini")


def _line(line: int) -> str:
    return f", line {line}" if line else ""


_NOT_PLANNED = "its poses are not those that were planned"


def plan_faults(dataset: Dataset) -> Iterator[tuple[int, str]]:
    """Look for poses that the sweep's settings and the voxel grid do not give.

    Where the target stands in its voxel is drawn with the scene's obstacles in mind, and is not drawn again.

    Yields
    ------
    line : int
        Of ``poses.csv``; 0 if it is all of them.
    words : str
    """
    sweep, grid = dataset.sweep, dataset.grid
    wanted = sweep.frames or sweep.poses * grid.n_voxels
    if len(dataset.poses) != wanted:
        yield 0, f"holds {len(dataset.poses)} poses where the sweep has {wanted}"
    count, labels = len(dataset.poses), grid.labels
    positions, rotations = (
        np.array([getattr(pose, name) for pose in dataset.poses]).reshape(-1, 3) for name in ("position", "rotation")
    )
    if sweep.frames:
        with np.errstate(invalid="ignore"):  # a changed place may be beyond what whole numbers count
            indices, voxels = np.arange(count), grid.voxels(positions)
    else:
        indices, voxels = np.divmod(np.arange(count), grid.n_voxels)
    lo, hi = np.array([grid.bounds(voxel) for voxel in range(grid.n_voxels)]).transpose(1, 0, 2)
    slack = _ROUNDING * np.abs([grid.lo, grid.hi]).max()
    inside = ((lo[voxels] - slack <= positions) & (positions <= hi[voxels] + slack)).all(axis=1)
    if not sweep.frames and sweep.inside == "whole":  # the origin of a mesh may lie beside it
        inside[:] = True
    turned = (np.abs(rotations) <= np.asarray(sweep.rotation) * (1.0 + _ROUNDING)).all(axis=1)
    seeds = (noise_seed(sweep.seed, 0) + 1 + np.arange(count)) % 2**31  # as `noise_seed` has it
    told = zip(indices.tolist(), voxels.tolist(), inside.tolist(), turned.tolist(), seeds.tolist(), strict=True)
    for line, (pose, (index, voxel, held, within, seed)) in enumerate(zip(dataset.poses, told, strict=True), start=2):
        file = f"frames/{index:05d}.exr" if sweep.frames else f"{labels[voxel]}/{index:04d}.exr"
        planned = {"index": index, "voxel": voxel, "label": labels[voxel], "seed": seed, "file": file}
        own = {name: getattr(pose, name) for name in planned}
        if own != planned:
            name = next(name for name in planned if own[name] != planned[name])
            yield line, f"{name} is {own[name]} in place of {planned[name]}"
        elif not held:
            yield line, f"its position lies outside voxel {pose.label}"
        elif not within:
            yield line, f"its rotation is beyond the sweep's {sweep.rotation} degrees"


def faults(dataset: Dataset) -> list[str]:
    """Re-read everything.

    Returns
    -------
    list of str
        One sentence per fault, which begins with the file that it is in. Empty when all is well.
    """
    path = dataset.path
    if manifest_fault(dataset.meta, FORMAT):
        return list(changed(dataset))
    holds = plan_holds(dataset)
    found = [fault for fault in changed(dataset) if not fault.startswith(f"{path / POSES}")]
    for name in dataset.background_names:
        if words := _background_fault(dataset, name):
            found.append(f"{path / name}: {words}")
    if not (path / SCENE).is_file() and "scene" not in dataset.seal:
        found.append(f"{path / SCENE}: the scene is missing")
    lines = dict(plan_faults(dataset))
    pictures = []
    for line, pose in enumerate(dataset.poses, start=2):
        blamed, words = _picture_fault(dataset, pose, holds=holds)
        if blamed == POSES:
            lines.setdefault(line, words)
        elif words:
            pictures.append(f"{path / pose.file}: {words}")
    if not (holds or lines):
        lines[0] = _NOT_PLANNED
    for line, words in sorted(lines.items()):
        found.append(f"{path / POSES}{_line(line)}: {words}")
    return found + pictures + alike(dataset)


def _background_fault(dataset: Dataset, name: str) -> str:
    """What of a background `Dataset.changed` has not told."""
    seen = dataset.see_background(name)
    if seen.pixels is None:
        return "the background is missing or broken; run the sweep again to render it"
    wanted = str(noise_seed(dataset.sweep.seed, 0))
    own = seen.header.get("seed")
    return f"its seed is {own} in place of {wanted}" if not seen.fault and own != wanted else ""


def _picture_fault(dataset: Dataset, pose: PoseRecord, *, holds: bool) -> tuple[str, str]:
    """Which file is at fault for a picture, the picture's own or the plan's, and what is wrong."""
    seen = dataset.see(pose)
    if not pose.done:
        sound = seen.pixels is not None and not seen.fault
        return pose.file, "not rendered yet" + (" according to the manifest" if sound else "")
    if seen.pixels is None:
        return pose.file, "missing or broken; run the sweep again to render it"
    if seen.fault:
        # A picture that is sound by itself, beside a plan that is not as it was: the plan is to blame.
        named = [name for name in _OF_POSE if seen.fault.startswith(f"is a picture of {name} ")]
        unheld = not holds or (not dataset.seal and {"position", "rotation"} & set(named))
        return (POSES, f"{pose.file} {seen.fault}") if named and unheld else (pose.file, seen.fault)
    told = rendered(pose, seen)
    if told.pixel_hash != pose.pixel_hash:
        return POSES, f"its pixel_hash is not that of {pose.file}"
    if (told.seconds, told.samples) != (pose.seconds, pose.samples):
        return POSES, f"its seconds and samples are not those that {pose.file} tells"
    return "", ""


_OF_POSE = ("label", "index", "seed", "position", "rotation")


def alike(dataset: Dataset) -> list[str]:
    """Look for pictures that equal the background to the bit, or each other, by their hashes.

    Returns
    -------
    list of str
        A sentence per voxel whose pictures are the background, and per group of equal pictures.
    """
    seen = dataset.see_background(dataset.background_names[-1])
    groups: defaultdict[str, list[PoseRecord]] = defaultdict(list)
    for pose in dataset.records:
        groups[pose.pixel_hash].append(pose)
    empty = [] if seen.pixels is None or seen.fault else groups.pop(seen.digest, [])
    counts = Counter(pose.label for pose in dataset.records)
    found = []
    for label, count in sorted(Counter(pose.label for pose in empty).items()):
        first = next(pose.file for pose in empty if pose.label == label)
        found.append(
            f"{dataset.path / first}: equals the background to the bit, as {count} of {counts[label]} pictures of "
            f"voxel {label} do: {_nothing(dataset)}"
        )
    for same in groups.values():
        # Without noise, the same pose is the same picture.
        noisy = traits_of(dataset.settings["engine"]).noisy
        if len(same) > 1 and (noisy or len({(pose.position, pose.rotation) for pose in same}) > 1):
            others = ", ".join(pose.file for pose in same[1 : 1 + _NAMED])
            more = f" and {len(same) - 1 - _NAMED} more" if len(same) > 1 + _NAMED else ""
            found.append(f"{dataset.path / same[0].file}: equals {others}{more} to the bit, though the poses differ")
    return found


def _nothing(dataset: Dataset) -> str:
    if not traits_of(dataset.settings["engine"]).noisy:
        return "the object changes nothing there, so it is in full shadow or hidden by something"
    samples = dataset.settings["samples"]
    return f"the object changes nothing there, or no path met it in {samples} samples a pixel"


def words(dataset: Dataset) -> str:
    """Return what to say at the end of a sweep of pictures that show nothing or the same; empty if none do."""
    found = alike(dataset)
    if not found:
        return ""
    more = f" (nlos-generate verify lists {len(found)} such faults)" if len(found) > 1 else ""
    return f"warning: {found[0]}{more}"


def unchecked(dataset: Dataset) -> str:
    """Return what cannot be told of a set that an older version made; empty if all can."""
    if dataset.seal:
        return ""
    return (
        f"{dataset.path / MANIFEST}: is of an older version, which kept no hashes of scene and plan, so a change of "
        "the scene, or of a value that pictures do not tell, cannot be seen"
    )
