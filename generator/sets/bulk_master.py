"""The master of a bulk set: one HDF5 file that shows all parts as one (virtual datasets)."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from generator.files.limits import MUCH, check_heaps, limited
from generator.files.pictures import Picture
from generator.files.toml import to_dict
from generator.sets.bulk_part import PART_FORMAT
from generator.sets.bulk_settings import Layout
from generator.sets.hdf5 import VERSIONS, describe_file


@dataclass(frozen=True)
class Master:
    """Contents of the master file.

    Attributes
    ----------
    layout : Layout
    background : ndarray of shape (height, width, 3), float32
        Picture without the hidden object, W/m^2/sr.
    reference_radiance : float
        Radiance of the directly lit patch around w1, W/m^2/sr.
    """

    layout: Layout
    background: Picture
    reference_radiance: float

    def image(self) -> bytes:
        """Return the file's bytes."""
        with h5py.File("set", "w", driver="core", backing_store=False, libver=VERSIONS) as file:
            self._describe(file)
            file.flush()
            image: bytes = file.id.get_file_image()
        return image

    def _describe(self, file: Any) -> None:
        layout = self.layout
        columns = {**dict.fromkeys(layout.images, (layout.picture_shape, "<f4")), **layout.columns}
        # A part that is removed later reads as the fill value: NaN, which cannot be mistaken for a picture.
        for name, (shape, dtype) in columns.items():
            table = h5py.VirtualLayout((layout.plan.pictures, *shape), dtype)
            for number in range(layout.parts):
                rows = layout.part_range(number)
                source = h5py.VirtualSource(layout.part_path(number).name, name, (len(rows), *shape), dtype)
                table[rows.start : rows.stop] = source
            file.create_virtual_dataset(name, table, fillvalue=-1 if np.dtype(dtype).kind == "i" else np.nan)
        describe_file(file, layout.plan.varying)
        file["background"] = self.background
        file["background"].attrs["units"] = "W/m^2/sr"
        file.create_dataset("label", data=layout.grid.labels, dtype=h5py.string_dtype())
        file["label"].attrs["about"] = "names of the voxels: row v is voxel v's"
        file.attrs.update(
            format=PART_FORMAT,
            fingerprint=layout.fingerprint,
            reference_radiance=self.reference_radiance,
            **{f"grid_{name}": value for name, value in to_dict(layout.grid).items()},
        )

    def is_in(self, path: Path) -> bool:
        """Whether a file exists and has these contents."""
        try:
            check_heaps(path)
            with (
                h5py.File(path, "r") as file,
                h5py.File(io.BytesIO(self.image()), "r") as wanted,
                limited(MUCH),
            ):
                return set(file) == set(wanted) and all(
                    _told(file, name) == _told(wanted, name) for name in ("/", *wanted)
                )
        except Exception:  # HDF5 and h5py raise errors of many kinds
            return False


def _told(file: Any, name: str) -> Any:
    """Return the attributes of an HDF5 dataset or group, and a dataset's values, or the sources of a virtual one."""
    if name != "/" and not isinstance(file.get(name, getlink=True), h5py.HardLink):
        return None
    item = file[name]
    attributes = {name: np.asarray(value).tolist() for name, value in item.attrs.items()}
    if not isinstance(item, h5py.Dataset) or item.external:
        return attributes
    if not item.is_virtual:
        return attributes, item.shape, item.dtype.str, np.asarray(item[()]).tolist()
    sources = [
        (m.file_name, m.dset_name, m.vspace.get_select_bounds(), m.src_space.get_select_type())
        for m in item.virtual_sources()
    ]
    return attributes, item.shape, item.dtype.str, repr(item.fillvalue), sorted(sources)
