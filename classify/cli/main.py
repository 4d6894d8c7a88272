"""Command line of the classifier: it only parses arguments and prints; the work is done elsewhere."""

from __future__ import annotations

import sys

from classify.cli import atlas, bound, calibrate, features, importing, learn, locate, sensor
from generator.cli.answer import give
from generator.cli.parser import Parser, VerbParser, check_volume, command_parser
from generator.cli.terminal import guarded

VERBS = (sensor, importing, calibrate, features, learn, atlas, locate, bound)
"""Modules of the verbs."""
GROUPS = {
    "take pictures in": ("sensor", "import", "calibrate"),
    "describe pictures": ("features", "atlas"),
    "train and compare": ("train", "compare", "learning-curve"),
    "answer": ("predict", "locate", "track"),
    "what could be known": ("bound", "detect", "tradeoff"),
}
"""Headings of the help, and the verbs under each."""
_EXAMPLES = """\
examples:
  nlos-classify features sheet/ -o sheet.h5 --features global
  nlos-classify compare sheet.h5 sphere.h5 -o report/
  nlos-classify train sheet.h5 -o sheet.skops --classifier SVM
  nlos-classify predict sheet.skops sheet/E/0007.exr
"""


def main(argv: list[str] | None = None) -> int:
    """Run ``nlos-classify``.

    Returns
    -------
    int
        Exit code: 0 success, 2 bad input, 70 unexpected error, 130 interrupted, 141 output closed by its reader.
    """
    return guarded(lambda: _run(argv), "interrupted; nothing was written")


def _run(argv: list[str] | None) -> int:
    options = parser().parse_args(argv)
    check_volume(options)
    return give(options)


def parser() -> Parser:
    """Return the parser of the command line, with all verbs."""
    made = command_parser(
        "nlos-classify",
        "Tell from pictures of the relay wall in which voxel the hidden object stands.",
        GROUPS,
        _EXAMPLES,
    )
    commands = made.add_subparsers(required=True, metavar="COMMAND", parser_class=VerbParser)
    for verb in VERBS:
        verb.add_parsers(commands)
    return made


if __name__ == "__main__":
    sys.exit(main())
