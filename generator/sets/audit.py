"""Reads all of a data set again, and reports where it differs from what it claims to be.

The claims of a set are protected by hashes (`generator.sets.seal`) or follow from its seed, so each fault is reported
for the file that holds it: a label that was changed in ``poses.csv`` for that file, not for the picture.
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
from generator.model.quantities import NO_CHANGE
from generator.model.variation import draw
from generator.sets import seal
from generator.sets.manifest import LOG, MANIFEST, PLAN, POSES, SCENE, plan_hash, scene_hash
from generator.sets.readable import RENDER_AGAIN, rendered, values_text

if TYPE_CHECKING:
    from generator.sets.dataset import Dataset

PUT_BACK = "put the file back as it was"

_ROUNDING = 1e-9
"""Relative tolerance of angles and places."""
_NAMED = 3
"""Most files that a fault of several files names one by one."""


def changed(dataset: Dataset) -> Iterator[str]:
    """Look for changes after a set was planned: of manifest, plan, scene and backgrounds, or by foreign files.

    Pictures of poses are not read.

    Yields
    ------
    str
        One sentence per fault, which begins with the file that it is in.
    """
    path = dataset.path
    if words := manifest_fault(dataset.meta):
        yield f"{path / MANIFEST}: {words}; {PUT_BACK}"
        return  # all other checks rely on the manifest
    if not (holds := plan_holds(dataset)):
        line, words = next(plan_faults(dataset), (0, _NOT_PLANNED))
        yield f"{path / POSES}{_line(line)}: {words}; {PUT_BACK}"
    if words := scene_fault(path / SCENE, dataset.seal.get("scene", "")):
        yield words
    for name in dataset.background_names:
        seen = dataset.see_background(name)
        if seen.pixels is not None and seen.fault:
            yield f"{path / name}: {seen.fault}; {RENDER_AGAIN}"
    if holds:  # else it is unknown which files belong to the set
        planned = {pose.file for pose in dataset.poses}
        if dataset.own_backgrounds:
            planned |= {pose.background_file for pose in dataset.poses}
        yield from foreign(path, {MANIFEST, POSES, SCENE, LOG, PLAN, *dataset.background_names, *planned})


def plan_holds(dataset: Dataset) -> bool:
    """Whether ``poses.csv`` has the planned poses; for a set without seal, as far as they follow from its seed."""
    digest = dataset.seal.get("poses")
    return plan_hash(dataset.poses) == digest if digest else not any(plan_faults(dataset))


def manifest_fault(meta: Mapping[str, Any]) -> str:
    """Return what was changed in a manifest after its set was planned; empty if no change can be seen."""
    if meta["format"] >= seal.SINCE and seal.SEAL not in meta:
        return f"lacks the table '{seal.SEAL}'"
    if words := seal.broken(meta):
        return words
    return "" if fingerprint(meta["sweep"]) == meta["fingerprint"] else "its table 'sweep' was changed"


def scene_fault(path: Path, digest: str) -> str:
    """Return how a set's scene differs from the one it was planned with; empty if it does not, or without a hash."""
    if not digest:
        return ""
    if not path.is_file():
        return f"{path}: the scene is missing; put the file back"
    same = scene_hash(path) == digest
    return "" if same else f"{path}: is not the scene that this set was planned with; {PUT_BACK}"


def foreign(path: Path, known: Collection[str]) -> list[str]:
    """Return a fault for each file in a set's folders that does not belong to it; hidden files are left out.

    Parameters
    ----------
    path : Path
        Folder of the set.
    known : collection of str
        Files of the set, relative to its folder; the folders that hold them are searched.
    """
    folders = {str(Path(file).parent) for file in known} - {"."}
    names = []
    for folder in ("", *sorted(folders)):
        with contextlib.suppress(FileNotFoundError, NotADirectoryError), os.scandir(path / folder) as entries:
            names += [f"{folder}/{entry.name}".lstrip("/") for entry in entries if not _is_hidden(entry.name)]
    expected = {*known, *folders}
    return [f"{path / name}: is no file of this set; take it away" for name in sorted(names) if name not in expected]


def _is_hidden(name: str) -> bool:
    """Whether a file is a temporary file, a run's state, or one that file managers leave."""
    return name.startswith(".") or name.lower() in ("thumbs.db", "desktop.ini")


def _line(line: int) -> str:
    return f", line {line}" if line else ""


_NOT_PLANNED = "its poses are not those that were planned"


def plan_faults(dataset: Dataset) -> Iterator[tuple[int, str]]:
    """Look for poses that do not follow from the sweep's settings and the voxel grid.

    The place of the target within its voxel depends on the scene's obstacles, so it is not drawn again.

    Yields
    ------
    line : int
        Line of ``poses.csv``; 0 if the fault is that of the whole file.
    words : str
        Description of the fault.
    """
    sweep, grid = dataset.sweep, dataset.grid
    variations = sweep.variations
    wanted = sweep.frames or sweep.poses * grid.n_voxels
    if len(dataset.poses) != wanted:
        yield 0, f"holds {len(dataset.poses)} poses where the sweep has {wanted}"
    count, labels = len(dataset.poses), grid.labels
    positions, rotations = (
        np.array([getattr(pose, name) for pose in dataset.poses]).reshape(-1, 3) for name in ("position", "rotation")
    )
    if sweep.frames:
        with np.errstate(invalid="ignore"):  # a changed place may be beyond the range of integers
            indices, voxels = np.arange(count), grid.voxels(positions)
    else:
        indices, voxels = np.divmod(np.arange(count), grid.n_voxels)
    lo, hi = np.array([grid.bounds(voxel) for voxel in range(grid.n_voxels)]).transpose(1, 0, 2)
    slack = _ROUNDING * np.abs([grid.lo, grid.hi]).max()
    inside = ((lo[voxels] - slack <= positions) & (positions <= hi[voxels] + slack)).all(axis=1)
    if not sweep.frames and sweep.inside == "whole":  # the origin of a mesh may lie outside
        inside[:] = True
    turned = (np.abs(rotations) <= np.asarray(sweep.rotation) * (1.0 + _ROUNDING)).all(axis=1)
    seeds = (noise_seed(sweep.seed, 0) + 1 + np.arange(count)) % 2**31  # as in `noise_seed`
    rows = zip(indices.tolist(), voxels.tolist(), inside.tolist(), turned.tolist(), seeds.tolist(), strict=True)
    for line, (pose, (index, voxel, held, within, seed)) in enumerate(zip(dataset.poses, rows, strict=True), start=2):
        file = f"frames/{index:05d}.exr" if sweep.frames else f"{labels[voxel]}/{index:04d}.exr"
        values = draw(variations, sweep.seed, voxel, index)
        planned = {
            "index": index,
            "voxel": voxel,
            "label": labels[voxel],
            "seed": seed,
            "file": file,
            "values": values,
        }
        actual = {name: getattr(pose, name) for name in planned}
        if actual != planned:
            name = next(name for name in planned if actual[name] != planned[name])
            shown = [values_text(v[name]) if name == "values" else v[name] for v in (actual, planned)]
            yield line, f"{name} is {shown[0]} in place of {shown[1]}"
        elif not held:
            yield line, f"its position lies outside voxel {pose.label}"
        elif not within:
            yield line, f"its rotation is beyond the sweep's {sweep.rotation} degrees"


def faults(dataset: Dataset) -> list[str]:
    """Read everything again.

    Returns
    -------
    list of str
        One sentence per fault, which begins with the file that it is in. Empty when all is well.
    """
    path = dataset.path
    if manifest_fault(dataset.meta):
        return list(changed(dataset))
    holds = plan_holds(dataset)
    sentences = [fault for fault in changed(dataset) if not fault.startswith(f"{path / POSES}")]
    for name in dataset.background_names:
        if words := _background_fault(dataset, name):
            sentences.append(f"{path / name}: {words}")
    if not (path / SCENE).is_file() and "scene" not in dataset.seal:
        sentences.append(f"{path / SCENE}: the scene is missing")
    lines = dict(plan_faults(dataset))
    pictures = []
    for line, pose in enumerate(dataset.poses, start=2):
        faulty_file, words = _picture_fault(dataset, pose, holds=holds)
        if faulty_file == POSES:
            lines.setdefault(line, words)
        elif words:
            pictures.append(f"{path / faulty_file}: {words}")
    if not (holds or lines):
        lines[0] = _NOT_PLANNED
    for line, words in sorted(lines.items()):
        sentences.append(f"{path / POSES}{_line(line)}: {words}")
    return sentences + pictures + alike(dataset)


def _background_fault(dataset: Dataset, name: str) -> str:
    """Return the fault of a background that `changed` does not report; empty if there is none."""
    seen = dataset.see_background(name)
    if seen.pixels is None:
        return "the background is missing or broken; run the sweep again to render it"
    wanted = str(noise_seed(dataset.sweep.seed, 0))
    actual = seen.header.get("seed")
    return f"its seed is {actual} in place of {wanted}" if not seen.fault and actual != wanted else ""


def _picture_fault(dataset: Dataset, pose: PoseRecord, *, holds: bool) -> tuple[str, str]:
    """Return the file at fault for a picture (it, its background or the plan), and what is wrong, if anything."""
    seen = dataset.see(pose)
    if not pose.done:
        sound = seen.pixels is not None and not seen.fault
        return pose.file, "not rendered yet" + (" according to the manifest" if sound else "")
    if seen.pixels is None:
        return pose.file, "missing or broken; run the sweep again to render it"
    if seen.fault:
        # If a picture is valid by itself but the plan was changed, the plan is at fault.
        differing = [name for name in _OF_POSE if seen.fault.startswith(f"is a picture of {name} ")]
        plan_doubtful = not holds or (not dataset.seal and {"position", "rotation"} & set(differing))
        return (POSES, f"{pose.file} {seen.fault}") if differing and plan_doubtful else (pose.file, seen.fault)
    actual = rendered(pose, seen)
    if actual.pixel_hash != pose.pixel_hash:
        return POSES, f"its pixel_hash is not that of {pose.file}"
    if (actual.seconds, actual.samples) != (pose.seconds, pose.samples):
        return POSES, f"its seconds and samples are not those that {pose.file} tells"
    if dataset.own_backgrounds:
        pixels, words = dataset.see_background_of(pose, seen)
        if pixels is None:
            words = "missing or broken; run the sweep again to render it"
        elif not words and np.array_equal(pixels, seen.pixels):
            words = f"equals {pose.file} to the bit: {_nothing(dataset)}"
        if words:
            return pose.background_file, words
    return "", ""


_OF_POSE = ("label", "index", "seed", "position", "rotation", "values", "others")


def alike(dataset: Dataset) -> list[str]:
    """Look for pictures that are bitwise equal to the background or to each other, by their hashes.

    Returns
    -------
    list of str
        One sentence per voxel with pictures that equal the background, and one per group of equal pictures.
    """
    seen = dataset.see_background(dataset.background_names[-1])
    groups: defaultdict[str, list[PoseRecord]] = defaultdict(list)
    for pose in dataset.records:
        groups[pose.pixel_hash].append(pose)
    empty = [] if seen.pixels is None or seen.fault else groups.pop(seen.digest, [])
    counts = Counter(pose.label for pose in dataset.records)
    texts = []
    for label, count in sorted(Counter(pose.label for pose in empty).items()):
        first = next(pose.file for pose in empty if pose.label == label)
        texts.append(
            f"{dataset.path / first}: equals the background to the bit, as {count} of {counts[label]} pictures of "
            f"voxel {label} do: {_nothing(dataset)}"
        )
    for same in groups.values():
        # Without noise, equal poses have equal pictures.
        noisy = traits_of(dataset.settings["engine"]).noisy
        if len(same) > 1 and (noisy or len({(pose.position, pose.rotation) for pose in same}) > 1):
            others = ", ".join(pose.file for pose in same[1 : 1 + _NAMED])
            more = f" and {len(same) - 1 - _NAMED} more" if len(same) > 1 + _NAMED else ""
            texts.append(f"{dataset.path / same[0].file}: equals {others}{more} to the bit, though the poses differ")
    return texts


def _nothing(dataset: Dataset) -> str:
    if not traits_of(dataset.settings["engine"]).noisy:
        return f"{NO_CHANGE}, so it is in full shadow or hidden by something"
    samples = dataset.settings["samples"]
    return f"{NO_CHANGE}, or no path met it in {samples} samples a pixel"


def words(dataset: Dataset) -> str:
    """Return a warning for the end of a sweep if pictures show no object or are equal; empty if there are none."""
    sentences = alike(dataset)
    if not sentences:
        return ""
    more = f" (nlos-generate verify lists {len(sentences)} such faults)" if len(sentences) > 1 else ""
    return f"warning: {sentences[0]}{more}"


def unchecked(dataset: Dataset) -> str:
    """Return what cannot be checked in a set that an older version made; empty if everything can."""
    if dataset.seal:
        return ""
    return (
        f"{dataset.path / MANIFEST}: is of an older version, which kept no hashes of scene and plan, so a change of "
        "the scene, or of a value that pictures do not tell, cannot be seen"
    )
