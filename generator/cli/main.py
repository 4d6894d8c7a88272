"""Command line of the generator: argument parsing and messages for people; all work is done elsewhere."""

from __future__ import annotations

import sys

from generator.cli import bulk, check, describe, experiment, inspect, plan, scene, sweep
from generator.cli.answer import give
from generator.cli.parser import Parser, VerbParser, check_volume, command_parser
from generator.cli.terminal import guarded
from generator.sets import links

VERBS = (scene, check, describe, sweep, bulk, plan, experiment, inspect)
"""Modules of the verbs."""
GROUPS = {
    "make scenes": ("scene", "check", "describe"),
    "render data sets": ("sweep", "trajectory", "bulk"),
    "plan and measure": ("plan", "tradeoff", "experiment"),
    "look at sets": ("status", "verify"),
}
"""Headings of the help, and the verbs under each."""
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
        Exit code: 0 success, 1 unfinished or faulty, 2 bad input, 70 unexpected error, 130 interrupted, 141 output
        closed by its reader.
    """
    return guarded(lambda: _run(argv))


def _run(argv: list[str] | None) -> int:
    options = parser().parse_args(argv)
    check_volume(options)
    with links.trusting(getattr(options, "trust_links", False)):
        return give(options)


def parser() -> Parser:
    """Return the parser of the command line, with all verbs."""
    made = command_parser(
        "nlos-generate",
        "Build scenes with an object hidden around the corner, and render what a wall shows of it.",
        GROUPS,
        _EXAMPLES,
    )
    commands = made.add_subparsers(required=True, metavar="COMMAND", parser_class=VerbParser)
    for verb in VERBS:
        verb.add_parsers(commands)
    return made


if __name__ == "__main__":
    sys.exit(main())
