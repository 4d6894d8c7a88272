"""Writes docs/reference/json.md, the keys of what commands print with ``--json``, from the answers' own descriptions.

``python benchmarks/json_page.py``; tests/generator/cli/test_answer.py fails while the page is another.
"""

from __future__ import annotations

from pathlib import Path

from classify.cli import main as classify_cli
from generator.cli import main as generate_cli
from generator.cli.answer import table_of_keys

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "json.md"
TEXT = """\
# What commands print with `--json`

Every command takes `--json`, before or after its verb. It then prints one JSON document on standard output, and
nothing else there; progress, notes and errors go to standard error. Where bad input leaves no answer, standard output
stays empty and the exit code is 2.

    nlos-generate status sphere/ --json | python -m json.tool
    nlos-classify predict sheet.skops sheet/E/0007.exr --json

- Units are those of the SI: metres, seconds, bytes; angles are degrees; shares and relative errors are numbers from 0
  to 1 (0.01 is 1 %).
- A number that is not known, is not finite or means nothing is `null`; JSON has no NaN and no infinity.
- An *interval* is an object with the keys `value`, `low` and `high`: a value and the ends of its 95 % confidence
  interval.
- `a[].b` is the key `b` of every object in the list `a`.
- Keys keep their names and their meaning; further ones may be added.

This page is written by `python benchmarks/json_page.py` from the descriptions in the program.

## nlos-generate

{generate}

## nlos-classify

{classify}
"""


def page() -> str:
    """Return the page."""
    return TEXT.format(
        generate=table_of_keys(generate_cli.parser()),
        classify=table_of_keys(classify_cli.parser()),
    )


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
