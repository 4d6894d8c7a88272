"""Command line of the classifier: it only parses arguments and prints; the work is done elsewhere."""

from __future__ import annotations

import argparse
import sys

from classify.cli import atlas, bound, features, learn, locate
from classify.cli.options import RAW
from generator.cli.terminal import guarded

VERBS = (features, learn, atlas, locate, bound)
"""Modules of the verbs, in the order of the help."""
_EXAMPLES = """\
examples:
  nlos-classify features sheet/ -o sheet.h5 --set global
  nlos-classify compare sheet.h5 sphere.h5 -o report/
  nlos-classify train sheet.h5 -o sheet.skops --classifier SVM
  nlos-classify predict sheet.skops sheet/E/0007.exr
"""


def main(argv: list[str] | None = None) -> int:
    """Run ``nlos-classify``; return the exit code: 0 success, 2 bad input, 130 interrupted, 141 output closed."""
    return guarded(lambda: _run(argv), "interrupted; nothing was written")


def _run(argv: list[str] | None) -> int:
    options = parser().parse_args(argv)
    return int(options.run(options))


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line, with all verbs."""
    made = argparse.ArgumentParser(
        prog="nlos-classify",
        description="Tell from pictures of the relay wall in which voxel the hidden object stands.",
        epilog=_EXAMPLES,
        formatter_class=RAW,
    )
    commands = made.add_subparsers(required=True, metavar="COMMAND")
    for verb in VERBS:
        verb.add_parsers(commands)
    return made


if __name__ == "__main__":
    sys.exit(main())
