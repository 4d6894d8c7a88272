"""What a sweep or a bulk set is asked for, whoever asks: command line, batch script, extension, a Python program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True, kw_only=True)
class ClusterJobs:
    """An array of jobs that render a sweep.

    Attributes
    ----------
    shares : int
        Jobs of the array.
    executor : {"slurm", "local", "debug"}
        Slurm; processes of this machine; or, one after the other, this process.
    options : mapping
        Of submitit's executor: ``slurm_partition``, ``timeout_min``, ``cpus_per_task``, ...
    """

    shares: int
    executor: str = "slurm"
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SetRequest:
    """What a sweep and a bulk set are both asked for.

    Attributes
    ----------
    scene : Path
        The ``.blend``.
    path : Path
        Folder of the set: new, empty, or holding the same set.
    chosen : mapping
        Settings that the user chose, `Sweep`'s or `generator.sets.bulk_settings.Settings`'. What is left out follows
        from the set if there is one, else from the scene and the defaults. The engine of a sweep may be ``auto``: the
        set's, or the cheapest that the scene allows. ``resolution`` may be text.
    workers : int
        Processes; 0 is one per core, or four that share a GPU.
    shard : (int, int)
        ``(i, n)``: the i-th of n parts only, i from 0.
    force : bool
        Begin a new set in spite of errors that the check finds in the scene.
    probe : bool
        Whether a new set begins with the check of its engine against plain Cycles (`generator.blender.start_check`).
    trust_links : bool
        Whether what the scene refers to may lie outside its own folder.
    """

    scene: Path
    path: Path
    chosen: Mapping[str, Any] = field(default_factory=dict)
    workers: int = 0
    shard: tuple[int, int] = (0, 1)
    force: bool = False
    probe: bool = True
    trust_links: bool = False


@dataclass(frozen=True, kw_only=True)
class SweepRequest(SetRequest):
    """A data set to be rendered, or gone on with; further attributes as of `SetRequest`.

    Attributes
    ----------
    accuracy : float
        Relative error of a difference picture for which samples or the engine's accuracy are measured out; 0 if none
        is asked for.
    budget : float
        Seconds, in which a new set is to end; 0 for no limit.
    plan : Path, optional
        Plan that the sweep follows (`generator.sets.plan_file`).
    cluster : ClusterJobs, optional
        Render as jobs of a cluster, in place of processes of this machine.
    """

    accuracy: float = 0.0
    budget: float = 0.0
    plan: Path | None = None
    cluster: ClusterJobs | None = None


@dataclass(frozen=True, kw_only=True)
class BulkRequest(SetRequest):
    """A bulk set to be made, or gone on with; attributes as of `SetRequest`."""
