"""gsb-fit: options that are fitted to even tosses, and judged by odd ones."""

from __future__ import annotations

import csv
import json
import math
import shlex
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from gpusimbench.evaluator.fit.document import dump_csv
from gpusimbench.evaluator.fit.search import WIDEST, Evaluation, Parameters, best_of, parameters, search
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.results.details import OverTosses
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.toss_metrics import TOSS_POSITION, ranked
from gpusimbench.evaluator.runs.toss_motion import errors_of, measured_tosses
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.tosses import EVEN, ODD, judged_on
from tests.conftest import call, made_once, recorded

_KNOWN = (
    {"name": "solref", "type": "str", "default": "0.02 1"},
    {"name": "impratio", "type": "float", "default": 1.0},
    {"name": "margin", "type": "float", "default": 0.0},
    {"name": "iterations", "type": "int", "default": 100},
    {"name": "cone", "type": "str", "default": "elliptic"},
)
_SCENE = {"friction": 0.18}


def test_parameters() -> None:
    """Begin as given, or else as the simulator or the scene has it, and move each number by a factor."""
    found = parameters(["solref", "friction"], _KNOWN, {"solref": "-500 -10", "cone": "x"}, _SCENE)
    assert found == Parameters({"solref": (-500.0, -10.0), "friction": (0.18,)})
    assert found.size == 3
    assert found.options(np.zeros(3)) == {"solref": "-500 -10", "friction": "0.18"}
    assert found.options([math.log(2), 0, -math.log(3)]) == {"solref": "-1000 -10", "friction": "0.06"}
    low, high = found.bounds[0]
    assert (math.exp(low), math.exp(high)) == (pytest.approx(1 / WIDEST), pytest.approx(WIDEST))
    assert parameters(["impratio"], _KNOWN, {}, _SCENE).start == {"impratio": (1.0,)}


@pytest.mark.parametrize(
    ("names", "given", "said"),
    [
        (["solreff"], {}, "did you mean 'solref'"),
        (["cone"], {}, "only numbers with fractions"),
        (["iterations"], {}, "only numbers with fractions"),
        (["margin"], {}, "--option margin=VALUE"),
        (["solref"], {"solref": "0.02 nan"}, "only numbers with fractions"),
        (["solref"], {"solref": ""}, "only numbers with fractions"),
    ],
)
def test_what_cannot_be_fitted(names: list[str], given: dict[str, str], said: str) -> None:
    """Refuse what is unknown, no number, a whole number, or zero."""
    with pytest.raises(UsageError, match=said):
        parameters(names, _KNOWN, given, _SCENE)


def _bowl(options: Mapping[str, str]) -> float:
    """Smallest, 1, at a = 0.4 and b = "3 0.05"; rugged as a chaotic error is."""
    numbers = [float(word) for text in options.values() for word in text.split()]
    away = [math.log(number / best) for number, best in zip(numbers, (0.4, 3.0, 0.05), strict=True)]
    rugged = 0.002 * sum(math.sin(400 * x) for x in away)
    return 1.0 + sum(x * x for x in away) + rugged


_START = Parameters({"a": (1.0,), "b": (1.0, 0.1)})


def test_search() -> None:
    """Come close to the smallest error within the budget, and evaluate nothing twice."""
    made = search(_START, _bowl, 60)
    assert len(made) <= 60
    assert made[0].options == {"a": "1", "b": "1 0.1"}
    assert len({tuple(one.options.values()) for one in made}) == len(made)
    best = best_of(made)
    assert not isinstance(best.error, Missing)
    assert best.error < 1.02
    assert float(best.options["a"]) == pytest.approx(0.4, rel=0.1)


@pytest.mark.parametrize("budget", [2, 5])
def test_budget(budget: int) -> None:
    """Stop when the budget is spent, wherever the search is."""
    calls: list[Mapping[str, str]] = []

    def counted(options: Mapping[str, str]) -> float:
        calls.append(options)
        return _bowl(options)

    assert len(search(_START, counted, budget)) == len(calls) == budget


def test_options_that_fail() -> None:
    """Go on where the simulator refuses options, and keep why; give up where it refuses the start."""
    refused = Missing("a is at most 1")

    def guarded(options: Mapping[str, str]) -> float | Missing:
        return refused if float(options["a"]) > 1 else _bowl(options)

    made = search(_START, guarded, 60)
    assert any(one.error is refused for one in made)
    best = best_of(made)
    assert not isinstance(best.error, Missing)
    assert best.error < 1.1
    rows = list(csv.reader(dump_csv(made).splitlines()))
    assert rows[0] == ["evaluation", "a", "b", "error_even_cm", "error_even_cm_missing"]
    assert [row[4] for row in rows[1:] if not row[3]] == [refused.reason] * sum(one.error is refused for one in made)
    assert search(_START, lambda options: refused, 60) == (Evaluation(made[0].options, refused),)
    assert best_of(search(_START, lambda options: refused, 60)) is None


def test_which_tosses_judge() -> None:
    """Judge what was fitted on even tosses by odd ones, what was not fitted by all, and nothing else."""
    assert judged_on({}) == ""
    assert judged_on({"solref": EVEN, "friction": EVEN}) == ODD
    for other in ("all tosses", ODD, "even tosses "):
        with pytest.raises(ValueError, match="solref to"):
            judged_on({"solref": other, "friction": EVEN})


def _fit(folder: Path) -> None:
    done = call(
        "gsb-fit", "--sim", "mujoco", "--parameters", "friction", "--option", "friction=0.3", "--budget", "9",
        "--out", folder / "fit", "--json", folder / "fit.json", code=ExitCode.OK,
    )  # fmt: skip
    (folder / "said.txt").write_text(done.stdout, encoding="utf-8")


def of_friction() -> Path:
    """A fit of friction to the synthetic tosses, whose friction is 0.18, from 0.3."""
    return made_once("fit-of-friction", _fit)


@pytest.fixture(scope="module")
def fitted() -> Path:
    """The same."""
    return of_friction()


@pytest.mark.slow
def test_known_friction(fitted: Path) -> None:
    """Find the friction that the tosses were made with, better on even and on odd tosses, and say so."""
    record = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    assert float(record["fitted"]["friction"]) == pytest.approx(0.18, rel=0.06)
    assert record["verdict"].startswith("Fitting helps")
    by = {(one["quantity"], one["tosses"]): one for one in record["compared"]}
    for tosses in (EVEN, ODD):
        one = by["position", tosses]
        assert one["change"]["cases"] == 24
        assert one["after"] < one["before"] / 4
        assert one["change"]["ci95"][1] < 0
        assert one["change"]["mean"] == pytest.approx(one["after"] - one["before"])
    rows = list(csv.DictReader((fitted / "fit" / "evaluations.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == len(record["evaluations"]) <= 9
    assert float(rows[0]["error_even_cm"]) == pytest.approx(by["position", EVEN]["before"])
    best = min(rows, key=lambda row: float(row["error_even_cm"]))
    assert best["friction"] == record["fitted"]["friction"]
    assert float(best["error_even_cm"]) == pytest.approx(by["position", EVEN]["after"])
    said = (fitted / "said.txt").read_text(encoding="utf-8")
    assert record["verdict"] in " ".join(said.split())
    assert len(list((fitted / "fit").iterdir())) == 4  # the reference, the start, the fitted options, the table


@pytest.mark.slow
def test_what_is_kept(fitted: Path, tmp_path: Path) -> None:
    """Keep recordings that say what was fitted, and print the command that makes the last again."""
    record = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    files = {Recording(path).content_hash: Recording(path) for path in (fitted / "fit").glob("*.mcap")}
    before, after = files[record["before"]], files[record["after"]]
    assert before.configuration.fitted == {}
    assert after.configuration.fitted == {"friction": EVEN}
    assert after.configuration.options == {"friction": record["fitted"]["friction"]}
    name, *arguments = shlex.split(record["command"])
    call(name, *arguments, "--out", tmp_path, code=0)
    (again,) = tmp_path.glob("*.mcap")
    assert Recording(again).configuration.fitted == after.configuration.fitted
    one, other = (np.asarray(r.state("cubes", "position")) for r in (Recording(again), after))
    np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_judged_by_odd_tosses(fitted: Path) -> None:
    """Evaluate the fitted options by odd tosses alone, and compare them with the start on these."""
    evaluation = evaluate_files(sorted((fitted / "fit").glob("*.mcap")), sample_time=441 / 148)
    by = {bool(r.group.key.told["fitted"]): r for r in evaluation.results}
    after, before = (by[one].metrics[TOSS_POSITION.name].of(OverTosses) for one in (True, False))
    assert after.numbers == tuple(range(1, 48, 2))
    assert before.numbers == tuple(range(48))
    order = ranked(evaluation.results)
    assert [bool(one.result.group.key.told["fitted"]) for one in order] == [True, False]
    record = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    (held_out,) = (one for one in record["compared"] if (one["quantity"], one["tosses"]) == ("position", ODD))
    assert [one.error for one in order] == [pytest.approx(held_out[name]) for name in ("after", "before")]
    assert order[1].against.cases == 24
    assert order[1].against.mean == pytest.approx(-held_out["change"]["mean"])
    assert "fitted friction to even tosses" in by[True].label


def test_no_toss_is_left() -> None:
    """Give no error where options were fitted to other tosses, or where a run has none of the odd ones."""
    shared = ("--scene", "cube-toss", "--sim", "mujoco", "--runs", "1", "--phases", "capture", "--no-view")
    fixed = ("--option", "impratio=2", "--fitted")
    (reference,) = recorded("--sim", "real", "--scene", "cube-toss")
    measured = measured_tosses(Recording(reference))
    assert measured is not None
    for arguments, said in (
        ((*fixed, "impratio=all tosses"), "leave tosses to judge by"),
        ((*fixed, "impratio=even tosses", "--n-env", "1"), "none of the odd tosses"),
    ):
        (path,) = recorded(*shared, *arguments)
        found = errors_of(Recording(path), measured)
        assert said in found.reason


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--sim", "mujoco", "--parameters", "cone"), 2, "only numbers with fractions"),
        (("--sim", "mujoco", "--parameters", ","), 2, "names no option"),
        (("--sim", "mujoko", "--parameters", "solref"), 2, "mujoko"),
        (("--sim", "mujoco", "--parameters", "solref", "--budget", "1"), 2, "--budget is at least 2"),
        (("--sim", "mujoco", "--parameters", "solref", "--dt", "7"), 2, "--dt is a part of 1/148 s"),
        (("--sim", "mujoco", "--parameters", "solref", "--dt", "0.004"), 2, "no whole part of"),
        (("--sim", "mujoco", "--parameters", "solref", "--option", "solref"), 2, "NAME=VALUE"),
        (
            ("--sim", "mujoco", "--parameters", "solref", "--option", "solref=-1 2"),
            1,
            "cannot be judged: simulator 'mujoco': solref is two numbers above 0",
        ),
        (("--sim", "mujoco", "--parameters", "solref", "--tosses", "nowhere"), 1, "nowhere: No such file"),
    ],
)
def test_refused(arguments: tuple[str, ...], code: int, said: str, tmp_path: Path) -> None:
    """Say what is wrong, before anything is searched."""
    done = call("gsb-fit", *arguments, "--out", tmp_path / "fit", code=code)
    assert said in " ".join(done.stderr.split())


def test_a_folder_of_its_own(tmp_path: Path) -> None:
    """Take no folder that has something: another fit's recordings would be compared with these."""
    (tmp_path / "x.mcap").touch()
    done = call("gsb-fit", "--sim", "mujoco", "--parameters", "solref", "--out", tmp_path, code=ExitCode.USAGE)
    assert "is not empty" in done.stderr


@pytest.mark.slow
def test_known_friction_among_known_contacts(tmp_path: Path) -> None:
    """Find friction more closely where contacts and step are nearly those that the tosses were made with."""
    done = call(
        "gsb-fit", "--sim", "mujoco", "--parameters", "friction", "--option", "friction=0.25",
        "--option", "impratio=10", "--option", "solref=0.004 1", "--dt", str(1 / 148 / 8), "--budget", "7",
        "--out", tmp_path / "fit", "--json", "-", code=ExitCode.OK,
    )  # fmt: skip
    assert float(json.loads(done.stdout)["fitted"]["friction"]) == pytest.approx(0.18, rel=0.03)
