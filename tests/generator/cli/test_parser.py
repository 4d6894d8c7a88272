"""Both command lines: help, misspelt names, old names, and how much is said."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

from classify.cli import main as classify_cli
from generator.cli import main as generate_cli
from generator.cli import volume
from generator.cli.parser import verb_parsers
from generator.cli.terminal import guarded

MODULES = {"nlos-generate": generate_cli, "nlos-classify": classify_cli}
LOUD = ("quiet", "verbose", "json")
VERBS = [(module, verb) for module in MODULES.values() for verb in verb_parsers(module.parser())]


def parsed(line):
    """The options of a command line as a dict; where it is piped or redirected, those of its first command."""
    program, *arguments = shlex.split(re.split(r" [|>] ", line)[0], comments=True)
    return vars(MODULES[program].parser().parse_args(arguments))


@pytest.mark.parametrize("module", MODULES.values())
def test_every_verb_stands_in_one_group_of_the_help(module):
    grouped = [verb for verbs in module.GROUPS.values() for verb in verbs]
    assert sorted(grouped) == sorted(verb_parsers(module.parser()))
    shown = module.parser().format_help()
    for heading, verbs in module.GROUPS.items():
        section = shown.partition(f"\n{heading}:\n")[2].partition("\n\n")[0]
        assert [line.split()[0] for line in section.splitlines() if line[2] != " "] == list(verbs)


@pytest.mark.parametrize(("module", "verb"), VERBS)
def test_the_help_of_every_verb_ends_with_an_example_that_is_right(module, verb):
    parser = verb_parsers(module.parser())[verb]
    heading, *lines = parser.epilog.splitlines()
    assert heading == "example:"
    assert parser.format_help().rstrip().endswith(lines[-1].strip())
    for line in lines:
        parsed(line.strip())
    assert any(line.split()[:2] == [module.parser().prog, verb] for line in lines)


def test_the_examples_of_the_whole_are_right():
    for module in MODULES.values():
        _, *lines = module.parser().epilog.splitlines()
        assert len([parsed(line.strip()) for line in lines]) == 4


def test_the_commands_on_the_pages_are_right():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    lines = [line.strip() for page in pages for line in page.read_text("utf-8").replace("\\\n", " ").splitlines()]
    commands = [line for line in lines if line.startswith(tuple(f"{program} " for program in MODULES))]
    assert len(commands) > 50
    for line in commands:
        assert parsed(line)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("nlos-generate swep room.blend", "command 'swep': there is none; did you mean sweep?"),
        ("nlos-generate render room.blend", "command 'render': there is none; choose from scene, check, describe,"),
        ("nlos-generate sweep r.blend --ouput set/", "--ouput: there is no such option; did you mean --output?"),
        ("nlos-generate sweep r.blend -o s --engine pach", "--engine 'pach': there is none; did you mean patch?"),
        ("nlos-generate sweep r.blend -o s --poses x", "--poses 'x': must be a whole number"),
        ("nlos-generate sweep r.blend -o s --rotation 1 2 z", "--rotation 'z': must be a number"),
        ("nlos-generate sweep r.blend -o s --accuracy banana", "--accuracy 'banana': must be between 0 and 1, or"),
        ("nlos-generate experiment x", "number 'x': must be a whole number"),
        ("nlos-generate scene rom --show", "preset 'rom': there is none; did you mean room?"),
        ("nlos-generate scene room --show --target spere", ".blend); did you mean sphere?"),
        ("nlos-generate scene room --show --set sopt.power=5", "sopt: no such field; did you mean spot?"),
        ("nlos-generate scene room --show --set spot.powr=5", "spot.powr: no such field; did you mean power?"),
        ("nlos-generate plan r.blend --mots 5s", "--mots: there is no such option; did you mean --time-limit?"),
        ("nlos-classify lern f.h5", "command 'lern': there is none; did you mean learning-curve?"),
        ("nlos-classify features s -o f.h5 --features phisics", "'phisics': there is none; did you mean physics?"),
        (
            "nlos-classify train f.h5 -o m.skops --classifier svn",
            "--classifier 'svn': there is none; did you mean SVM?",
        ),
        ("nlos-classify train f.h5 -o m.skops --setings paper", "no such option; did you mean --hyperparameters?"),
    ],
)
def test_a_misspelt_name_is_one_sentence_with_the_nearest(capsys, line, words):
    program, *arguments = shlex.split(line)
    try:
        code = MODULES[program].main(arguments)
    except SystemExit as end:
        code = end.code
    assert code == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert words in said.err


@pytest.mark.parametrize(
    ("line", "old", "new"),
    [
        ("nlos-generate plan r.blend {} 5s", "--most", "--time-limit"),
        ("nlos-generate tradeoff r.blend -o t {} 5s", "--most", "--time-limit"),
        ("nlos-generate sweep r.blend -o s --jobs 2 {} a=1", "--job", "--job-option"),
        ("nlos-classify features s -o f.h5 {} physics", "--set", "--features"),
        ("nlos-classify learning-curve f.h5 -o l {} 30 90", "--counts", "--train-sizes"),
        ("nlos-classify learning-curve f.h5 -o l {} tuned", "--settings", "--hyperparameters"),
        ("nlos-classify train f.h5 -o m {} paper", "--settings", "--hyperparameters"),
        ("nlos-classify compare f.h5 -o r {} paper", "--settings", "--hyperparameters"),
        ("nlos-classify tradeoff t a {} 2", "--noises", "--noise-draws"),
        ("nlos-classify track a w {} 0.1", "--step", "--process-noise"),
        ("nlos-classify {} f.h5 -o l", "learn", "learning-curve"),
    ],
)
def test_old_names_go_on_working_and_are_not_shown(line, old, new):
    assert parsed(line.format(old)) == parsed(line.format(new))
    program, verb, *_ = shlex.split(line.format(new))
    parser = MODULES[program].parser()
    shown = re.split(r"[\s\[\]{},]+", parser.format_help() + verb_parsers(parser)[verb].format_help())
    assert new in shown
    assert old not in shown


@pytest.mark.parametrize("flag", ["-q", "--quiet", "-v", "--verbose", "--json"])
def test_how_much_is_said_may_stand_before_and_after_the_verb(flag):
    before, after = parsed(f"nlos-generate {flag} verify s"), parsed(f"nlos-generate verify s {flag}")
    assert before == after
    assert [name for name in LOUD if before[name]] == [name for name in LOUD if flag.strip("-") in (name, name[0])]
    assert not any(parsed("nlos-generate verify s")[name] for name in LOUD)


def test_quiet_and_verbose_exclude_each_other(capsys):
    assert generate_cli.main(["-q", "verify", "s", "-v"]) == 2
    assert "exclude each other" in capsys.readouterr().err


def test_quiet_leaves_results_and_verbose_says_where_the_time_went(tmp_path, tiny_dataset, capsys):
    command = ["features", str(tiny_dataset), "-o", str(tmp_path / "f.h5")]
    assert classify_cli.main(command) == 0
    usual = capsys.readouterr()
    assert classify_cli.main([*command, "-q"]) == 0
    quiet = capsys.readouterr()
    assert classify_cli.main([*command, "-v"]) == 0
    verbose = capsys.readouterr()
    assert usual.out.splitlines()[-1:] == quiet.out.splitlines() == verbose.out.splitlines()[-1:]
    assert "9 of 9 pictures" in usual.out
    assert quiet.err == ""
    assert "time: describing " in verbose.err
    assert not volume.current().quiet, "the next command begins anew"


def test_the_traceback_of_an_unexpected_error_is_printed_if_asked_for(capsys):
    def work(verbose):
        volume.current().verbose = verbose
        raise RuntimeError("no such thing")

    assert guarded(lambda: work(False)) == 70
    brief = capsys.readouterr().err
    assert brief.count("\n") == 1
    assert f"unexpected RuntimeError in {__file__}:" in brief
    assert "no such thing; -v prints the traceback" in brief
    assert guarded(lambda: work(True)) == 70
    assert "Traceback (most recent call last)" in capsys.readouterr().err


@pytest.mark.parametrize(("package", "words"), [("generator", "nlos-generate "), ("classify", "nlos-classify ")])
@pytest.mark.parametrize("module", ["", ".cli"])
def test_packages_are_commands(monkeypatch, capsys, package, module, words):
    monkeypatch.setattr(sys, "argv", [package, "--version"])
    with pytest.raises(SystemExit) as end:
        runpy.run_module(f"{package}{module}", run_name="__main__")
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith(words)


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
@pytest.mark.parametrize("program", MODULES)
def test_completion(capsys, program, shell):
    pytest.importorskip("shtab", reason="shtab writes the completion")
    with pytest.raises(SystemExit) as end:
        MODULES[program].main(["--print-completion", shell])
    assert end.value.code == 0
    script = capsys.readouterr().out
    assert all(verb in script for verb in verb_parsers(MODULES[program].parser()))
    for old in ("--most", "--noises", "'learn'"):
        assert old not in script


def test_bash_completes_verbs_options_choices_and_folders(tmp_path, capsys):
    pytest.importorskip("shtab", reason="shtab writes the completion")
    with pytest.raises(SystemExit):
        generate_cli.main(["--print-completion", "bash"])
    (tmp_path / "script").write_text(capsys.readouterr().out)
    (tmp_path / "set").mkdir()
    tries = ["swe", "sweep --engi", "sweep --engine p", "status "]
    asked = "\n".join(
        f'COMP_WORDS=(nlos-generate {" ".join(words[:-1])} "{words[-1]}"); COMP_CWORD={len(words)}; COMPREPLY=()\n'
        "$f; echo ${COMPREPLY[@]}"
        for words in (line.split(" ") for line in tries)
    )
    function = 'f=$(complete -p nlos-generate | sed "s/.*-F \\([^ ]*\\).*/\\1/")'
    done = subprocess.run(
        ["bash", "-c", f"source ./script; {function}\n{asked}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert [line.split() for line in done.stdout.splitlines()] == [
        ["sweep"],
        ["--engine"],
        ["path", "patch"],
        ["set"],
    ]


def test_without_shtab_completion_is_one_sentence(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert generate_cli.main(["--print-completion", "bash"]) == 2
    assert capsys.readouterr().err.startswith("error: --print-completion: shtab is missing; install it")


def test_parsers_load_nothing_that_is_slow_or_that_blender_lacks():
    slow = {"bpy", "scipy", "sklearn", "matplotlib", "numba", "h5py", "cv2", "rich", "shtab", "difflib", "joblib"}
    script = (
        "import sys, classify.cli.main, generator.cli.main;"
        "classify.cli.main.parser().format_help(); generator.cli.main.parser().format_help();"
        f"print({slow!r} & {{name.partition('.')[0] for name in sys.modules}})"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_every_path_is_a_folder_or_a_file_by_its_metavariable():
    """Completion goes by these names."""
    for module, verb in VERBS:
        for action in verb_parsers(module.parser())[verb]._actions:
            if action.type is Path:
                assert action.metavar or action.dest in ("scene",), (verb, action.dest)
