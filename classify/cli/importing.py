"""The verb ``import``: a camera's pictures become a data set."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from classify.cli.options import check_output, progress_bar
from generator.cli.answer import Answer, json_object
from generator.cli.options import Commands, group_of
from generator.model.described import described
from generator.model.errors import NlosError
from generator.model.quantities import parse_resolution

if TYPE_CHECKING:
    from classify.pictures.importing import Geometry
    from generator.sets.description import Description


def add_parsers(commands: Commands) -> None:
    """Add the verb ``import`` to a command line."""
    parser = commands.add_parser(
        "import",
        help="take a camera's pictures into a data set",
        description="Turn a camera's pictures into a data set: black level, flat field, exposure, colours, lens and "
        "perspective are corrected, pixels averaged to those of the scene, brightness brought to the scene's by the "
        "pictures of the empty scene. All that was done is written into its dataset.toml.",
        epilog="example:\n  nlos-classify import captures/ --background empty/ --dark dark/ --like simulated/ "
        "--corners 212 96 934 120 921 860 225 841 --electrons 2.1 -o photographs/\n"
        "  nlos-classify locate room.atlas photographs/",
    )
    files = "files or folders: PNG, TIFF, EXR, NPY, raw files, videos"
    parser.add_argument("pictures", type=Path, nargs="+", metavar="PICTURES", help=files)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SET", help="folder of the data set")
    scene = group_of(parser, "scene and labels")
    scene.add_argument(
        "--like",
        type=Path,
        metavar="SET|FILE.toml",
        help="the scene: a data set of it, or what nlos-generate describe wrote; its voxels, the rectangle that the "
        "camera watches, and a set's picture of the empty scene, to which brightness is brought",
    )
    scene.add_argument("--resolution", metavar="64|64x48", help="of the pictures to make (default: the scene's)")
    scene.add_argument(
        "--labels",
        type=Path,
        metavar="FILE.csv",
        help="where the object stood: columns file, and label, or x, y, z in metres, and rx, ry, rz in degrees, as "
        "far as known; and exposure (default: folders that are named like voxels, or nothing)",
    )
    scene.add_argument("--burst", type=int, default=1, metavar="N", help="average every N frames (default: 1)")
    camera = group_of(parser, "camera")
    for name, words in (
        ("background", "pictures of the empty scene"),
        ("dark", "frames without light, exposed as long"),
        ("flat", "frames of an evenly lit surface"),
    ):
        camera.add_argument(f"--{name}", type=Path, nargs="+", default=[], metavar="FILES", help=words)
    camera.add_argument("--black", type=float, metavar="V", help="black level (default: the file's, or 0)")
    camera.add_argument(
        "--white", type=float, metavar="V", help="value of a saturated pixel (default: the format's largest)"
    )
    camera.add_argument(
        "--gamma",
        metavar="srgb|G|1",
        help="undo a gamma that is in the values; 1: there is none, whatever the file states (default: none; files "
        "that state one are refused)",
    )
    camera.add_argument(
        "--saturated",
        choices=["refuse", "mask"],
        default="refuse",
        help="refuse saturated pixels on the patch, or leave them out in all frames (default: refuse)",
    )
    camera.add_argument("--mask", type=Path, metavar="FILE", help="picture that is 0 where pixels are to be left out")
    camera.add_argument(
        "--weights", type=float, nargs=3, metavar=("R", "G", "B"), help="of the colours in grey (default: alike)"
    )
    camera.add_argument(
        "--electrons",
        type=float,
        metavar="N",
        help="electrons per unit of the file, 1/K of EMVA 1288 (default: measured between frames of one scene)",
    )
    camera.add_argument("--read-noise", type=float, metavar="E", help="electrons (default: 0, or the sensor's)")
    camera.add_argument(
        "--sensor", type=Path, metavar="FILE.toml", help="the camera: its full well, bits and read noise, for the two"
    )
    camera.add_argument(
        "--level", type=float, metavar="L", help="W/m²/sr per unit (default: by the pictures of the empty scene)"
    )
    place = group_of(parser, "lens and perspective")
    place.add_argument(
        "--corners",
        type=float,
        nargs=8,
        metavar="C",
        help="column and row of the corners of a rectangle on the wall: top left, top right, bottom right, bottom "
        "left; the centre of the first pixel is 0 0 (default: the picture shows the watched rectangle)",
    )
    place.add_argument(
        "--rectangle",
        type=float,
        nargs=4,
        metavar=("X0", "X1", "Z0", "Z1"),
        help="that rectangle, metres (default: the one that the scene's camera watches)",
    )
    place.add_argument(
        "--marks", type=Path, metavar="FILE.csv", help="points in place of corners: columns column, row, x, z"
    )
    place.add_argument(
        "--lens", type=Path, metavar="FILE.toml", help="camera_matrix and distortion, as OpenCV calibrates them"
    )
    parser.set_defaults(run=run_import, answer=Taken)


@json_object
class Taken:
    """Pictures that were taken in."""

    path: Path = described("folder of the data set")
    pictures: int = described("number of its pictures")
    labelled: int = described("number of pictures whose voxel is known")
    placed: int = described("number of pictures whose position is known")
    level: float = described("W/m²/sr per unit of the files")
    mismatch: float | None = described(
        "difference in shape between the empty scene and the scene's picture of it; null if one is missing"
    )
    electrons: float | None = described("electrons per W/m²/sr in a pixel of a frame; null if the noise is unknown")
    read_noise: float | None = described("electrons in such a pixel; null if the noise is unknown")
    notes: list[str] = described("what was found, in sentences")


def run_import(options: argparse.Namespace) -> Answer:
    """Take a camera's pictures into a data set."""
    from classify.pictures import importing
    from generator.sets import description

    check_output(options.output, folder=True)
    like = None if options.like is None else description.read(options.like)
    sources = importing.Sources(
        pictures=options.pictures,
        background=options.background,
        dark=options.dark,
        flat=options.flat,
        labels=options.labels,
        mask=options.mask,
    )
    electrons, read_noise, black = _of_sensor(options)
    treatment = importing.Treatment(
        black=black,
        white=options.white,
        gamma=options.gamma,
        weights=tuple(options.weights or (1.0, 1.0, 1.0)),
        saturated=options.saturated,
        burst=options.burst,
        electrons=electrons,
        read_noise=read_noise,
        level=options.level,
    )
    with progress_bar("importing", "files") as progress:
        made = importing.run(
            sources,
            treatment,
            _geometry(options, like),
            like,
            options.output,
            progress=lambda done, total: progress(done, total, ""),
        )
    records = made.dataset.records
    sensor = made.dataset.meta.get("sensor")
    values = Taken(
        path=options.output,
        pictures=len(records),
        labelled=sum(record.voxel >= 0 for record in records),
        placed=sum(record.placed for record in records),
        level=made.level,
        mismatch=made.mismatch,
        electrons=sensor["exposure"] if sensor else None,
        read_noise=sensor["read_noise"] if sensor else None,
        notes=made.notes,
    )
    line = f"{options.output}: {values.pictures} pictures, of which {values.labelled} with a label"
    return Answer(values, [*(f"note: {note}" for note in made.notes), line])


def _of_sensor(options: argparse.Namespace) -> tuple[float | None, float, float | None]:
    """Electrons per unit, read noise and black level, as given or as a sensor has them."""
    if options.sensor is None:
        if options.read_noise is not None and options.electrons is None:
            raise NlosError("--read-noise: means nothing without --electrons")
        return options.electrons, options.read_noise or 0.0, options.black
    from classify.cli.options import sensor_of

    sensor = sensor_of(argparse.Namespace(sensor=options.sensor, frames=None))
    if options.electrons is None and not sensor.bits:
        raise NlosError(f"{options.sensor}: has no bits, so its electrons per unit are unknown; state --electrons")
    electrons = options.electrons if options.electrons is not None else sensor.electrons_per_level
    black = sensor.black_level or None if options.black is None and not options.dark else options.black
    return electrons, sensor.read_noise if options.read_noise is None else options.read_noise, black


def _geometry(options: argparse.Namespace, like: Description | None) -> Geometry:
    """Where the watched rectangle lies, and how many pixels it gets."""
    from classify.pictures import rectify
    from classify.pictures.importing import Geometry, read_table

    if options.resolution is not None:
        resolution = parse_resolution(options.resolution)
    elif like is not None:
        resolution = like.resolution
    else:
        raise NlosError("--resolution: is needed where no scene is named (--like)")
    watched = None if like is None else like.watched
    given = options.rectangle
    if given is not None and not (given[0] < given[1] and given[2] < given[3]):
        raise NlosError(f"--rectangle {' '.join(map(str, given))}: must run from low to high")
    rectangle = None if given is None else ((given[0], given[1]), (given[2], given[3]))
    x, z = watched or rectangle or ((0.0, float(resolution[0])), (0.0, float(resolution[1])))
    lens = None if options.lens is None else rectify.Lens.read(options.lens)
    if options.corners is not None and options.marks is not None:
        raise NlosError("--corners and --marks: exclude each other")
    if options.marks is not None:
        marks = rectify.read_marks(read_table(options.marks), options.marks, lens)
    elif options.corners is not None:
        marks = rectify.Marks.of_corners(options.corners, *(rectangle or (x, z)), lens)
    elif lens is not None or rectangle is not None:
        raise NlosError("--lens and --rectangle: need --corners or --marks, which say where the wall is")
    else:
        marks = None
    return Geometry(x=x, z=z, resolution=resolution, marks=marks)
