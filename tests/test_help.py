"""The help of every command: options with their defaults, exit codes that exist, examples that can be typed."""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from gpusimbench.schemas import errors
from gpusimbench.schemas.errors import ExitCode
from tests.conftest import command, finished
from tests.test_site import script

MODULES = script("make_reference").modules()
PARSERS = script("make_reference").parsers()
PACKAGES = ("schemas", "recorder", "evaluator")
ROOT = Path(__file__).resolve().parent.parent

every_command = pytest.mark.parametrize("name", PARSERS)


def _options(parser: argparse.ArgumentParser) -> list[argparse.Action]:
    below = script("make_reference").verbs(parser).values()
    own = [action for action in parser._actions if not isinstance(action, argparse._SubParsersAction)]
    return [*own, *(action for each in below for action in _options(each))]


def _says(text: str, default: object) -> bool:
    shown = {str(default), f"{default:g}"} if isinstance(default, float) else {str(default)}
    if isinstance(default, tuple):
        shown = {",".join(map(str, default))}
    return any(re.search(rf"default:? .*?(?<![\w.]){re.escape(value)}(?![\w.])", text) for value in shown)


@every_command
def test_every_option_is_explained(name: str) -> None:
    """Say of each option what it does, and which value it has where it is not given."""
    for action in _options(PARSERS[name]):
        assert action.help, action.option_strings or action.dest
        text = action.help % {**vars(action), "prog": name}
        assert text == text.strip() and not text.endswith("."), text
        if not any(action.default is nothing for nothing in (None, False, argparse.SUPPRESS)) and action.default != []:
            assert _says(text, action.default), f"{action.option_strings}: no default {action.default} in '{text}'"


def test_the_recorder_says_its_defaults() -> None:
    """Name in the help of gsb-record what each argument is that is not given."""
    from gpusimbench.recorder.command.arguments import parser

    helps = {action.dest: action.help or "" for action in _options(PARSERS["gsb-record"])}
    for table in parser().unless_given.values():
        for name, default in table.items():
            if default is not False and default not in (None, ()):
                assert _says(helps[name], default), f"--{name}: {default}"


@every_command
def test_exit_codes_exist(name: str) -> None:
    """List codes that schemas.errors has, and every one that the command's own code can end with."""
    listed = set(script("make_reference").codes(PARSERS[name].epilog))
    assert listed <= {int(code) for code in ExitCode}
    source = Path(str(MODULES[name].__file__)).read_text(encoding="utf-8")
    raised = {
        int(kind.exit_code)
        for name, kind in vars(errors).items()
        if isinstance(kind, type) and issubclass(kind, errors.GsbError) and f"raise {name}(" in source
    }
    named = {int(ExitCode[code]) for code in re.findall(r"ExitCode\.([A-Z_]+)", source)}
    assert {0, 1, 2} | raised | named <= listed


@every_command
def test_examples_can_be_typed(name: str) -> None:
    """Parse each command of the examples with the parser whose help shows it."""
    examples = script("make_reference").sections(PARSERS[name].epilog)["examples"].strip().splitlines()
    assert len(examples) >= 3
    for line in examples:
        assert line.split()[0] == name
        for part in re.split(r"&&|\|", line):
            program, *arguments = shlex.split(part)
            if program == name:
                PARSERS[name].parse_args(arguments)


@every_command
def test_help_says_where_to_go_on(name: str) -> None:
    """Name documents that exist, and commands that exist."""
    section = script("make_reference").sections(PARSERS[name].epilog).get("see also")
    assert section, f'say under "see also:" in the epilog of {name} what else a reader of {name} may want'
    for path in re.findall(r"\S+/\S+\.md", section):
        assert (ROOT / path).exists(), path
    assert set(re.findall(r"gsb-\w+", section)) <= set(PARSERS) - {name}


def test_variables_of_the_environment() -> None:
    """Explain every variable of this project's own that its code reads, in the help of some command."""
    code = "".join(path.read_text(encoding="utf-8") for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    read = set(re.findall(r'= "(GSB_[A-Z_]+)"|environ[^"\n]*"(GSB_[A-Z_]+)"', code))
    names = {name for pair in read for name in pair if name} - {"GSB_CONFORMANCE_INSIDE"}  # between our own processes
    assert len(names) >= 3
    for name in names:
        assert any(name in (parser.epilog or "") for parser in PARSERS.values()), name


def test_one_version() -> None:
    """Start every command as it is installed, and have each print the same line for its version."""
    lines = set()
    for name in PARSERS:
        done = subprocess.run([*command(name), "--version"], capture_output=True, text=True, timeout=300)
        lines.add((done.returncode, done.stdout, done.stderr))
    ((code, line, said),) = lines
    assert (code, said) == (0, "")
    assert re.fullmatch(r"gpusimbench \d+\.\d+\.\d+\S*\n", line)


@every_command
def test_help_fits_a_page(name: str) -> None:
    """Keep the end of the help, which no terminal wraps, within 120 columns, and its sections under headings."""
    assert all(len(line) <= 120 for line in (PARSERS[name].epilog or "").splitlines())
    found = script("make_reference").sections(PARSERS[name].epilog)
    assert {"exit codes", "examples", "see also"} <= set(found)


@every_command
def test_the_manual_page(name: str) -> None:
    """Make a manual page that formats without a warning and has every option, section and exit code of the help."""
    page = script("make_man").man_page(name, PARSERS[name])
    for option in PARSERS[name]._option_string_actions:
        assert option.replace("-", "\\-") in page
    for heading in ("NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS", "EXIT STATUS", "EXAMPLES", "SEE ALSO"):
        assert f".SH {heading}\n" in page
    if shutil.which("groff") is None:
        pytest.skip("there is no groff to format it")
    done = finished(["groff", "-man", "-ww", "-Tascii"], input=page)
    assert done.stderr == ""
    assert f"{name.upper()}(1)" in done.stdout
    assert " ".join(str(PARSERS[name].description).split()[:4]) in " ".join(done.stdout.split())
