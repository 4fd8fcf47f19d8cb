"""A mistyped name ends with the name that was meant; a short help leads to the whole one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas.text import did_you_mean
from tests.conftest import call
from tests.test_help import PARSERS

ROOT = Path(__file__).resolve().parent.parent
FILE = ROOT / "recordings" / "mujoco-amd-r0.mcap"
DOZEN = 12


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("gsb-record", "--sim", "mujco"), "'mujoco'"),
        (("gsb-record", "--sim", "mujoco", "--scene", "Free_Fall"), "'free-fall'"),
        (("gsb-record", "--sim", "mujoco", "--option", "coen=elliptic"), "'cone'"),
        (("gsb-record", "--sim", "mujoco", "--option", "cone=eliptic"), "'elliptic'"),
        (("gsb-record", "--sim", "mujoco", "--determinism", "defualt"), "'default'"),
        (("gsb-record", "--sim", "mujoco", "--phases", "captured"), "'capture'"),
        (("gsb-record", "--sim", "mujoco", "--n-envs", "4"), "'--n-env'"),
        (("gsb-record", "--sim", "mujoco", "--compression", "zst"), "'zstd'"),
        (("gsb-record", "--setup", "gensis"), "'genesis'"),
        (("gsb-eval", FILE, "--refrence=x.mcap"), "'--reference'"),
        (("gsb-eval", FILE, "--format", "parket", "--tables", "t"), "'parquet'"),
        (("gsb-check", FILE, "--rules", "protocol"), "'protocol-2'"),
        (("gsb-compare", FILE, FILE, "--gate", "memry"), "'memory'"),
        (("gsb-audit", FILE, "--require", "bit-identicall"), "'bit-identical'"),
        (("gsb-view", FILE, "--with", "foxgolve"), "'foxglove'"),
        (("gsb-share", "pakc", FILE), "'pack'"),
        (("gsb-share", "unpack", FILE, "--uot", "x"), "'--out'"),
    ],
)
def test_what_was_meant(arguments: tuple[str, ...], meant: str) -> None:
    """Name it in the message, and end with 2."""
    done = call(*arguments, code=2)
    assert f"did you mean {meant}" in done.stderr.splitlines()[-1]


def test_nothing_is_guessed() -> None:
    """Suggest nothing where no name is similar."""
    assert did_you_mean("qqq", ("mujoco", "warp")) == ""
    assert did_you_mean("m", ("mujoco", "warp")) == ""
    assert did_you_mean("x", ()) == ""


@given(st.text(min_size=1), st.lists(st.text(min_size=1), max_size=5))
def test_a_name_that_is_known(name: str, others: list[str]) -> None:
    """Find a name itself, however it is written; suggest known names alone."""
    assert repr(name) in did_you_mean(name.upper() if name.upper().lower() == name else name, [name, *others])


@pytest.mark.parametrize("name", PARSERS)
def test_two_helps(name: str) -> None:
    """Show the options that most people need with --help, a dozen and no more, and all of them with --help-all."""
    parser = PARSERS[name]
    whole, short = call(name, "--help-all"), call(name, "--help")
    assert whole.returncode == short.returncode == 0
    options = [action for action in parser._actions if action.option_strings]
    for action in options:
        assert action.option_strings[-1] in whole.stdout
    for section in ("exit codes:", "examples:", "see also:"):
        assert f"\n{section}\n" in whole.stdout
    shown = [a for a in options if re.search(rf"^ +(-\w, )?{a.option_strings[-1]}\b(?!-)", short.stdout, re.MULTILINE)]
    assert len(shown) <= DOZEN + 2  # and both helps
    assert "\nexamples:\n" in short.stdout
    said = " ".join(short.stdout.split()).partition(f"{name} --help-all shows ")[2]
    assert bool(said) == (len(shown) < len(options))
    if said:
        more, titles = said.removesuffix(".").split(" more options, and the sections ")
        assert int(more) == len(options) - len(shown)
        sections = re.findall(r"^(\S.*):$", whole.stdout.partition("\noptions:\n")[2], re.MULTILINE)
        assert ", ".join(section for section in sections if section != "examples").endswith(titles)
    assert all(len(line) <= 120 for line in short.stdout.splitlines() if line.startswith(" "))
