"""Messages between the coordinator and its workers.

A worker is started with one request, as JSON, on its command line. A worker that renders reports when it is ready and
takes batches of work as lines on standard input. Answers are lines of JSON on standard output that start with
``nlos``, because Blender writes there as well.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, get_type_hints

from generator.jobs.gpus import Gpus

ANSWER = "nlos "
"""Start of the lines of a worker's output that are meant for the coordinator."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """Request to a worker.

    Attributes
    ----------
    trust_links : bool
        Whether files that a scene refers to may lie anywhere (`generator.sets.links`).
    gpus : Gpus
        Those to render on where a GPU is asked for (`generator.jobs.gpus`); empty leaves it to the worker's Blender.
    """

    module: ClassVar[str] = "generator.blender.worker"
    """Module that is run; in the Blender extension, the name of the extension's package precedes it."""
    trust_links: bool
    gpus: Gpus = field(default_factory=dict)

    @property
    def arguments(self) -> list[str]:
        """The module, and the arguments on its command line."""
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
        Plan in spite of errors that the check finds; compare the engine with plain Cycles first.
    """

    scene: Path
    path: Path
    chosen: Mapping[str, Any]
    force: bool = False
    probe: bool = True


@dataclass(frozen=True, kw_only=True)
class RenderSweep(Request):
    """Render poses of a data set; takes their positions in its table, and answers each batch with its ``files``.

    Attributes
    ----------
    path : Path
        Folder of the set.
    threads : int
        Threads of the worker; 0 takes all cores.
    """

    path: Path
    threads: int


@dataclass(frozen=True, kw_only=True)
class CheckScene(Request):
    """Look for faults that would spoil a sweep of a scene; answers ``findings``."""

    scene: Path
    chosen: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class TrialRender(Request):
    """Render a few poses of a sweep and discard them; answers the fields of `generator.jobs.budget.TrialResult`.

    Attributes
    ----------
    scene : Path
    chosen : mapping
        Fields of `Sweep` that the user chose.
    threads : int
        Threads of the worker; 0 takes all cores.
    share, shares : int
        Number of this worker, from 0, and how many workers run at the same time.
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
    """Write ``wall.exr`` and ``background.exr`` into a folder; answers ``rendered``."""

    scene: Path
    folder: Path
    chosen: Mapping[str, Any]
    denoise: bool


@dataclass(frozen=True, kw_only=True)
class DrawExperiment(Request):
    """Write the pictures of one of the paper's experiments to a file; answers ``drawn``."""

    scene: Path
    file: Path
    number: int
    device: str = "cpu"


@dataclass(frozen=True, kw_only=True)
class WriteAssets(Request):
    """Write the library of assets into a folder; answers ``assets``, their names."""

    folder: Path
    trust_links: bool = False


@dataclass(frozen=True, kw_only=True)
class ReadMesh(Request):
    """Read the mesh of a target (`generator.blender.scene.mesh_file`); answers ``read`` and ``left_out``.

    Attributes
    ----------
    target : mapping
        Fields of `generator.model.scene.Target`.
    file : Path
        Where the arrays are written.
    """

    target: Mapping[str, Any]
    file: Path


@dataclass(frozen=True, kw_only=True)
class ReadWorld(Request):
    """Write what of a scene matters to its light to a file (`world_file.save_world`); answers ``described``.

    Attributes
    ----------
    scene : Path
        A ``.blend`` file, or a description, ``.toml``.
    file : Path
        Where the world is written.
    resolution : sequence of int
        Width and height of the pictures.
    """

    scene: Path
    file: Path
    resolution: Sequence[int]


@dataclass(frozen=True, kw_only=True)
class CorrectScene(Request):
    """Write a scene with some values changed (`generator.transport.parameters`); answers ``corrected``.

    Attributes
    ----------
    scene, file : Path
        A ``.blend`` file, or a description, ``.toml``; and where the new one is written.
    offsets : mapping
        What is added to values.
    """

    scene: Path
    file: Path
    offsets: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Question:
    """What `DrawLook` is asked for a picture of.

    Attributes
    ----------
    number : int
        Comes back with each answer; rises.
    world : str
        File that `world_file.save_world` wrote.
    accuracy : float
    position, rotation : sequence of float
        As `Transport.difference` takes them: metres, degrees.
    shadows : bool
        Whether the light of the room that the target hides is wanted too.
    """

    number: int
    world: str
    accuracy: float
    position: Sequence[float]
    rotation: Sequence[float]
    shadows: bool

    @property
    def line(self) -> str:
        """The question as the worker reads it."""
        return json.dumps(asdict(self))


@dataclass(frozen=True, kw_only=True)
class PictureQuestion:
    """What `AnswerPictures` is asked about.

    Attributes
    ----------
    number : int
        Comes back with the answer; rises.
    world : str
        File that `world_file.save_world` wrote, of the scene that the picture is of.
    shape : (int, int, int)
        Height, width and channels of the picture.
    pixels : str
        Change due to the target, float32, W/m^2/sr, as base64.
    grid : dict
        The scene's voxel grid, as `files.toml.to_dict` gives it.
    target : str
        Kind of the scene's target.
    colour_space : str
        Linear colour space of the channels.
    """

    number: int
    world: str
    shape: Sequence[int]
    pixels: str
    grid: Mapping[str, Any]
    target: str
    colour_space: str

    @property
    def line(self) -> str:
        """The question as the worker reads it."""
        return json.dumps(asdict(self))


@dataclass(frozen=True, kw_only=True)
class PlanBulk(PlanSweep):
    """Plan a bulk set, and check it at its start; answers ``planned`` and ``notes``."""

    module: ClassVar[str] = "generator.blender.bulk_worker"


@dataclass(frozen=True, kw_only=True)
class RenderBulk(RenderSweep):
    """Render parts of a bulk set; takes their numbers, and answers each with ``part``."""

    module: ClassVar[str] = "generator.blender.bulk_worker"


@dataclass(frozen=True, kw_only=True)
class DrawLook(Request):
    """Draw what the target changes at one pose after another; takes a `Question` a line."""

    module: ClassVar[str] = "generator.jobs.look_worker"
    trust_links: bool = False


@dataclass(frozen=True, kw_only=True)
class AnswerPictures(Request):
    """Say for one picture after another in which voxel the target stands; takes a `PictureQuestion` a line.

    Attributes
    ----------
    model : Path
        A trained model, or an atlas.
    """

    module: ClassVar[str] = "classify.cli.answer_worker"
    trust_links: bool = False
    model: Path


REQUESTS = (
    PlanSweep,
    RenderSweep,
    CheckScene,
    TrialRender,
    RenderWall,
    DrawExperiment,
    ReadMesh,
    WriteAssets,
    ReadWorld,
    CorrectScene,
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
    """Send an answer to the coordinator."""
    print(ANSWER + json.dumps(fields), flush=True)


def batches() -> Iterable[dict[int, int]]:
    """Report that this process is ready, and yield the batches sent to it: unit numbers, each with its samples."""
    answer(ready=True)
    for line in sys.stdin:
        pairs = (word.partition(":") for word in line.split())
        yield {int(number): int(samples or 0) for number, _, samples in pairs}
