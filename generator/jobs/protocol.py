"""What coordinator and worker say to one another.

A worker is started with one request, as JSON, on its command line. One that renders says when it is ready and takes
batches of work as lines on standard input. Answers leave as lines of JSON that start with ``nlos``, because Blender
writes to standard output as well.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, get_type_hints

ANSWER = "nlos "
"""What lines of a worker that are meant for the coordinator begin with."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a worker is asked for.

    Attributes
    ----------
    trust_links : bool
        Whether what a scene refers to may lie anywhere (`generator.sets.links`).
    """

    module: ClassVar[str] = "generator.blender.worker"
    """The module that is run; the package's own name stands before it in the extension."""
    trust_links: bool

    @property
    def arguments(self) -> list[str]:
        """The module, and what follows on its command line."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return [self.module, json.dumps({"request": type(self).__name__, **values}, default=str)]


@dataclass(frozen=True, kw_only=True)
class PlanSweep(Request):
    """Plan a data set, and check it at its start; answers ``planned`` and ``notes``.

    Attributes
    ----------
    scene, path : Path
        Scene file, and folder of the new set.
    chosen : mapping
        Fields of `Sweep` that the user chose.
    force, probe : bool
        Plan in spite of errors that the check finds; hold the engine against plain Cycles first.
    """

    scene: Path
    path: Path
    chosen: Mapping[str, Any]
    force: bool = False
    probe: bool = True


@dataclass(frozen=True, kw_only=True)
class RenderSweep(Request):
    """Render poses of a data set; takes their positions, and answers each batch with its ``files``.

    Attributes
    ----------
    path : Path
        Folder of the set.
    threads : int
        0 takes all cores.
    """

    path: Path
    threads: int


@dataclass(frozen=True, kw_only=True)
class CheckScene(Request):
    """Say what would spoil a sweep of a scene; answers ``findings``."""

    scene: Path
    chosen: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class TrialRender(Request):
    """Render a few poses of a sweep and throw them away; answers what they took.

    Attributes
    ----------
    scene : Path
    chosen : mapping
        Fields of `Sweep` that the user chose.
    threads : int
        0 takes all cores.
    share, shares : int
        Which of how many workers side by side this one is, from 0.
    force : bool
        Render in spite of errors that the check finds.
    """

    scene: Path
    chosen: Mapping[str, Any]
    threads: int
    share: int
    shares: int
    force: bool = False


@dataclass(frozen=True, kw_only=True)
class RenderWall(Request):
    """Leave ``wall.exr`` and ``background.exr`` in a folder; answers ``rendered``."""

    scene: Path
    folder: Path
    chosen: Mapping[str, Any]
    denoise: bool


@dataclass(frozen=True, kw_only=True)
class DrawExperiment(Request):
    """Leave the pictures of one of the paper's experiments in a file; answers ``drawn``."""

    scene: Path
    file: Path
    number: int


@dataclass(frozen=True, kw_only=True)
class PlanBulk(PlanSweep):
    """Plan a bulk set, and check it at its start; answers ``planned`` and ``notes``."""

    module: ClassVar[str] = "generator.blender.bulk_worker"


@dataclass(frozen=True, kw_only=True)
class RenderBulk(RenderSweep):
    """Make parts of a bulk set; takes their numbers, and answers each with ``part``."""

    module: ClassVar[str] = "generator.blender.bulk_worker"


REQUESTS = (
    PlanSweep,
    RenderSweep,
    CheckScene,
    TrialRender,
    RenderWall,
    DrawExperiment,
    PlanBulk,
    RenderBulk,
)


def read_request(text: str) -> Request:
    """Return the request that `Request.arguments` wrote."""
    values = json.loads(text)
    kinds = {kind.__name__: kind for kind in REQUESTS}
    kind = kinds[values.pop("request")]
    paths = [name for name, hint in get_type_hints(kind).items() if hint is Path]
    return kind(**{**values, **{name: Path(values[name]) for name in paths}})


def answer(**fields: Any) -> None:
    """Tell the coordinator something."""
    print(ANSWER + json.dumps(fields), flush=True)


def batches() -> Iterable[dict[int, int]]:
    """Say that this process is ready, and return the batches that are sent to it: numbers, each with its samples."""
    answer(ready=True)
    for line in sys.stdin:
        pairs = (word.partition(":") for word in line.split())
        yield {int(number): int(samples or 0) for number, _, samples in pairs}
