"""The verb ``calibrate``: what nobody knows exactly of a room, from measured pictures of it."""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from classify.cli.options import add_seed, add_sensor_options, check_output, progress_bar, sensor_of
from generator.cli.answer import Answer, Table, json_object, plain
from generator.cli.options import Commands
from generator.model.described import described
from generator.model.errors import NlosError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from classify.calibration.fit import Calibration
    from classify.calibration.predicted import Predicted
    from generator.model.uncertainty import Uncertainty

DEFAULT = {
    **{f"spot.location.{axis}": 0.03 for axis in "xyz"},
    **{f"spot.aim.{axis}": 0.02 for axis in "xz"},
    "spot.half_angle": 0.1,
    "spot.power": 0.1,
    **{f"camera.location.{axis}": 0.03 for axis in "xyz"},
    **{f"camera.view.{axis}": 0.01 for axis in "xz"},
    "wall.albedo": 0.1,
    "room.albedo": 0.1,
    "target.albedo": 0.1,
    "target.size": 0.1,
    "ambient": 0.2,
}
"""Standard deviations that are taken where no file states any: what a tape and a guess of the paint give."""


def add_parsers(commands: Commands) -> None:
    """Add the verb ``calibrate`` to a command line."""
    parser = commands.add_parser(
        "calibrate",
        help="fit what is not known exactly of a room to pictures of it",
        description="Fit the lamp's place, aim, cone and power, the camera's view, and albedos to measured pictures "
        "of the empty scene and, if there are any, of the object at measured places. Say what they determine and "
        "what they do not, and whether what is left is noise; the exit code is 1 if it is not.",
        epilog="example:\n  nlos-classify calibrate room.blend empty.exr here.exr=1.2,0.8,1.0 --sensor mycamera.toml "
        "-o calibrated/",
    )
    parser.add_argument(
        "scene", type=Path, metavar="SCENE", help="the scene as it is thought to be: .blend, or .toml"
    )
    parser.add_argument(
        "pictures",
        nargs="+",
        metavar="PICTURE[=x,y,z]",
        help="pictures of radiance, .exr or .npy, or folders of data sets, whose empty scene is taken; of the empty "
        "scene, or with the place of the object, metres, and its rotation too (=x,y,z,rx,ry,rz, degrees)",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="for the calibrated scene")
    parser.add_argument(
        "--prior",
        type=Path,
        metavar="uncertainty.toml",
        help="standard deviations of what is not known exactly; the rest is taken as it is (default: 3 cm for lamp "
        "and camera, 2 cm for the aim, 1 cm for the view, 0.1 for albedos, 10 %% for power and size, and so on)",
    )
    parser.add_argument(
        "--background-frames", type=int, metavar="N", help="averaged for each empty picture (default: 100)"
    )
    for name, default, words in (
        ("black", 0.002, "black level, relative to the mean of the empty scene's picture"),
        ("vignetting", 0.0, "light that is missing in the corners, beyond what the sensor's file says"),
        ("level", 0.0, "the exposure, relative; what the lamp's power cannot be told from without other light"),
        ("place", 0.01, "each coordinate of the object's measured places, metres"),
    ):
        parser.add_argument(
            f"--{name}",
            type=float,
            default=default,
            metavar="D",
            help=f"standard deviation of {words}; 0 takes it as exact (default: {default:g})",
        )
    parser.add_argument(
        "--accuracy", type=float, default=1e-3, metavar="A", help="relative error of the engine (default: 0.001)"
    )
    add_sensor_options(parser)
    add_seed(parser, "of the noise that pictures of rendered sets get")
    parser.set_defaults(run=run_calibrate, answer=Calibrated)


@json_object
class Fitted:
    """A value that was fitted."""

    name: str = described("its name; lengths are metres, angles degrees, albedos absolute, the rest is relative")
    before: float = described("standard deviation of what was known")
    offset: float = described("what is added to the scene's value")
    deviation: float = described("standard deviation of what is known now")
    determined: bool = described("whether the pictures say anything: whether that is less than 0.9 times what it was")


@json_object
class Judged:
    """Whether what the fit leaves of the pictures is noise."""

    noise: bool = described("whether nothing speaks against it")
    p: float = described("p-value of the three tests together")
    chi_squared: float = described("sum of the squared residuals in units of the noise, relative to its expectation")
    p_chi_squared: float = described("probability of a value as far from 1")
    neighbours: float = described("correlation of neighbouring pixels")
    p_neighbours: float = described("probability of one as high")
    blocks: float = described("squared means of 16 parts of each picture, relative to their expectation")
    p_blocks: float = described("probability of a value as high")


@json_object
class Calibrated:
    """What was fitted to the pictures of a room."""

    fitted: list[Fitted] = described("the values")
    undetermined: list[str] = described("names of those that the pictures say nothing about; they stay as uncertain")
    verdict: Judged = described("whether what is left is noise")
    settled: bool = described("whether the fit has settled")
    slopes: int = described("how often derivatives were computed")
    words: list[str] = described("the same in sentences")
    files: list[Path] = described("files that were written")


def run_calibrate(options: argparse.Namespace) -> Answer:
    """Fit a scene to pictures, and write it, what stays uncertain, and what is left."""
    import json

    from classify.calibration import measured as pictures
    from classify.calibration.fit import fit
    from classify.calibration.predicted import Predicted
    from classify.report import calibration as report
    from generator.files.writing import write_text
    from generator.jobs.protocol import CorrectScene, ReadWorld
    from generator.transport.world_file import load_world

    check_output(options.output, folder=True)
    scene: Path = options.scene
    if scene.suffix.lower() not in (".blend", ".toml"):
        raise NlosError(f"{scene}: a scene must end in .blend, or in .toml if it is a description")
    if not scene.is_file():
        raise NlosError(f"{scene}: no such scene file")
    for name in ("black", "vignetting", "level", "place"):
        if not 0.0 <= getattr(options, name) < 1.0:
            raise NlosError(f"--{name} {getattr(options, name):g}: must be from 0 to below 1")
    sensor = sensor_of(options)
    if options.background_frames is not None:
        sensor = replace(sensor, background_frames=options.background_frames)
    seen = pictures.read(options.pictures, sensor, options.seed)
    height, width = seen.pictures.shape[1:]
    with tempfile.TemporaryDirectory(prefix="nlos-") as folder:
        file = Path(folder) / "world.npz"
        told = _asked(ReadWorld(scene=scene.absolute(), file=file, resolution=(width, height), trust_links=False))
        world = load_world(file)
    predicted = Predicted(world, seen.places, accuracy=options.accuracy, seen=seen.sensor.blurred)
    prior = _prior(options, told["described"], predicted)
    before, correlation = _with_own(options, prior, predicted)
    with progress_bar("fitting", "slopes") as progress:
        found = fit(
            *(predicted, seen.pictures, seen.variance, before),
            correlation=correlation,
            progress=lambda done, total: progress(done, total, ""),
        )
    options.output.mkdir(parents=True, exist_ok=True)
    result = options.output / f"scene{scene.suffix.lower()}"
    offsets = {name: value for name, value in zip(found.names, found.offsets.tolist(), strict=True) if value}
    changed = {name: value for name, value in offsets.items() if name in report.SCENE}
    _asked(CorrectScene(scene=scene.absolute(), file=result.absolute(), offsets=changed, trust_links=False))
    values = _values(found)
    values.files = [result, *report.write(options.output, found, seen, prior.furniture)]
    page = options.output / "calibration.json"
    values.files.append(page)
    write_text(page, json.dumps(plain(values), indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    rows = [
        [one.name, f"{one.before:.3g}", f"{one.offset:+.3g}", f"{one.deviation:.2g}", "" if one.determined else "no"]
        for one in values.fitted
    ]
    table = Table(f"{scene}: what is off", ["value", "known to", "offset", "now known to", "determined"], rows)
    return Answer(
        values, [table, *values.words, *map(str, values.files)], 0 if found.verdict.is_noise and found.settled else 1
    )


def _asked(request: Any) -> dict[str, Any]:
    """Return a Blender's answer to a request."""
    from generator.jobs.workers import Worker

    with Worker(request) as worker:
        if (answer := worker.answer()) is None:
            raise NlosError(f"{request.scene}: Blender could not read the scene: {worker.last_words()}")
        return answer


def _prior(options: argparse.Namespace, scene: dict[str, Any], predicted: Predicted) -> Uncertainty:
    """Return what is known beforehand of the scene."""
    from generator.files.uncertainty_file import read_uncertainty
    from generator.model.uncertainty import Uncertainty

    if options.prior is None:
        names = tuple(name for name in DEFAULT if name in predicted.names)
        return Uncertainty(names=names, deviation=tuple(DEFAULT[name] for name in names))
    prior = read_uncertainty(options.prior)
    try:
        prior.check(scene)
    except NlosError as error:
        raise NlosError(f"{options.prior}: {error}") from None
    if strange := [name for name in prior.names if name not in predicted.names]:
        raise NlosError(f"{options.prior}: {strange[0]} is nothing that this scene has; leave it out")
    return prior


def _with_own(
    options: argparse.Namespace, prior: Uncertainty, predicted: Predicted
) -> tuple[dict[str, float], NDArray[np.float64]]:
    """Return standard deviations and correlations of all that is fitted: of the scene, then of the camera."""
    import numpy as np

    own = {name: getattr(options, name) for name in ("level", "black", "vignetting")}
    own |= {name: options.place for name in predicted.names if name.startswith("place.")}
    own = {name: deviation for name, deviation in own.items() if deviation}
    joint = np.eye(len(prior.names) + len(own))
    if prior.correlation:
        joint[: len(prior.names), : len(prior.names)] = prior.correlation
    return {**dict(zip(prior.names, prior.deviation, strict=True)), **own}, joint


def _values(found: Calibration) -> Calibrated:
    verdict = found.verdict
    rows = zip(found.names, found.before.tolist(), found.offsets.tolist(), found.deviations.tolist(), strict=True)
    undetermined = list(found.undetermined)
    words = [verdict.words]
    if not found.settled:
        words.append(
            "the fit has not settled: the pictures are far from those of this scene; correct it by hand first"
        )
    if undetermined:
        words.append(f"the pictures say nothing, or hardly anything, about {', '.join(undetermined)}")
    words += found.bound_together()
    return Calibrated(
        fitted=[
            Fitted(name=n, before=b, offset=x, deviation=d, determined=n not in undetermined) for n, b, x, d in rows
        ],
        undetermined=undetermined,
        verdict=Judged(
            noise=verdict.is_noise,
            p=verdict.p,
            chi_squared=verdict.chi_squared / verdict.freedom,
            p_chi_squared=verdict.p_chi_squared,
            neighbours=verdict.neighbours,
            p_neighbours=verdict.p_neighbours,
            blocks=verdict.blocks,
            p_blocks=verdict.p_blocks,
        ),
        settled=found.settled,
        slopes=found.steps,
        words=words,
        files=[],
    )
