"""What pages take out of the code when they are built: command lines, settings, public names."""

from __future__ import annotations

import argparse
import importlib
import inspect
import re
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, ClassVar, get_args, get_type_hints

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import classify.cli.main
import generator.cli.main
from generator.files.toml import dump_toml
from generator.model.described import choices_of
from generator.model.presets import preset

PACKAGES = (generator, classify)


def generate() -> argparse.ArgumentParser:
    """Return the parser of ``nlos-generate``, for the page."""
    return _for_page(generator.cli.main.parser())


def classified() -> argparse.ArgumentParser:
    """Return the parser of ``nlos-classify``, for the page."""
    return _for_page(classify.cli.main.parser())


def _for_page(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """Return a parser whose examples are reStructuredText, since sphinx-argparse reads them as that."""
    if parser.epilog:
        title, _, commands = parser.epilog.partition(":\n")
        parser.epilog = f"{title.capitalize()}::\n\n{commands}"
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for hidden in set(action.choices) - {shown.dest for shown in action._get_subactions()}:
                del action.choices[hidden]  # older names
            for verb in action.choices.values():
                _for_page(verb)
    return parser


class Settings(SphinxDirective):
    """``settings:: module:Class``: a table of a dataclass's fields, and of those of the dataclasses in it.

    The option ``like`` names a preset, whose values are shown in place of the defaults.
    """

    required_arguments = 1
    option_spec: ClassVar = {"like": str}

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        module, _, name = self.arguments[0].partition(":")
        like = self.options.get("like")
        rows = list(_rows(getattr(importlib.import_module(module), name), like and preset(like)))
        lines = [".. list-table::", "   :header-rows: 1", "   :widths: auto", ""]
        for row in [("key", f"in {like}" if like else "default", "what it is"), *rows]:
            lines += [f"   {'  - ' if n else '* - '}{cell}" for n, cell in enumerate(row)]
        return self.parse_text_to_nodes("\n".join(lines))


def _rows(kind: type, like: Any = None, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield name, value and description of every field."""
    hints = get_type_hints(kind)
    for one in fields(kind):
        value = getattr(like, one.name) if like else one.default
        inner = next((a for a in (hints[one.name], *get_args(hints[one.name])) if is_dataclass(a)), None)
        if inner and "words" not in one.metadata:
            yield from _rows(inner, value if like else None, f"{prefix}{one.name}.")
            continue
        words = [one.metadata.get("words", "")]
        lo, hi = one.metadata.get("lo"), one.metadata.get("hi")
        words += [f"one of {', '.join(map(_shown, choices))}"] if (choices := choices_of(kind, one.name)) else []
        words += [] if lo is None else [f"from {_number(lo)} to {_number(hi)}"]
        shown = "required" if value is MISSING else _shown(value)
        yield f"``{prefix}{one.name}``", shown, "; ".join(filter(None, words))


def _shown(value: Any) -> str:
    """Return a value as TOML has it."""
    return "none" if value is None else f"``{dump_toml({'a': value}).removeprefix('a = ').strip()}``"


def _number(value: float) -> str:
    return f"{value:g}" if isinstance(value, float) or value > 1e9 else f"{value:,}"


class Public(SphinxDirective):
    """``public:: package``: what a package says of itself, a summary of what it offers, and all of that.

    It follows the package's ``__all__``. (``automodule`` would miss names that are imported at first use.)
    """

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the descriptions."""
        package = self.arguments[0]
        module = importlib.import_module(package)
        words = inspect.getdoc(module).replace("Examples\n--------", ".. rubric:: Examples\n")
        lines = [f".. py:module:: {package}", "", words, "", ".. rubric:: All names", ""]
        names = [f"{package}.{name}" for name in module.__all__]
        lines += _described(names)
        lines += ["", ".. rubric:: Types of their arguments and results", ""]
        lines += _described([f"{kind.__module__}.{kind.__name__}" for kind in _behind() if _is_of(package, kind)])
        return self.parse_text_to_nodes("\n".join(lines))


def _described(names: list[str]) -> list[str]:
    """Return a summary of names in the current package, and then all of each."""
    lines = [".. autosummary::", "   :nosignatures:", "", *(f"   ~{name.partition('.')[2]}" for name in names)]
    for name in names:
        what = getattr(importlib.import_module(name.rpartition(".")[0]), name.rpartition(".")[2])
        is_class = isinstance(what, type)
        kind = "exception" if is_class and issubclass(what, Exception) else "class" if is_class else "function"
        lines += ["", f".. auto{kind}:: {name}", *(["   :members:"] if kind == "class" else [])]
    return lines


def _behind() -> list[type]:
    """Return the classes of ours that public functions return, and that public classes are made of."""
    public = [getattr(package, name) for package in PACKAGES for name in package.__all__]
    found: list[type] = []
    for what in (seen := list(public)):
        hints = get_type_hints(what)
        near = [hints.get("return")]
        if isinstance(what, type):
            near = [*what.__mro__[1:], *hints.values()]
        new = [one for one in _classes(near) if one not in seen and any(_is_of(p.__name__, one) for p in PACKAGES)]
        found += new
        seen += new
    return sorted(found, key=lambda kind: kind.__name__)


def _classes(hints: Iterable[Any]) -> dict[type, None]:
    """Return the classes in annotations, each once, in their order."""
    found: dict[type, None] = {}
    for hint in hints:
        found |= {hint: None} if isinstance(hint, type) else _classes(get_args(hint))
    return found


def _is_of(package: str, kind: type) -> bool:
    return kind.__module__.partition(".")[0] == package


class ExitCodes(SphinxDirective):
    """``exit-codes::``: a table of both programs' exit codes, from what their main functions say."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        mains = (generator.cli.main.main, classify.cli.main.main)
        codes = [dict(_CODE.findall(" ".join((inspect.getdoc(main) or "").split()))) for main in mains]
        lines = [".. list-table::", "   :header-rows: 1", "   :widths: auto", ""]
        lines += ["   * - code", "     - nlos-generate", "     - nlos-classify"]
        for code in sorted({code for known in codes for code in known}, key=int):
            lines += [f"   * - {code}", *(f"     - {known.get(code, '')}" for known in codes)]
        return self.parse_text_to_nodes("\n".join(lines))


_CODE = re.compile(r"(\d+) ([a-z][^,.]*)")


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the directives."""
    app.add_directive("settings", Settings)
    app.add_directive("public", Public)
    app.add_directive("exit-codes", ExitCodes)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
