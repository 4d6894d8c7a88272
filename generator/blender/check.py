"""Checks a scene for faults before a long render, because a faulty NLOS scene looks right."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

import bpy

from generator.blender import check_sight, check_signal, remedies
from generator.blender.engines import renderers, survey
from generator.blender.engines.reading import MAX_ORDER
from generator.blender.engines.settings import settled
from generator.blender.finding import ERROR, FIXES, GOOD, NOTE, WARNING, Finding
from generator.blender.scene import adopt, clearance, geometry, relay, replaced, roles
from generator.blender.scene.description import read_scene
from generator.model import poses
from generator.model.engines import AUTO, ENGINES
from generator.model.errors import NlosError
from generator.model.quantities import order_words
from generator.model.scene import Scene
from generator.model.settings import Sweep


def mend(scene: bpy.types.Scene, fix: str, choice: str = "") -> None:
    """Apply the fix that a finding proposes.

    Parameters
    ----------
    scene : bpy.types.Scene
    fix : str
        Key of `FIXES`.
    choice : str
        One of the finding's choices, if it has any.

    Raises
    ------
    NlosError
        There is no such fix, or it cannot be applied to this scene.
    """
    if fix == "metres":
        adopt.to_metres(scene)
    elif fix == "align":
        adopt.align(scene)
        if roles.GRID_SHAPE not in scene and not _roles(scene):  # none were laid while the wall was elsewhere
            adopt.fit_grid(scene)
    elif fix == "reflections":
        roles.limit_reflections(scene, MAX_ORDER)
    elif fix == "voxels":
        adopt.fit_grid(scene)
    elif fix == "show":
        roles.show(scene, roles.find(scene, "target"))
    elif fix == "keep":
        adopt.keep(scene, choice)
    else:
        raise NlosError(f"fix {fix!r}: there is none; choose from {', '.join(FIXES)}")


def findings(scene: bpy.types.Scene, *, engine: str = "patch") -> list[Finding]:
    """Return all findings that need no rendering, errors first.

    Parameters
    ----------
    scene : bpy.types.Scene
    engine : {"path", "patch", "surfel", "auto"}
        Engine that will render the scene.
    """
    return ordered(parts(scene, engine=engine))


def parts(scene: bpy.types.Scene, *, engine: str = "patch") -> Iterator[list[Finding]]:
    """Yield the same findings part by part, so that a window need not wait for all of them at once."""
    results = _roles(scene)
    yield results
    if results:
        return
    try:
        results = _frame(scene)
        yield results
        yield _settings(scene)
        if not hopeless(results):
            described = read_scene(scene)
            misplaced = _voxels(scene, described)
            yield misplaced
            if not hopeless(misplaced):
                yield from check_sight.parts(scene, described)
            yield _engine(scene, engine)
    except NlosError as error:
        yield [_told(scene, error)]
    except ReferenceError:  # between two parts an object was deleted
        yield [Finding(ERROR, "The scene changed while it was checked; check it again")]


def ordered(found: Iterable[Sequence[Finding]]) -> list[Finding]:
    """Return findings of several parts in one list, errors first."""
    levels = [ERROR, WARNING, NOTE, GOOD]
    return sorted(itertools.chain.from_iterable(found), key=lambda f: levels.index(f.level))


def hopeless(found: Sequence[Finding]) -> bool:
    """Whether there is an error among the findings."""
    return any(f.level == ERROR for f in found)


def _told(scene: bpy.types.Scene, error: NlosError) -> Finding:
    """Return an error's message, without the leading file name, as a finding."""
    text = str(error).removeprefix(f"{bpy.data.filepath or 'scene'}: ")
    fix = "voxels" if "voxel grid" in text else ""
    return Finding(ERROR, text, remedies.named(scene, text), fix)


def _roles(scene: bpy.types.Scene) -> list[Finding]:
    results = []
    for role in roles.SINGLE_ROLES:
        if not roles.players(scene, role):
            title = role.replace("_", " ")
            results.append(Finding(ERROR, f"No object is the {title}: select yours and adopt it, or build a preset"))
    return [*results, *played_twice(scene)]


def played_twice(scene: bpy.types.Scene) -> list[Finding]:
    """Return a finding about each role of one object that several play."""
    return [
        Finding(ERROR, roles.told_twice(role, objects), names[0], "keep", names)
        for role, objects in roles.twice(scene).items()
        for names in [tuple(o.name_full for o in objects)]
    ]


def _frame(scene: bpy.types.Scene) -> list[Finding]:
    results = []
    wall, target = roles.find(scene, "relay_wall"), roles.find(scene, "target")
    if why := roles.unseen(scene, target):
        results.append(Finding(ERROR, f"The target {target.name!r} {why}", target.name, "show"))
    if not adopt.in_metres(scene):
        unit = scene.unit_settings.scale_length
        text = f"A Blender unit is {unit:g} m here; light, voxels and poses count in metres"
        results.append(Finding(ERROR, text, fix="metres"))
    seen = geometry.snapshot(scene)
    try:
        plane = relay.find(scene, seen)
    except NlosError as error:
        return [*results, _told(scene, error)]
    if not plane.in_frame:
        text = f"The relay wall {wall.name!r} is not in the plane y = 0, which the lab's frame starts from"
        results.append(Finding(ERROR, text, wall.name, "align"))
    return results


def _settings(scene: bpy.types.Scene) -> list[Finding]:
    results = []
    if scene.render.engine != "CYCLES":
        results.append(
            Finding(WARNING, "Cycles is not the scene's render engine: F12 shows another picture", fix="reflections")
        )
    order = roles.reflection_order(scene)
    if order < MAX_ORDER:
        text = f"Light makes {order} reflections at most: by way of the hidden object it takes three"
        results.append(Finding(ERROR, text, fix="reflections"))
    elif order > MAX_ORDER:
        text = f"Light makes {order_words(order)}, as in a real room; three are the paper's model"
        results.append(Finding(NOTE, text, fix="reflections"))
    if others := roles.others(scene):
        listed = ", ".join(others[:3]) + (f" and {len(others) - 3} more" if len(others) > 3 else "")
        results.append(Finding(NOTE, f"Also rendered, without a role: {listed}", others[0]))
    if differing := replaced.replaced(scene):
        defaults = [setting.words for setting in differing if replaced.is_default(scene, setting)]
        changed = [replaced.told(scene, setting) for setting in differing if not replaced.is_default(scene, setting)]
        parts = [f"settings of the file: {', '.join(changed)}"] if changed else []
        parts += [f"some of Blender's defaults: {', '.join(defaults)}"] if defaults else []
        results.append(Finding(NOTE, f"A sweep replaces {'; and '.join(parts)}"))
    return results


def _voxels(scene: bpy.types.Scene, described: Scene) -> list[Finding]:
    """Return findings about voxels that lie where nothing can be, or that the target stands outside of."""
    target, grid = roles.find(scene, "target"), described.grid
    if grid.lo[1] + grid.hi[1] <= 0.0:
        text = f"The voxels lie behind the relay wall (y from {grid.lo[1]:g} to {grid.hi[1]:g} m; the wall is y = 0)"
        return [Finding(ERROR, text, target.name, "voxels")]
    place = geometry.snapshot(scene).matrices["target"][:3, 3]
    if ((place < grid.lo) | (place > grid.hi)).any():
        text = f"The target {target.name!r} stands outside the voxels, into which a sweep puts it"
        return [Finding(NOTE, text, target.name, "voxels")]
    return []


def _engine(scene: bpy.types.Scene, engine: str) -> list[Finding]:
    surveyed = survey.survey(scene)
    if surveyed.never:
        return [remedies.finding(scene, ERROR, why, "It cannot be swept: {}") for why in surveyed.never]
    if engine == AUTO:
        return []
    chosen, _ = renderers.choose(scene, surveyed)
    if engine == chosen:
        return []
    reasons = surveyed.reasons(engine)
    if reasons:
        text = f"The engine {engine!r} cannot honour that {{}}; {chosen!r} can"
        return [remedies.finding(scene, ERROR, why, text) for why in reasons]
    by_cost = list(ENGINES)  # the most expensive first
    if by_cost.index(chosen) > by_cost.index(engine):
        return [Finding(NOTE, f"The engine {chosen!r} can render this scene too, in less time")]
    return []


def places(scene: bpy.types.Scene, sweep: Sweep) -> list[Finding]:
    """Return a finding about the first voxel into which the target does not fit, if there is one."""
    described = read_scene(scene)
    is_free = clearance.clearance(scene, described, engine=sweep.engine)
    sampler = poses.Sampler(described.grid, sweep, geometry.hull(scene), is_free)
    for voxel in range(described.grid.n_voxels):
        try:
            sampler.draw(voxel, 0)
        except NlosError as error:
            return [Finding(ERROR, str(error), roles.find(scene, "target").name, "voxels")]
    return []


def check_scene(scene: bpy.types.Scene, chosen: Mapping[str, Any]) -> list[Finding]:
    """Return all findings about a scene before a sweep with the settings that the user chose."""
    results = _unrendered(scene, chosen)
    if hopeless(results):
        return results
    sweep, _ = settled(scene, read_scene(scene), chosen)
    return [*results, *check_signal.probe(scene, sweep).findings()]


def _unrendered(scene: bpy.types.Scene, chosen: Mapping[str, Any]) -> list[Finding]:
    """Return those findings that need no rendering."""
    results = findings(scene, engine=chosen.get("engine", AUTO))
    if hopeless(results):
        return results
    sweep, _ = settled(scene, read_scene(scene), chosen)
    return results + places(scene, sweep)


def mend_all(
    scene: bpy.types.Scene, chosen: Mapping[str, Any], wanted: Collection[str] = ()
) -> tuple[list[str], dict[str, str]]:
    """Apply fixes that findings propose, and those that further findings propose then.

    Parameters
    ----------
    scene : bpy.types.Scene
    chosen : mapping
        Fields of `Sweep` that the user chose.
    wanted : collection of str
        Keys of `FIXES`; the one that has a choice with it, as in ``keep=NAME``. If empty, all fixes of errors and
        warnings; a note may be about what was meant.

    Returns
    -------
    mended : list of str
        Fixes that were applied, in that order.
    refused : dict
        Why the others could not be applied, by fix.

    Raises
    ------
    NlosError
        One of those that are wanted is none.
    """
    names = [fix.partition("=")[0] for fix in wanted]
    kept = [choice for name, _, choice in (fix.partition("=") for fix in wanted) if name == "keep" and choice]
    for fix in set(names) - set(FIXES):
        raise NlosError(f"fix {fix!r}: there is none; choose from {', '.join(FIXES)}")
    mended: list[str] = []
    refused: dict[str, str] = {}
    while True:
        offered = {
            finding.fix
            for finding in _unrendered(scene, chosen)
            if (finding.fix in names if wanted else finding.level in (ERROR, WARNING))
        }
        left = [fix for fix in FIXES if fix in offered and fix not in mended and fix not in refused]
        if not left:
            return mended, refused
        try:
            for choice in kept if left[0] == "keep" and kept else [""]:
                mend(scene, left[0], choice)
            mended.append(left[0])
        except NlosError as error:
            refused[left[0]] = str(error)
