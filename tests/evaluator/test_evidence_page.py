"""The sections of the page that are evidence: re-made tables, divergence, prices, dots, deviations; and their JSON."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.radar import Axis
from gpusimbench.evaluator.render.document import Table, Text, walk
from gpusimbench.evaluator.report.document import render_html, report
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.report.sections import (
    comparison,
    consistency,
    deviations,
    divergence,
    paper_tables,
)
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.results.paper_tables import Limit, capability, variability
from gpusimbench.schemas.provenance import Deviation
from tests.pages import rows_of, tables_of
from tests.synthetic import cubes_field, grid, write_recording, write_sweep

DT = 0.01
RATE = 40.0  # of the growth [1/s]
HOSTILE = "<script>alert(1)</script>"


def growing(env: int, run: int) -> Any:
    """Positions of which env 2 leaves at step 10 and grows, and env 1 at step 30 by nothing but height."""

    def path(start: NDArray[Any], step: int) -> NDArray[Any]:
        now = start.copy()
        if step >= 10:
            now[2, 0, 0] += min(1e-6 * np.exp(RATE * DT * (step - 10)), 0.05) * (1 + run)
        if step >= 30:
            now[1, 0, 2] += 1e-5
        return now

    return path


@pytest.fixture(scope="module")
def apart(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """Three runs of four environments that come apart: envs 0 and 3 stay together, runs 0 and 2 too."""
    folder = tmp_path_factory.mktemp("apart")
    for number, run in enumerate((0, 1, 0)):
        final = grid(4)
        final[2, 0, 0] += 0.05 * (1 + run)
        final[1, 0, 2] += 1e-5
        write_recording(
            folder, final, run=number, steps=60, dt=DT, path_of=growing(2, run), options={"name": HOSTILE},
            field=cubes_field("float64"),
        )  # fmt: skip
    return evaluate_files(sorted(folder.glob("*.mcap")), sample_time=60 * DT)


GPU = (10**9, 2 * 10**9)
"""Baseline and peak, with the baseline of a sweep: a lower one would say that the others shared their GPU."""


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """Sweeps that end in three ways, and runs of the paper's scene by two of the simulators."""
    folder = tmp_path_factory.mktemp("swept")
    sizes = (64, 128, 256)
    common: dict[str, Any] = {"scene": "free-fall", "runs": 3, "proven": True}
    write_sweep(folder, sizes, simulator="genesis", fails=256, **common)
    write_sweep(folder, sizes, simulator="warp", speed=2.5e5, **common)
    write_sweep(folder, (64, 128), simulator="mjx", **common)
    for run in range(3):
        bad: dict[str, Any] = {"status": "INVALID", "cause": "BUFFER", "reason": "contacts were dropped"}
        bad |= {"gpu_bytes": GPU, "proven": True}
        write_recording(folder, None, simulator="mjx", scene="free-fall", n_env=256, run=run, **bad)
        for simulator, shift in (("genesis", 0.0), ("warp", 1e-5)):
            final = grid(2)
            final[1, 0, 0] += shift
            final[:, 1, 1] += shift * run
            write_recording(folder, final, run=run, simulator=simulator, gpu_bytes=GPU, elapsed_s=1 + run / 10)
    return evaluate_files(sorted(folder.glob("*.mcap")))


def papers(table: Table) -> list[str]:
    """The rows of a table that are the paper's."""
    return [row.cells[0].text for row in table.rows if "the paper's" in row.cells[0].text]


def source(evaluation: Evaluation, *, published: bool = False) -> Source:
    """What a page is made from."""
    return Source(evaluation, published, "gsb-eval")


def test_limits_are_told_apart(swept: Evaluation) -> None:
    """Tell a limit of memory from one of validity, and both from a sweep that nothing ended."""
    rows = {row.label: row.at["free-fall"] for row in capability(swept.sweeps, swept.results)}
    assert {name: (at.n_max, at.limit) for name, at in rows.items()} == {
        "genesis": (128, Limit.MEMORY),
        "mjx": (128, Limit.INVALID),
        "warp": (256, Limit.TRIED),
    }
    assert rows["warp"].fps.value == pytest.approx(2.5e5)
    assert rows["warp"].contacts == 27


def test_capability_table(swept: Evaluation) -> None:
    """Print throughput and memory at N_env^max in the paper's units, and a dash with a reason for what is missing."""
    found = tables_of(swept)
    rows = rows_of(found["capability-free-fall"])
    said = rows["warp"]
    assert (said["throughput [10^4 env-steps/s]"].text, said["memory [GB]"].text) == ("25.000", "0.8")
    assert rows["mjx"]["what limits N; contacts; timed steps"].text == "validity, not memory"
    assert "capability-franka" not in found
    assert "the paper's" not in rows


def test_faults_of_other_scenes_stand_beside_speed(tmp_path: Path) -> None:
    """Name cubes that sank in another scene beside the sweep of the same engine and options, and of no other."""
    for solver, height in (("a", 0.03), ("b", -1.0)):
        write_sweep(tmp_path, (64, 128), simulator="warp", scene="free-fall", options={"solver": solver})
        final = grid(2)
        final[:, :9, 2] = height
        write_recording(tmp_path, final, simulator="warp", options={"solver": solver}, gpu_bytes=(0, 10**9))
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    rows = capability(evaluation.sweeps, evaluation.results)
    sunk = ("inclined-collision: 9 of 27 bodies per env sank",)
    assert [(row.label, row.elsewhere) for row in rows] == [("warp [solver=a]", ()), ("warp [solver=b]", sunk)]
    assert sunk[0] in render_html(evaluation, published=False, command="c")
    assert [one["elsewhere"] for one in to_json(evaluation)["capability"]] == [[], list(sunk)]


def test_variability_table(swept: Evaluation) -> None:
    """Order groups by type, print the paper's digits, and say what a printed zero hides."""
    assert [r.group.key.simulator for r in variability(swept.results)] == ["genesis", "warp"]
    same, other = rows_of(tables_of(swept)["remade-variability"]).values()
    assert (same["parallel [cm]"].text, same["parallel [cm]"].notes) == ("0.00 ± 0.00", ("exactly 0",))
    assert other["parallel [cm]"].text == "0.00 ± 0.00"
    assert other["parallel [cm]"].notes[0].startswith("not 0: 3.7e-05")
    assert other["run-to-run [cm]"].notes[0].startswith("not 0: ")


def test_paper_rows_only_when_asked(swept: Evaluation) -> None:
    """Put the paper's row beside its simulator's, once, when asked."""
    found = tables_of(swept, published=True)
    assert papers(found["remade-variability"]) == ["Genesis, the paper's", "MuJoCo Warp, the paper's"]
    assert len(papers(found["capability-free-fall"])) == 3
    published = [row.cells for row in found["capability-free-fall"].rows if row.cells[0].text == "the paper's"]
    assert sorted((n.text, speed.text, memory.text) for _, n, speed, memory, *_ in published) == [
        ("2,048", "16.600", "5.9"), ("2,048", "2.234", "7.8"), ("512", "0.534", "10.6"),
    ]  # fmt: skip
    section = paper_tables.section(source(swept, published=True))
    (missing,) = [b.text for b in section.blocks if isinstance(b, Text) and "no complete run is here of" in b.text]
    assert "Isaac Lab" in missing
    assert "Madrona" in missing


def test_paper_row_stands_beside_the_default(tmp_path: Path) -> None:
    """Put the paper's row beside the default level, whichever of the levels comes first by type and name."""
    for run in range(2):
        apart = grid(2)
        apart[1, 0, 0] += 0.01 * (1 + run)
        for level, final in (("default", apart), ("all", grid(2))):
            write_recording(tmp_path, final, run=run, simulator="warp", determinism=level)
    found = tables_of(evaluate_files(sorted(tmp_path.glob("*.mcap"))), published=True)["remade-variability"]
    default, paper, other = (row.cells[0].text for row in found.rows)
    assert "default" in default
    assert paper == "MuJoCo Warp, the paper's"
    assert "all" in other


def test_nothing_of_the_published_scenes_is_no_section(apart: Evaluation) -> None:
    """Leave the section out where nothing is of the paper's scenes."""
    elsewhere = tuple(
        replace(r, group=replace(r.group, key=replace(r.group.key, scene="another"))) for r in apart.results
    )
    assert paper_tables.section(source(replace(apart, results=elsewhere))) is None


def test_growth_is_drawn_with_its_fit(apart: Evaluation) -> None:
    """Draw identical runs once, with zeros apart, the fitted window, and the rate that was put in."""
    growth, envs, runs = divergence.pictures(source(apart), apart.results[0])
    assert growth.svg.count('class="fit"') == 1
    assert "exactly 0" in growth.svg
    assert "first bit differs" in growth.svg
    assert "runs 0, 2" in growth.svg
    assert f"{RATE:.3g} per s" in growth.caption
    assert {row[0] for row in growth.numbers.rows} == {"runs 0, 2", "run 1"}
    largest = [row[2] for row in growth.numbers.rows if row[0] == "run 1"]
    assert largest[:10] == [0.0] * 10
    assert largest[-1] == pytest.approx(0.1)
    assert "3 histories, which split between steps 10 and 30 of 60." in envs.caption
    assert [row[6] for row in envs.numbers.rows] == ["2 envs: 0, 3", "env 2", "env 1"]
    assert [row[6] for row in runs.numbers.rows] == ["2 runs: 0, 2", "run 1"]


def test_no_rate_of_a_poor_fit(tmp_path: Path) -> None:
    """Draw no fit and tell no rate where distances do not grow exponentially, and leave the fit to programs."""

    def restless(start: NDArray[Any], step: int) -> NDArray[Any]:
        now = start.copy()
        now[1, 0, 0] += (1e-6, 5e-4, 2e-5)[step % 3] if step > 2 else 0.0
        return now

    for run in range(2):
        write_recording(tmp_path, restless(grid(2), 21), run=run, steps=21, dt=DT, path_of=restless,
                        field=cubes_field("float64"))  # fmt: skip
    found = evaluate_files(sorted(tmp_path.glob("*.mcap")), sample_time=21 * DT)
    metric = found.results[0].metrics["divergence_rate"]
    growth, *_ = divergence.pictures(source(found), found.results[0])
    assert 'class="fit"' not in growth.svg
    assert "No growth rate: R2 0.0" in growth.caption
    row = divergence.onset(found.results[0])
    assert (row.doubling, row.no_doubling) == ("-", metric.value.reason)
    (group,) = to_json(found)["groups"]
    assert group["divergence"][0]["fit"]["r_squared"] < 0.8


def test_onsets_are_tabulated(apart: Evaluation) -> None:
    """Name the step and the time of the first difference, and when a millimetre is reached."""
    row = divergence.onset(apart.results[0])
    assert row.envs == row.runs == "step 10, 0.1 s"
    assert float(row.to_1mm) == pytest.approx(0.1 + np.log(500) / RATE, abs=DT)
    assert float(row.doubling) == pytest.approx(np.log(2) / RATE, rel=0.05)


def test_divergence_in_json(apart: Evaluation) -> None:
    """Give every run's growth and both trees to programs."""
    (group,) = to_json(apart)["groups"]
    assert [one["run"] for one in group["divergence"]] == [0, 1, 2]
    first = group["divergence"][0]
    assert first["fit"]["rate"] == pytest.approx(RATE, rel=0.02)
    assert first["first_apart_s"] == pytest.approx(0.1)
    branches = group["metrics"]["distinct_envs"]["extra"]["tree"]["branches"]
    assert [(b["sample"], b["parent"], b["step"]) for b in branches] == [(0, None, 0), (2, 0, 10), (1, 0, 30)]


def test_matrices_stand_in_order_of_classes(apart: Evaluation) -> None:
    """Put bit-identical envs and runs together, name the classes, and keep the original numbers at the axes."""
    (envs,), (runs,) = consistency.matrices(source(apart), apart.results)
    assert "class A: envs 0, 3; class B: env 1; class C: env 2." in envs.caption
    assert [row[0] for row in envs.numbers.rows] == ["env 0", "env 3", "env 1", "env 2"]
    assert "class A: runs 0, 2; class B: run 1." in runs.caption
    matrix = np.array([row[1:] for row in runs.numbers.rows], dtype=float)
    assert matrix[0, 1] == 0
    assert (matrix[2, :2] > 0).all()
    assert envs.svg.count('class="boundary"') == 4
    ticks = re.findall(r'<text x="[\d.]+" y="[\d.]+" class="end">(\d)</text>', envs.svg)
    assert ticks == ["0", "3", "1", "2"]


def test_dots_show_what_the_radar_compares(swept: Evaluation) -> None:
    """Draw the radar's own values with the intervals of their metrics, sorted, exact zeros open."""
    section = comparison.section(source(swept))
    assert section is not None
    panels = {p.label: p for p in comparison.panels(swept.comparison.contenders)}
    titles = {axis: axis.value for axis in Axis} | {m.radar: m.title for m in METRICS.values() if m.radar}
    for contender in swept.comparison.contenders:
        values = contender.figures.axis_values()
        for axis in (Axis.THROUGHPUT, Axis.MEMORY, Axis.PARALLEL, Axis.RUN_TO_RUN):
            names = (contender.figures.name, f"{contender.figures.name} †")  # mjx is INVALID beyond its N_env^max
            found = [row for row in panels[titles[axis]].numbers.rows if row[0] in names]
            assert [row[1] for row in found] == ([] if values[axis] is None else [values[axis]])
    parallel = panels[titles[Axis.PARALLEL]]
    assert parallel.svg.count("nothing") == 1
    assert "Open circle: exactly 0 (1)." in parallel.caption
    assert "Nothing to show" in panels[titles[Axis.EMD_TO_REAL]].caption
    ranges = {row[0]: row[2:4] for row in panels[titles[Axis.PARALLELISM]].numbers.rows}
    assert ranges["genesis"] == (128.0, 256.0)
    assert ranges["warp"] == (None, None)
    compared = {one["name"]: one for one in to_json(swept)["compared"]}
    assert compared["warp"]["values"]["throughput"]["value"] == pytest.approx(2.5e5)


def test_prices_are_shown(tmp_path: Path) -> None:
    """Show ratio, interval and switch in the page and in JSON, and no price for INVALID runs."""
    for run in range(3):
        for level, speed, more in (("default", 1.0, {}), ("slow", 4.0, {}), ("bad", 1.0, {"status": "INVALID"})):
            write_recording(
                tmp_path, grid(2), run=run, determinism=level, elapsed_s=speed + run / 100, gpu_bytes=(0, 10**9),
                switches={"mode": level}, reason="because", **more,
            )  # fmt: skip
    evaluation = evaluate_files(sorted(tmp_path.glob("*.mcap")))
    (family,) = to_json(evaluation)["price_list"]
    slow = next(one for one in family["levels"] if one["determinism"] == "slow")
    assert slow["throughput_of_default"]["ratio"] == pytest.approx(0.252, abs=0.001)
    assert slow["in_force"] == ["mode=slow"]
    text = render_html(evaluation, published=False, command="c")
    assert "x 0.252" in text
    assert "3 of 3 runs are INVALID, so it has no price" in text


def test_deviations_are_a_matrix(apart: Evaluation) -> None:
    """Give every parameter a row and engines that deviate alike a column; words stand under a letter."""
    (result,) = apart.results
    stated = (
        Deviation("ball.restitution", "0.55", "0", "why"),
        Deviation("contact.friction", "at each point", "at two points of a patch", "why"),
    )

    def with_deviations(name: str, found: tuple[Deviation, ...]) -> Any:
        runs = [replace(r, simulation=replace(r.simulation, deviations=found)) for r in result.group.recordings]
        key = replace(result.group.key, simulator=name)
        return replace(result, label=name, group=replace(result.group, key=key, recordings=tuple(runs)))

    results = [with_deviations("a", stated), with_deviations("b", stated), with_deviations("c", stated[:1])]
    section = deviations.section(source(replace(apart, results=tuple(results))))
    matrix = next(b for b in walk(section.blocks) if isinstance(b, Table))
    assert [column.title for column in matrix.columns] == ["parameter", "wanted", "a, b", "c"]
    assert [[one.text for one in row.cells] for row in matrix.rows] == [
        ["ball.restitution", "0.55", "0", "0"],
        ["contact.friction", "(a)", "(b)", "-"],
    ]
    assert matrix.legend == ("(a) at each point", "(b) at two points of a patch")


def test_figures_have_names_of_their_own(apart: Evaluation, swept: Evaluation) -> None:
    """Name no two figures of a page alike."""
    for evaluation in (apart, swept):
        figures = [one for one in report(source(evaluation)).figures() if one.svg]
        keys = [one.key for one in figures]
        assert keys
        assert all(keys)
        assert len(set(keys)) == len(keys)
        assert all(len(row) == len(one.numbers.titles) for one in figures for row in one.numbers.rows)
