"""The verb ``sensor``: a camera's figures from bursts of frames."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from classify.cli.options import check_output, progress_bar
from generator.cli.answer import Answer, Interval, Table, interval, json_object
from generator.cli.options import Commands
from generator.model.described import described
from generator.model.errors import NlosError

if TYPE_CHECKING:
    from classify.pictures.burst import Burst

_UNITS = {
    "gain": "grey levels/electron",
    "dark_current": "electrons/s",
    **dict.fromkeys(("read_noise", "temporal_dark_noise", "full_well", "row_noise", "column_noise"), "electrons"),
    **dict.fromkeys(("offset_spread", "dsnu_pixel", "dsnu_row", "dsnu_column"), "electrons"),
    "quantum_efficiency": "electrons/photon",
}
"""Units of figures; the others are shares of 1."""
_NAMES = {
    "gain": "overall system gain K",
    "read_noise": "read noise of a pixel",
    "temporal_dark_noise": "temporal dark noise",
    "full_well": "full well",
    "dark_current": "dark current",
    "row_noise": "noise of rows",
    "column_noise": "noise of columns",
    "gain_spread": "PRNU",
    "offset_spread": "DSNU",
    "nonlinearity": "non-linearity at full well",
    "linearity_error": "linearity error",
    "flicker": "flicker of the light",
    "quantum_efficiency": "quantum efficiency",
}


def add_parsers(commands: Commands) -> None:
    """Add the verb ``sensor`` to a command line."""
    parser = commands.add_parser(
        "sensor",
        help="measure a camera: gain, noise, full well, dark current",
        description="Measure a camera's sensor from bursts of frames of a steady, even scene at several exposure "
        "times, and from bursts with the lens covered: by photon transfer (EMVA 1288, release 4.0), with 95 % "
        "intervals, into a file that --sensor takes.",
        epilog="example:\n  nlos-classify sensor light/1ms light/2ms light/5ms light/10ms light/20ms --dark dark/1ms "
        "dark/1s -o sensor.toml",
    )
    parser.add_argument(
        "bursts",
        type=Path,
        nargs="+",
        metavar="BURST",
        help="folder of the frames of one level (PNG, TIFF, NPY, raw files), or a file that holds them; a name such "
        "as 10ms, 0.2s or 1_60s tells its exposure time",
    )
    parser.add_argument("--dark", type=Path, nargs="+", metavar="BURST", required=True, help="with the lens covered")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.toml")
    parser.add_argument(
        "--plot", type=Path, metavar="FILE", help="draw the curves: .png, with an .svg beside it, .svg or .pdf"
    )
    parser.add_argument("--times", type=float, nargs="+", metavar="S", help="exposure time of each BURST, seconds")
    parser.add_argument("--dark-times", type=float, nargs="+", metavar="S", help="of each burst of --dark, seconds")
    parser.add_argument(
        "--irradiance",
        type=float,
        nargs="+",
        metavar="E",
        help="of the chip at each BURST, W/m^2, by a photometer; with --pixel-size it gives the quantum efficiency",
    )
    parser.add_argument("--pixel-size", type=float, default=0.0, metavar="M", help="side of a pixel, metres")
    parser.add_argument(
        "--wavelength", type=float, default=550e-9, metavar="M", help="of the light, metres (default: 550e-9)"
    )
    parser.add_argument(
        "--bits", type=int, default=0, metavar="N", help="of the converter (default: what the values need)"
    )
    parser.add_argument(
        "--region", type=int, nargs=4, metavar=("X", "Y", "W", "H"), help="take this part of the frames, in pixels"
    )
    parser.add_argument("--channel", choices=("red", "blue"), default="", help="of raw files of a colour camera")
    parser.add_argument(
        "--mosaic",
        type=int,
        nargs=2,
        choices=(0, 1),
        metavar=("ROW", "COLUMN"),
        help="of grey frames of a colour mosaic take one pixel of each four",
    )
    parser.set_defaults(run=run_sensor, answer=Camera)


@json_object
class Figure:
    """A figure of a camera."""

    name: str = described("its name, as in the file")
    unit: str = described("its unit; empty for a share of 1")
    value: Interval = described("the figure")


@json_object
class Camera:
    """A camera's figures."""

    path: Path = described("the file that was written")
    figures: list[Figure] = described("figures, with their 95 % intervals")
    bits: int = described("bits of the converter; 0 where values were not whole numbers")
    black_level: float = described("mean grey level without light")
    doubts: list[str] = described("what speaks against these figures, in sentences; exit code 1 if anything does")
    files: list[Path] = described("files that were written")


def run_sensor(options: argparse.Namespace) -> Answer:
    """Measure a camera, and write its file."""
    from classify.pictures import burst, photon_transfer, sensor_file
    from classify.report import photon_transfer as drawing
    from generator.measure import figures

    check_output(options.output)
    if options.plot:
        check_output(options.plot)
        figures.check_format(options.plot)
    for name in ("pixel_size", "wavelength"):
        value = getattr(options, name)
        if not (math.isfinite(value) and value >= 0.0 and (value or name == "pixel_size")):
            raise NlosError(f"--{name.replace('_', '-')} {value:g}: must be a positive number of metres")
    if not 0 <= options.bits <= 32:
        raise NlosError(f"--bits {options.bits}: must be from 1 to 32")
    with progress_bar("reading", "bursts") as progress:
        paths = [*options.bursts, *options.dark]
        bursts: list[Burst] = []
        for path in paths:
            progress(len(bursts), len(paths), path.name)
            mosaic, region = (part and tuple(part) for part in (options.mosaic, options.region))
            bursts.append(burst.read(path, channel=options.channel, mosaic=mosaic, region=region))
    count = len(options.bursts)
    light = _known(bursts[:count], options.times, "--times", "time")
    light = _known(light, options.irradiance, "--irradiance", "irradiance")
    dark = _known(bursts[count:], options.dark_times, "--dark-times", "time")
    measured = photon_transfer.measure(
        light, dark, bits=options.bits, pixel_size=options.pixel_size, wavelength=options.wavelength
    )
    files = [options.output]
    sensor_file.write(options.output, measured)
    if options.plot:
        files += figures.save(options.plot, drawing.draw(measured))
    values = Camera(
        path=options.output,
        figures=[
            Figure(name=name, unit=_UNITS.get(name, ""), value=interval(one))
            for name, one in measured.intervals.items()
        ],
        bits=measured.sensor.bits,
        black_level=measured.offset,
        doubts=measured.doubts,
        files=files,
    )
    found = {figure.name: figure for figure in values.figures}
    shown = [found[name] for name in _NAMES if name in found]
    rows = [
        (_NAMES[one.name], *map(_number, (one.value.value, one.value.low, one.value.high)), one.unit) for one in shown
    ]
    table = Table("with 95 % intervals", ("figure", "value", "from", "to", "unit"), rows)
    return Answer(values, [table, *measured.doubts, *map(str, files)], 1 if measured.doubts else 0)


def _known(bursts: list[Burst], numbers: list[float] | None, option: str, field: str) -> list[Burst]:
    """Bursts with what an option tells of each."""
    if numbers is None:
        return bursts
    if len(numbers) != len(bursts):
        raise NlosError(f"{option}: takes a number for each of the {len(bursts)} bursts, not {len(numbers)}")
    if bad := [number for number in numbers if not (math.isfinite(number) and number >= 0.0)]:
        raise NlosError(f"{option} {bad[0]:g}: must not be negative")
    told: list[dict[str, Any]] = [{field: number} for number in numbers]
    return [replace(old, **one) for old, one in zip(bursts, told, strict=True)]


def _number(value: float) -> str:
    return "any" if math.isinf(value) else f"{value:.4g}"
