"""What determinism costs, from recordings whose speed is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.formats import Format
from gpusimbench.evaluator.render.table_files import table_files
from gpusimbench.evaluator.report.document import render_html, report
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.report.sections.determinism_cost import SAME, ratio
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.determinism_cost import NO_EFFECT, Family, Price
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.faults import faults
from tests.pages import rows_of, tables_of, text_of
from tests.synthetic import cubes_field, grid, write_recording

SWITCH = {"exact": True}


def family(tmp_path: Path, **asked: Any) -> Family:
    """A default and a level of half its speed and twice its memory, three runs each."""
    for run in range(3):
        one = {"run": run, "gpu_bytes": (0, 10**9 + run), "elapsed_s": 1.0 + 0.01 * run}
        write_recording(tmp_path, grid(2), **one, switches={"exact": False})
        two = {"run": run, "gpu_bytes": (0, 2 * 10**9 + run), "elapsed_s": 2.0 + 0.02 * run}
        write_recording(tmp_path, grid(2), **{**two, "determinism": "full", "switches": SWITCH, **asked})
    (found,) = evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list
    return found


def shown(evaluation: Evaluation) -> str:
    """What a terminal shows."""
    return text_of(evaluation)


def price(found: Family) -> Price:
    """The only one of a family."""
    (one,) = found.prices
    return one


def test_a_known_price(tmp_path: Path) -> None:
    """Find the ratios of speed and memory, with intervals around them, and the switch that makes them."""
    found = family(tmp_path)
    assert found.base.group.key.determinism == "default"
    one = price(found)
    assert (one.level, one.differs) == ("full", ("exact=True",))
    assert one.speed.ratio == pytest.approx(0.5)
    assert one.memory.ratio == pytest.approx(2.0)
    for cost in (one.speed, one.memory):
        assert not isinstance(cost.ratio, Missing)
        assert cost.ci95[0] < cost.ratio < cost.ci95[1]


def test_invalid_runs_have_no_price(tmp_path: Path) -> None:
    """Give no price for a switch that makes runs INVALID, and say so."""
    one = price(family(tmp_path, status="INVALID", cause="BUFFER", reason="contacts were dropped"))
    assert one.speed.ratio == Missing("3 of 3 runs are INVALID (buffer), so it has no price")


def test_refused_runs_say_why(tmp_path: Path) -> None:
    """Join a level that the engine refused to the family that was asked for the same."""
    one = price(family(tmp_path, built=False, status="FAILED", cause="REFUSED", reason="no such mode"))
    assert (one.level, one.speed.ratio) == ("full", Missing("refused: no such mode"))


def test_a_variable_may_be_the_switch(tmp_path: Path) -> None:
    """Compare over an environment variable, and tell it once where a switch repeats it."""
    flags = "--deterministic"
    one = price(family(tmp_path, environment={"FLAGS": flags}, switches={"exact": False, "flags": flags}))
    assert one.differs == ("flags=--deterministic",)


@pytest.mark.parametrize(
    "other",
    [
        {"version": "2.0"},
        {"origins": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))},
        {"field": cubes_field("float32"), "dtype": "float32"},
        {"switches": {"exact": True, "precision": "float64"}},
        {"switches": {"exact": True, "matmul_precision": "highest"}},
        {"in_force": {"iterations": 5}},
        {"environment": {"X64": "1"}},
        {"environment": {"FLAGS": "--own --deterministic"}, "switches": {"exact": True, "flags": "--deterministic"}},
        {"warmup": 20},
        {"timed_steps": 500},
    ],
    ids=lambda other: next(iter(other)),
)
def test_what_is_no_part_of_a_level_has_no_price(other: dict[str, Any], tmp_path: Path) -> None:
    """Price nothing where more differs than a level sets: version, origins, precision, options, variables, protocol."""
    dtype = other.pop("dtype", "float64")
    for run in range(3):
        write_recording(tmp_path, grid(2), run=run, switches={"exact": False})
        more = {"switches": SWITCH, **other}
        write_recording(tmp_path, grid(2, dtype), run=run, determinism="full", elapsed_s=2.0, **more)
    assert [p for f in evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list if f.base for p in f.prices] == []


def test_a_default_is_no_level(tmp_path: Path) -> None:
    """Price no second group at the default level, and price a level by the default that is set as it is."""
    for run in range(3):
        for speed, environment in ((1.0, {}), (4.0, {"HEAP": "small"})):
            common = {"run": run, "environment": environment}
            write_recording(tmp_path, grid(2), elapsed_s=speed + 0.01 * run, switches={"exact": False}, **common)
            write_recording(
                tmp_path, grid(2), elapsed_s=2 * speed + 0.02 * run, switches=SWITCH, determinism="full", **common
            )
    found = evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list
    assert [[p.level for p in family.prices] for family in found] == [["full"], ["full"]]
    assert [price(family).speed.ratio for family in found] == [pytest.approx(0.5), pytest.approx(0.5)]


@pytest.mark.parametrize(
    "asked",
    [
        {"switches": {"exact": False}},
        {"switches": {"exact": False, "flags": "--x_gpu_sorted=1"}, "environment": {"FLAGS": "--x_gpu_sorted=1"}},
    ],
    ids=["nothing", "flags-of-a-gpu-on-a-cpu"],
)
def test_a_level_that_sets_nothing_has_no_price(asked: dict[str, Any], tmp_path: Path) -> None:
    """Say that a level has no effect where it sets nothing on the device, in every output, instead of a ratio."""
    for run in range(3):
        write_recording(tmp_path, grid(2), run=run, elapsed_s=1.0 + 0.01 * run, switches={"exact": False})
        write_recording(tmp_path, grid(2), run=run, elapsed_s=1.2 + 0.01 * run, determinism="full", **asked)
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    (found,) = evaluation.price_list
    assert price(found).speed.ratio == Missing(NO_EFFECT)
    assert ratio(price(found).speed) == "no effect here"
    (table,) = (one for key, one in tables_of(evaluation).items() if key.startswith("prices"))
    (row,) = (one for name, one in rows_of(table).items() if "full" in name)
    assert (row["distinct envs"].text, row["distinct runs"].text) == ("1 of 2", "1 of 3")
    assert row["throughput / that of the default"].text == row["memory / that of the default"].text == "-"
    assert any(line.endswith(NO_EFFECT) for line in table.legend)
    assert NO_EFFECT in render_html(evaluation, published=False, command="")


@pytest.mark.parametrize(("slower", "same"), [(1.001, True), (2.0, False)])
def test_an_interval_around_1_is_no_price(slower: float, same: bool, tmp_path: Path) -> None:
    """Say that a ratio cannot be told apart from 1 where its interval contains 1, and only there."""
    for run in range(3):
        for seconds, level in ((1.0, "default"), (slower, "full")):
            switches = {"exact": level == "full"}
            write_recording(
                tmp_path, grid(2), run=run, elapsed_s=seconds + 0.05 * run, determinism=level, switches=switches
            )
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    cost = price(evaluation.price_list[0]).speed
    assert cost.undecided is same
    written = [file.decode() for file in table_files(report(Source(evaluation, False, "")), [Format.CSV]).values()]
    page = render_html(evaluation, published=False, command="")
    (record,) = to_json(evaluation)["price_list"][0]["levels"]
    assert record["throughput_of_default"]["cannot_be_told_apart_from_1"] is same
    for told in (ratio(cost), shown(evaluation), page, "".join(written)):
        assert (SAME in told) is same


def test_other_settings_are_no_family(tmp_path: Path) -> None:
    """Do not price an option, a step or a simulator as a level of determinism."""
    for number, other in enumerate(({"options": {"solver": "b"}}, {"dt": 0.5}, {"simulator": "another"})):
        write_recording(tmp_path, grid(2), determinism="full", **other)
        write_recording(tmp_path, grid(2), run=number)
    assert evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list == ()


def test_a_default_that_was_never_built_comes_last(tmp_path: Path) -> None:
    """Price a level by the default that ran, beside another that never began."""
    for run in range(3):
        write_recording(tmp_path, grid(2), run=run, elapsed_s=1.0, switches={"exact": False})
        write_recording(tmp_path, grid(2), run=run, elapsed_s=2.0, switches=SWITCH, determinism="full")
    write_recording(
        tmp_path, None, n_env=2, built=False, status="FAILED", cause="REFUSED", reason="no memory",
        environment={"HEAP": "small"},
    )  # fmt: skip
    families = evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list
    (found,) = (family for family in families if family.prices)
    assert price(found).speed.ratio == pytest.approx(0.5)


def test_no_default_no_price(tmp_path: Path) -> None:
    """Say that nothing stands at the default level."""
    for level in ("a", "b"):
        write_recording(tmp_path, grid(2), determinism=level)
    (found,) = evaluate_files(sorted(tmp_path.glob("*.mcap"))).price_list
    assert found.base is None
    assert {p.speed.ratio for p in found.prices} == {
        Missing("no group of the same configuration ran at the default level")
    }


def test_sunk_cubes_are_a_fault(tmp_path: Path) -> None:
    """Tell a group whose cubes went through the floor from one whose cubes lie on it."""
    sunk = grid(2)
    sunk[0, :5, 2] = -1.0
    for number, final in enumerate((grid(2), sunk)):
        write_recording(tmp_path, final, options={"which": number})
    sound, bad = (faults(r) for r in evaluate_files(sorted(tmp_path.glob("*.mcap"))).results)
    assert not sound.sunk
    assert bad.sunk == "2.5 of 27 bodies per env sank"
    assert bad.sunk in str(bad)


def test_prices_in_a_terminal(tmp_path: Path) -> None:
    """Print ratios with intervals, and why a level has none."""
    family(tmp_path)
    for run in range(3):
        write_recording(tmp_path, grid(2), run=run, determinism="bad", status="INVALID", reason="lost contacts",
                        gpu_bytes=(0, 10**9))  # fmt: skip
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    (table,) = (one for key, one in tables_of(evaluation).items() if key.startswith("prices"))
    (row,) = (one for name, one in rows_of(table).items() if "full" in name)
    speed, memory = row["throughput / that of the default"], row["memory / that of the default"]
    assert (speed.text, memory.text, memory.range) == ("x 0.5", "x 2", "[2 to 2]")
    assert speed.ci95 is not None
    assert any("3 of 3 runs are INVALID, so it has no price" in line for line in table.legend)
    assert "What determinism costs" in shown(evaluation)
