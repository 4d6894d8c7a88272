"""How the code is built, of one or two revisions side by side: its size, its largest parts, imports between rooms.

python benchmarks/structure.py d5da528 HEAD
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import sys
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

PACKAGES = ("generator", "classify", "blender_addon")
LARGE_FILE, LARGE_FUNCTION, MANY_PARAMETERS = 400, 60, 8
LAYOUT = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)


def sources(revision: str) -> dict[str, str]:
    """Return the text of every Python file of the product, by path."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout

    paths = git("ls-tree", "-r", "--name-only", revision, *PACKAGES).split()
    return {path: git("show", f"{revision}:{path}") for path in paths if path.endswith(".py")}


def docstrings(tree: ast.AST) -> set[int]:
    """Return the numbers of lines that hold docstrings."""
    strings = [n for n in ast.walk(tree) if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)]
    texts = [n for n in strings if isinstance(n.value.value, str)]
    return {line for n in texts for line in range(n.lineno, n.end_lineno + 1)}


def code_lines(text: str) -> int:
    """Return how many lines hold code: neither blank nor comment nor docstring."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in LAYOUT:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docstrings(ast.parse(text)))


def functions(text: str) -> list[tuple[int, int, str]]:
    """Return lines without a docstring, parameters, and name of each function."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            own = docstrings(ast.Module([node.body[0]], [])) if ast.get_docstring(node) else set()
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            count = len([name for name in names if name not in ("self", "cls")])
            found.append((node.end_lineno - node.lineno + 1 - len(own), count, node.name))
    return found


def show(revision: str) -> None:
    """Print sizes and the largest files and functions."""
    texts = sources(revision)
    size = {path: text.count("\n") for path, text in texts.items()}
    code = sum(code_lines(text) for text in texts.values())
    print(f"\n{revision}: {len(texts)} files, {sum(size.values())} lines, {code} of them code")
    large = sorted(((n, path) for path, n in size.items() if n > LARGE_FILE), reverse=True)
    print(f"  files of more than {LARGE_FILE} lines: {len(large)}")
    for n, path in large[:8]:
        print(f"    {n:5} {path}")
    every = [(n, count, f"{path}: {name}") for path, text in texts.items() for n, count, name in functions(text)]
    long = sorted((row for row in every if row[0] > LARGE_FUNCTION), reverse=True)
    print(f"  functions of more than {LARGE_FUNCTION} lines without their docstring: {len(long)}")
    for n, _, name in long[:8]:
        print(f"    {n:5} {name}")
    many = sorted(((count, name) for _, count, name in every if count > MANY_PARAMETERS), reverse=True)
    print(f"  functions of more than {MANY_PARAMETERS} parameters: {len(many)}")
    for count, name in many[:8]:
        print(f"    {count:5} {name}")


def rooms() -> None:
    """Print which room of this tree imports which, from the ground up; an uphill import would stand right of it."""
    import test_rules

    counts: Counter[tuple[str, str]] = Counter()
    for name, path in test_rules.MODULES.items():
        for other, at_run_time in test_rules.imports(path):
            here, there = test_rules.room(name), test_rules.room(other)
            if here != there and at_run_time:
                counts[here, there] += 1
    order = {room: number for number, room in enumerate(test_rules.ROOMS)}
    uphill = [pair for pair in counts if order[pair[1]] > order[pair[0]]]
    print(f"\n{sum(counts.values())} imports between {len(counts)} pairs of rooms; uphill: {len(uphill)}")
    for room in test_rules.ROOMS:
        below = [(there, n) for (here, there), n in counts.items() if here == room]
        if below:
            shown = ", ".join(f"{there} {n}" for there, n in sorted(below, key=lambda pair: order[pair[0]]))
            print(f"  {room} -> {shown}")


def main() -> int:
    """Print it all."""
    parser = argparse.ArgumentParser(description=re.split(r"\n\n", __doc__)[0])
    parser.add_argument("revisions", nargs="*", default=["HEAD"], help="of git (default: HEAD)")
    for revision in parser.parse_args().revisions:
        show(revision)
    rooms()
    return 0


if __name__ == "__main__":
    sys.exit(main())
