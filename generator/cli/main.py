"""Command line of the generator: argument parsing and messages for people; all work is done elsewhere."""

from __future__ import annotations

import argparse
import sys

from generator.cli import bulk, check, experiment, inspect, plan, scene, sweep
from generator.cli.terminal import guarded
from generator.sets import links

VERBS = (scene, sweep, bulk, check, experiment, plan, inspect)
"""Modules, in the order of the help."""
_EXAMPLES = """\
examples:
  nlos-generate scene room --target sphere -o room.blend
  nlos-generate sweep room.blend -o sphere/ --poses 100 --engine patch
  nlos-generate bulk room.blend -o million/ --pictures 1000000
  nlos-generate verify sphere/
"""


def main(argv: list[str] | None = None) -> int:
    """Run ``nlos-generate``.

    Returns
    -------
    int
        Exit code: 0 success, 1 unfinished or faulty, 2 bad input, 130 interrupted, 141 output closed by its reader.
    """
    return guarded(lambda: _run(argv))


def _run(argv: list[str] | None) -> int:
    options = parser().parse_args(argv)
    with links.trusting(getattr(options, "trust_links", False)):
        return int(options.run(options))


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line, with all verbs."""
    made = argparse.ArgumentParser(
        prog="nlos-generate",
        description="Build scenes with an object hidden around the corner, and render what a wall shows of it.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = made.add_subparsers(required=True, metavar="COMMAND")
    for verb in VERBS:
        verb.add_parsers(commands)
    return made


if __name__ == "__main__":
    sys.exit(main())
