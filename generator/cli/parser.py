"""The parser of both command lines: errors of one sentence, help in groups, hidden aliases, shell completion."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from generator.cli import console
from generator.model.errors import NlosError, instead

FOLDERS = ("FOLDER", "SET", "DATASET")
"""Metavariables of arguments that name a folder; all other paths are files."""
SHELLS = ("bash", "zsh", "tcsh")
_NUMBERS: dict[Any, str] = {int: "a whole number", float: "a number"}
"""What the value of an option of a type must be, in words."""


class _Help(argparse.HelpFormatter):
    """Fills the lines of descriptions and epilogs, but leaves indented ones, which are commands, as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines = (line if line.startswith("  ") else textwrap.fill(line, width) for line in text.splitlines())
        return textwrap.indent("\n".join(lines), indent)


class Parser(argparse.ArgumentParser):
    """A parser of a command's arguments.

    Attributes
    ----------
    groups : mapping of str to sequence of str
        Headings of the help of a parser with verbs, and the verbs under each.
    """

    groups: Mapping[str, Sequence[str]]

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **{"formatter_class": _Help, **kwargs})
        self.groups = {}

    def alias(self, old: str, new: str) -> None:
        """Let an option be called by an older name too, which no help shows."""
        self._option_string_actions[old] = self._option_string_actions[new]

    def error(self, message: str) -> NoReturn:
        """End with exit code 2 and one sentence."""
        console.complain(f"error: {message} ({self.prog} --help says more)")
        raise SystemExit(2)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse arguments; an option that does not exist is refused before anything else is missed."""
        args = list(sys.argv[1:] if args is None else args)
        for text in args:
            if text == "--" or (self._subparsers is not None and not text.startswith("-")):
                break  # what follows are no options, or those of a verb
            name = text.partition("=")[0]
            known = self._option_string_actions
            if name.startswith("--") and " " not in name and not any(k.startswith(name) for k in known):
                self.error(f"{name}: there is no such option; {instead(name, self._shown_options())}")
        return super().parse_known_args(args, namespace)

    def _shown_options(self) -> dict[str, str]:
        """Return every long option, old names too, and the name that the help shows."""
        return {
            name: name if name in action.option_strings else action.option_strings[-1]
            for name, action in self._option_string_actions.items()
            if name.startswith("--")
        }

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        try:
            return super()._get_value(action, arg_string)
        except argparse.ArgumentError as error:
            wanted = _NUMBERS.get(action.type)
            rest = f"must be {wanted}" if wanted else error.message
            raise argparse.ArgumentError(None, f"{_name(action)} {arg_string!r}: {rest}") from None

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        known = {str(choice): str(choice) for choice in action.choices}
        if isinstance(action, argparse._SubParsersAction):
            shown = {id(action.choices[help.dest]): help.dest for help in action._get_subactions()}
            known = {name: shown[id(parser)] for name, parser in action.choices.items()}
        raise argparse.ArgumentError(None, f"{_name(action)} {value!r}: there is none; {instead(str(value), known)}")

    def format_help(self) -> str:
        """Return the help; of a parser with verbs, in groups."""
        if not self.groups or self._subparsers is None:
            return super().format_help()
        commands = _commands(self)
        helps = {action.dest: action for action in commands._get_subactions()}
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        for heading, verbs in self.groups.items():
            formatter.start_section(heading)
            formatter.add_arguments([helps[verb] for verb in verbs])
            formatter.end_section()
        formatter.start_section("options")
        formatter.add_arguments(self._optionals._group_actions)
        formatter.end_section()
        formatter.add_text(self.epilog)
        return formatter.format_help()


def _name(action: argparse.Action) -> str:
    """What messages call an argument."""
    return "/".join(action.option_strings) or str(action.metavar or action.dest).lower()


class VerbParser(Parser):
    """The parser of a verb, with the options that all verbs have; it does not undo what stands before the verb."""

    def __init__(self, *args: Any, default: Any = argparse.SUPPRESS, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        add_volume_options(self, default=default)


def hide_alias(commands: argparse._SubParsersAction[Any], old: str, new: str) -> None:
    """Let a verb be called by an older name too, which no help shows."""
    commands._name_parser_map[old] = commands._name_parser_map[new]


def add_volume_options(parser: argparse.ArgumentParser, *, default: Any = False) -> None:
    """Add ``--quiet``, ``--verbose`` and ``--json``."""
    for short, name, words in (
        (["-q"], "--quiet", "print results and errors only"),
        (["-v"], "--verbose", "print more: where the time goes, and where in the code an unexpected error came from"),
        ([], "--json", "print the result as one JSON document, and all else on standard error"),
    ):
        parser.add_argument(*short, name, action="store_true", default=default, help=words)


def command_parser(prog: str, description: str, groups: Mapping[str, Sequence[str]], epilog: str) -> Parser:
    """Return the parser of a command line, to which verbs are to be added.

    Parameters
    ----------
    prog, description, epilog : str
        As for `argparse.ArgumentParser`.
    groups : mapping of str to sequence of str
        Headings of the help, and the verbs under each.
    """
    parser = Parser(prog=prog, description=description, epilog=epilog)
    parser.groups = groups
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    add_volume_options(parser)
    parser.add_argument(
        "--print-completion",
        action=_Completion,
        choices=SHELLS,
        help="print a script that completes commands, options and files in a shell",
    )
    return parser


def check_volume(options: argparse.Namespace) -> None:
    """Raise NlosError if a command is to be both quiet and verbose."""
    if options.quiet and options.verbose:
        raise NlosError("--quiet and --verbose: exclude each other; leave one out")


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from importlib import metadata

        def version(package: str) -> str:
            try:
                return metadata.version(package)
            except metadata.PackageNotFoundError:
                return ""

        blender = ""
        if parser.prog == "nlos-generate":  # bpy itself takes a second to load
            found = version("bpy")
            blender = f", Blender {found}" if found else ", without Blender (bpy is not installed)"
        print(f"{parser.prog} {version('nlos-lab') or 'of a checkout'}{blender}")
        parser.exit()


class _Completion(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, _: Any, shell: Any, __: Any = None) -> NoReturn:
        try:
            import shtab
        except ModuleNotFoundError:
            raise NlosError("--print-completion: shtab is missing; install it with pip install shtab") from None
        for each in [parser, *verb_parsers(parser).values()]:
            for action in each._actions:
                names = str(action.metavar)
                if action.type is Path:
                    action.complete = shtab.DIRECTORY if names in FOLDERS else shtab.FILE  # type: ignore[attr-defined]
                elif "FILE" in names:
                    action.complete = shtab.FILE  # type: ignore[attr-defined]
        print(shtab.complete(parser, shell=shell))
        parser.exit()


def _commands(parser: argparse.ArgumentParser) -> argparse._SubParsersAction[Any]:
    assert parser._subparsers is not None
    [commands] = parser._subparsers._group_actions
    assert isinstance(commands, argparse._SubParsersAction)
    return commands


def verb_parsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the verbs that the help of a command line shows, with their parsers."""
    commands = _commands(parser)
    return {action.dest: commands.choices[action.dest] for action in commands._get_subactions()}
