"""Requests for sweeps and bulk sets, from the command line, batch script, extension or a Python program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from generator.jobs.gpus import Gpus


@dataclass(frozen=True, kw_only=True)
class ClusterJobs:
    """An array of jobs that render a sweep.

    Attributes
    ----------
    shares : int
        Number of jobs of the array.
    executor : {"slurm", "local", "debug"}
        Where the jobs run: on Slurm; as processes of this machine; or in this process, one after the other.
    options : mapping
        Options of submitit's executor: ``slurm_partition``, ``timeout_min``, ``cpus_per_task``, ...
    """

    shares: int
    executor: str = "slurm"
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SetRequest:
    """The part of a request that sweeps and bulk sets have in common.

    Attributes
    ----------
    scene : Path
        The ``.blend`` file.
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
        Whether files that the scene refers to may lie outside its own folder.
    gpus : Gpus
        Those to render on where the device is a GPU, as Blender's preferences choose them; empty takes those of the
        Blender that renders.
    """

    scene: Path
    path: Path
    chosen: Mapping[str, Any] = field(default_factory=dict)
    workers: int = 0
    shard: tuple[int, int] = (0, 1)
    force: bool = False
    probe: bool = True
    trust_links: bool = False
    gpus: Gpus = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SweepRequest(SetRequest):
    """Request to render a data set, or to continue one; further attributes as of `SetRequest`.

    Attributes
    ----------
    accuracy : float
        Relative error of a difference picture that the samples or the engine's accuracy are chosen for; 0 if none is
        asked for.
    budget : float
        Seconds within which a new set is to be done; 0 for no limit.
    plan : Path, optional
        Plan that the sweep follows (`generator.sets.plan_file`).
    cluster : ClusterJobs, optional
        Render as jobs of a cluster, instead of processes of this machine.
    """

    accuracy: float = 0.0
    budget: float = 0.0
    plan: Path | None = None
    cluster: ClusterJobs | None = None


@dataclass(frozen=True, kw_only=True)
class BulkRequest(SetRequest):
    """Request to render a bulk set, or to continue one; attributes as of `SetRequest`."""
