"""Features and labels in HDF5, together with their provenance."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import joblib
import numpy as np
from numpy.typing import NDArray

from classify.pictures.features import describe, feature_names, software
from classify.pictures.sensor import Camera, Sensor
from classify.pictures.settings import FeatureSettings, Setup
from generator.files.limits import check_heaps, exceeds_limit, limited
from generator.files.pictures import COLOUR_SPACE, Picture
from generator.files.toml import from_dict, to_dict
from generator.files.writing import atomic
from generator.model.errors import NlosError
from generator.model.grid import VoxelGrid
from generator.model.poses import PoseRecord
from generator.model.scene import Scene
from generator.sets.measured import has_own_noise
from generator.sets.readable import PictureSet, check_colours

FORMAT = 1

_BLOCK, _FEW = 64, 32
"""Pictures per block, and number of blocks up to which one process is as fast as several."""
_VARIED = "varied "
"""Start of the names of the columns of what varies from pose to pose."""
_SPARE, _COPIES = 2**28, 3
"""Memory that reading a file may take: bytes, plus this many times the size that the file declares."""


@dataclass(frozen=True)
class Features:
    """The features of one data set.

    Attributes
    ----------
    values : ndarray of shape (n_samples, n_features), float64
        Not scaled, since scaling belongs inside the folds.
    names : list of str
    labels : ndarray of shape (n_samples,), str
        Voxel of the object; of several objects, those of all, such as A+C.
    voxels : ndarray of shape (n_samples,), int
    positions, rotations : ndarray of shape (n_samples, 3), float64
        Metres and degrees.
    files : list of str
    background : ndarray of shape (height, width, 3), float32
        Background picture, W/m^2/sr.
    reference_radiance : float
        Reference radiance of the scene, W/m^2/sr.
    settings : FeatureSettings
    grid : VoxelGrid
    target : str
        sheet, sphere or mesh.
    provenance : dict
        The data set's name, fingerprint, sweep settings and software.
    varied : dict of str to ndarray of shape (n_samples,)
        What varies from pose to pose (`generator.model.variation`), by name; no feature, only metadata.
    """

    values: NDArray[np.float64]
    names: list[str]
    labels: NDArray[np.str_]
    voxels: NDArray[np.int64]
    positions: NDArray[np.float64]
    rotations: NDArray[np.float64]
    files: list[str]
    background: Picture
    reference_radiance: float
    settings: FeatureSettings
    grid: VoxelGrid
    target: str
    provenance: dict[str, Any]
    varied: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    @property
    def colour_space(self) -> str:
        """The linear colour space of the pictures."""
        return str(self.provenance.get("colour_space", COLOUR_SPACE))

    @property
    def contents(self) -> str:
        """What the pictures show, in words: of one object of fixed reflectivity its kind, such as sphere."""
        count = 1 + max((str(label).count("+") for label in self.labels), default=0)
        words = self.target
        if count > 1:
            words = f"{count} {'meshes' if words == 'mesh' else f'{words}s'}"
        return f"{words} with varied {' and '.join(self.varied)}" if self.varied else words

    @property
    def duplicates(self) -> int:
        """Number of pictures whose features equal those of an earlier one."""
        return len(self.values) - len(np.unique(self.values, axis=0))


def extract(
    dataset: PictureSet,
    settings: FeatureSettings,
    *,
    partial: bool = False,
    sensor: Sensor | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Features:
    """Describe every picture of a data set.

    Parameters
    ----------
    dataset : Dataset or SimulatedSet
    settings : FeatureSettings
        If they ask for ``physics`` without a setup, that of the data set's scene is taken.
    partial : bool
        Whether to accept an unfinished data set.
    sensor : Sensor, optional
        Sensor that sees the pictures; without one, their clean radiance is described.
    seed : int
        Seed of the sensor's noise.
    progress : callable
        Called with (done, total), in pictures.

    Raises
    ------
    NlosError
        If the data set is unfinished or empty, or a picture is broken or holds NaN.
    """
    records = dataset.records
    if not records:
        raise NlosError(f"{dataset.path}: holds no finished picture yet")
    if sensor is not None and has_own_noise(dataset):
        raise NlosError(f"{dataset.path}: its pictures have noise of their own; leave out --sensor and --frames")
    if unknown := [record.file for record in records if not record.label]:
        raise NlosError(
            f"{dataset.path / unknown[0]}: it is not known where the object stood, so nothing can be learnt from it; "
            "give the set to nlos-classify predict"
        )
    if len(records) < dataset.planned and not partial:
        raise NlosError(
            f"{dataset.path}: only {len(records)} of {dataset.planned} pictures are rendered; finish the sweep, or "
            "take it as it is with --partial"
        )
    if settings.set == "physics" and settings.setup is None:
        settings = replace(settings, setup=Setup.of(from_dict(Scene, dataset.meta["scene"], "scene.")))
    camera = dataset if sensor is None else Camera(dataset, sensor, seed)
    background = camera.background()
    shared = None if dataset.own_backgrounds else background
    blocks = [records[start : start + _BLOCK] for start in range(0, len(records), _BLOCK)]
    # Starting a process costs more than describing a few pictures.
    workers = joblib.Parallel(n_jobs=-1 if len(blocks) > _FEW else 1, return_as="generator")
    rows: list[NDArray[np.float64]] = []
    for block_rows in workers(
        joblib.delayed(_described)(camera, dataset.path, block, settings, dataset.reference_radiance, shared)
        for block in blocks
    ):
        rows += block_rows
        progress(len(rows), len(records))
    return Features(
        values=np.array(rows),
        names=feature_names(settings),
        labels=np.array([r.answer for r in records]),
        voxels=np.array([r.voxel for r in records]),
        positions=np.array([r.position for r in records]),
        rotations=np.array([r.rotation for r in records]),
        files=[r.file for r in records],
        background=background,
        reference_radiance=dataset.reference_radiance,
        settings=settings,
        grid=dataset.grid,
        target=dataset.target_kind,
        provenance={
            "dataset": dataset.path.resolve().name,
            "fingerprint": dataset.meta["fingerprint"],
            "colour_space": dataset.colour_space,
            "sweep": dataset.settings,
            **({"sensor": asdict(camera.sensor), "noise_seed": seed} if isinstance(camera, Camera) else {}),
            "software": {**dataset.meta.get("software", {}), **software()},
        },
        varied={
            name: np.array([record.values[k][1] for record in records])
            for k, (name, _) in enumerate(records[0].values)
        },
    )


def _described(
    camera: PictureSet | Camera,
    path: Path,
    records: Sequence[PoseRecord],
    settings: FeatureSettings,
    reference: float,
    shared: Picture | None,
) -> list[NDArray[np.float64]]:
    """Features of the pictures of some records, which share a background, or have one each if it is None."""
    return [
        describe(
            camera.picture(record),
            settings,
            reference=reference,
            background=camera.background_of(record) if shared is None else shared,
            name=str(path / record.file),
        )
        for record in records
    ]


def write(path: Path, features: Features) -> None:
    """Write features to a temporary HDF5 file, and rename it."""
    text = h5py.string_dtype()
    with atomic(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"] = FORMAT
        file.attrs["target"] = features.target
        file.attrs["reference_radiance"] = features.reference_radiance
        file.attrs["settings"] = features.settings.to_json()
        file.attrs["grid"] = json.dumps(to_dict(features.grid))
        file.attrs["provenance"] = json.dumps(features.provenance)
        file["features"] = features.values
        file["voxel"] = features.voxels
        file["position"] = features.positions
        file["rotation"] = features.rotations
        file["background"] = features.background
        file.create_dataset("feature_names", data=features.names, dtype=text)
        file.create_dataset("label", data=features.labels.tolist(), dtype=text)
        file.create_dataset("file", data=features.files, dtype=text)
        file["features"].attrs["about"] = "one row per picture, columns named in feature_names; not scaled"
        file["position"].attrs["units"] = "m"
        file["rotation"].attrs["units"] = "degrees about x, y, z"
        file["background"].attrs["units"] = "W/m^2/sr"
        for name, values in features.varied.items():
            file[f"{_VARIED}{name}"] = values


@contextlib.contextmanager
def open_table(path: Path, what: str, newest: int) -> Iterator[Any]:
    """Open an HDF5 file of this software for reading; any fault is raised as one sentence.

    Parameters
    ----------
    path : Path
    what : str
        Kind of contents that the file should have, for messages.
    newest : int
        Newest format that can be read.

    Raises
    ------
    NlosError
        If the file is missing, has a newer format, refers to other files, or holds something else.
    """
    if not path.is_file():
        raise NlosError(f"{path}: no such {what} file")
    try:
        check_heaps(path)
        with h5py.File(path, "r") as file:
            with limited(_SPARE):
                claimed = _check_inside(file, what, newest)
            if exceeds_limit(claimed, size := path.stat().st_size):
                raise NlosError(f"claims {claimed} bytes in {size}")
            with limited(_SPARE + _COPIES * claimed):
                yield file
    except NlosError as error:
        raise NlosError(f"{path}: {error}") from None
    except Exception as error:  # many kinds: from HDF5, its types and JSON
        article = "an" if what[0] in "aeiou" else "a"
        raise NlosError(f"{path}: is not {article} {what} file of this software ({error})") from None


def _check_inside(file: Any, what: str, newest: int) -> int:
    """Return the bytes that an open HDF5 file declares; NlosError if it is newer, or refers to other files."""
    version = int(file.attrs["format"])
    if version > newest:
        raise NlosError(f"has {what} format {version}; this software reads up to {newest}, so update it")
    claimed = 0
    for name in file:
        if not isinstance(file.get(name, getlink=True), h5py.HardLink):
            raise NlosError(f"{name} is a link to somewhere else, which is not followed")
        if file[name].external or file[name].is_virtual:  # HDF5 would read any file that is named there
            raise NlosError(f"{name} lies in another file, which is not followed")
        claimed += file[name].nbytes
    return claimed


def numbers(file: Any, name: str, dtype: Any) -> NDArray[Any]:
    """Return a dataset of an open HDF5 file as floats or integers; ValueError if it has another type."""
    dataset = file[name]
    if dataset.dtype.kind not in ("iu" if np.issubdtype(dtype, np.integer) else "iuf"):
        raise ValueError(f"{name} holds {dataset.dtype}")
    with np.errstate(over="ignore"):  # too large a number becomes infinite, which the callers reject
        return np.asarray(dataset[()], dtype=dtype)


def texts(file: Any, name: str) -> list[str]:
    """Return a dataset of an open HDF5 file as strings."""
    return list(map(str, file[name].asstr()[()]))


def read(path: Path) -> Features:
    """Read features.

    Raises
    ------
    NlosError
        If the file is missing, has a newer format, or does not hold features.
    """
    with open_table(path, "features", FORMAT) as file:
        features = Features(
            values=numbers(file, "features", np.float64),
            names=texts(file, "feature_names"),
            labels=np.array(texts(file, "label"), dtype=np.str_),
            voxels=numbers(file, "voxel", np.int64),
            positions=numbers(file, "position", np.float64),
            rotations=numbers(file, "rotation", np.float64),
            files=texts(file, "file"),
            background=numbers(file, "background", np.float32),
            reference_radiance=float(file.attrs["reference_radiance"]),
            settings=FeatureSettings.from_json(str(file.attrs["settings"])),
            grid=from_dict(VoxelGrid, json.loads(str(file.attrs["grid"])), "grid."),
            target=str(file.attrs["target"]),
            provenance=json.loads(str(file.attrs["provenance"])),
            varied={
                name.removeprefix(_VARIED): numbers(file, name, np.float64)
                for name in file
                if name.startswith(_VARIED)
            },
        )
    if features.background.ndim != 3 or features.background.shape[2] != 3:
        raise NlosError(f"{path}: its background has shape {features.background.shape}, not (height, width, 3)")
    provenance = features.provenance
    if not isinstance(provenance, dict) or not isinstance(provenance.get("sensor", {}), dict):
        raise NlosError(f"{path}: does not tell where its features come from (attribute provenance)")
    columns: list[Any] = [features.labels, features.voxels, features.positions, features.rotations, features.files]
    columns += features.varied.values()
    if features.values.ndim != 2 or {features.positions.ndim, features.rotations.ndim} != {2}:
        raise NlosError(f"{path}: its features and poses are not tables")
    if any(len(column) != len(features.values) for column in columns):
        raise NlosError(f"{path}: its features, labels and poses differ in length")
    if features.names != feature_names(features.settings) or len(features.names) != features.values.shape[1]:
        raise NlosError(f"{path}: its feature names are not those of its settings")
    unknown = sorted({name for label in features.labels for name in label.split("+")} - set(features.grid.labels))
    if unknown:
        raise NlosError(f"{path}: has the label {unknown[0]}, which its grid of {features.grid.n_voxels} lacks")
    if not 0.0 <= features.reference_radiance < float("inf"):
        raise NlosError(f"{path}: its reference radiance is {features.reference_radiance}, not 0 or more")
    if not np.isfinite(features.values).all():
        raise NlosError(f"{path}: holds NaN or infinite features; extract them again")
    return features


def check_comparable(a: Features, b: Features, names: tuple[str, str]) -> None:
    """Raise NlosError that names the difference, unless a model of one file can be tested on the other."""
    if a.grid != b.grid:
        raise NlosError(
            f"{names[0]} and {names[1]}: have different voxel grids ({_grid(a.grid)} against {_grid(b.grid)}), so "
            "their labels mean different places; compare data sets of one grid"
        )
    check_colours(Path(names[0]), a.colour_space, b.colour_space, names[1])
    # A file from before a setting was there is of its default.
    sensors = [
        f.provenance.get("sensor") and {**asdict(Sensor()), **f.provenance["sensor"], "exposure": 0.0} for f in (a, b)
    ]
    if sensors[0] != sensors[1]:
        raise NlosError(
            f"{names[0]} and {names[1]}: were seen by different sensors; extract both with one --sensor and --frames"
        )
    if a.settings != b.settings:
        ours, theirs = json.loads(a.settings.to_json()), json.loads(b.settings.to_json())
        unequal = ", ".join(f"{k} is {ours[k]} and {theirs[k]}" for k in ours if ours[k] != theirs[k])
        raise NlosError(f"{names[0]} and {names[1]}: have different feature settings ({unequal}); extract both alike")


def _grid(grid: VoxelGrid) -> str:
    count = " x ".join(map(str, grid.shape))
    return f"{count} voxels from {grid.lo} to {grid.hi} m"
