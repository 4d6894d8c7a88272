"""Runs the commands of ``docs/tutorial.md``, and holds what the page shows against what they print.

``python tests/support/tutorial.py`` writes what they print now into the page.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import math
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "tutorial.md"

BLOCK = re.compile(r"^```(console|pycon)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PROGRESS = re.compile(r"^\d+ of \d+ pictures(, about .* left)?\n|^engine surfel is compiled .*\n", re.MULTILINE)
REST = "[...]"
FRACTION = re.compile(r"(\d+\.\d+)")
CLOSE = 0.05
"""Relative difference that a number with a decimal point may have: another processor sums in another order."""


def parts(page: str) -> Iterator[tuple[str, str, str]]:
    """Yield all of a page as (kind, source, shown): what is to be run, of kind console or pycon, and text else."""
    end = 0
    for block in BLOCK.finditer(page):
        yield "text", page[end : block.start(2)], ""
        kind, inside = block[1], block[2]
        if kind == "console":
            for command in re.split(r"^(?=\$ )", inside, flags=re.MULTILINE)[1:]:
                source = re.match(r".*?(?<!\\)\n", command, re.DOTALL)[0]
                yield kind, source, command[len(source) :]
        else:
            for example in doctest.DocTestParser().get_examples(inside):
                lines = example.source.splitlines(keepends=True)
                prompts = [">>> ", *["... "] * (len(lines) - 1)]
                yield kind, "".join(map("".join, zip(prompts, lines, strict=True))), example.want
        end = block.end(2)
    yield "text", page[end:], ""


class Shell:
    """Runs commands and Python in the folder that one is in, all in this process."""

    def __init__(self) -> None:
        self._names = {}

    def run(self, kind: str, source: str) -> str:
        """Return what a command, or a statement, prints."""
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            if kind == "console":
                program, *words = shlex.split(source.removeprefix("$ "))
                assert _main(program)(words) == 0, source
            else:
                code = "\n".join(line[4:] for line in source.splitlines())
                exec(compile(code + "\n", "<tutorial>", "single"), self._names)
        return "".join(f"{line.rstrip()}\n" for line in PROGRESS.sub("", printed.getvalue()).splitlines())


def _main(program):
    if program == "nlos-generate":
        from generator.cli.main import main
    else:
        assert program == "nlos-classify", program
        from classify.cli.main import main
    return main


def alike(shown: str, printed: str) -> bool:
    """Whether a page shows what was printed: ``[...]`` is the rest of a line, and fractions are equal to 5 %."""
    shown_lines, printed_lines = shown.splitlines(), printed.splitlines()
    if len(shown_lines) != len(printed_lines):
        return False
    return all(map(_alike, shown_lines, printed_lines))


def _alike(shown: str, printed: str) -> bool:
    if shown.endswith(REST):
        return _plain(printed).startswith(_plain(shown.removesuffix(REST)))
    ours, theirs = FRACTION.split(_plain(shown)), FRACTION.split(_plain(printed))
    return ours[::2] == theirs[::2] and all(map(_close, ours[1::2], theirs[1::2]))


def _close(one: str, other: str) -> bool:
    return math.isclose(float(one), float(other), rel_tol=CLOSE)


def _plain(line: str) -> str:
    """Return a line whose columns, and the lines drawn around them, have no width."""
    return re.sub(r"[━─]+", "─", " ".join(line.split()))


def _written(shown: str, printed: str) -> str:
    """Return what was printed, with ``[...]`` where the page has it."""
    kept = [line for line in shown.splitlines(keepends=True) if line.rstrip().endswith(REST)]
    lines = printed.splitlines(keepends=True)
    return "".join(next((old for old in kept if _alike(old.rstrip(), line.rstrip())), line) for line in lines)


def renewed(page: str) -> str:
    """Return a page that shows what its commands print now."""
    shell, lines = Shell(), []
    for kind, source, shown in parts(page):
        printed = shown if kind == "text" else shell.run(kind, source)
        lines += [source, shown if kind == "text" else _written(shown, printed)]
    return "".join(lines)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    text = PAGE.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        text = renewed(text)
        for picture in Path(folder).glob("*.png"):
            (ROOT / "docs" / "pictures" / f"tutorial-{picture.name}").write_bytes(picture.read_bytes())
    PAGE.write_text(text, encoding="utf-8")
