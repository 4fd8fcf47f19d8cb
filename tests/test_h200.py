"""The recordings that ship under recordings/h200, protocol-h200 and sweeps-h100, and what the documents say of them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.report.leaders import fastest
from gpusimbench.evaluator.results.evaluate import evaluate_files
from tests.conftest import call
from tests.reading import verified
from tests.scripts import drawn, script

ROOT = Path(__file__).resolve().parent.parent
PROTOCOL = ROOT / "recordings" / "protocol-h200"
FILES = sorted((ROOT / "recordings" / "h200").glob("*.mcap"))
SWEPT = sorted((ROOT / "recordings" / "sweeps-h100").glob("*.mcap"))
NEWER = sorted(PROTOCOL.glob("*.mcap"))


@pytest.fixture(scope="module")
def tables() -> Iterator[Any]:
    """docs/make_h200.py; its evaluate_files evaluates the same files once."""
    made, once = script("make_h200"), cache(evaluate_files)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(made, "evaluate_files", lambda paths: once(tuple(paths)))
        yield made


@pytest.fixture(scope="module")
def evaluation(tables: Any) -> Any:
    """Of the whole set."""
    return tables.shipped()


@pytest.mark.slow
def test_documents_show_what_the_files_say(tables: Any, evaluation: Any) -> None:
    """Hold the tables of both pages to the recordings; make figures redraws them."""
    for page, blocks in tables.blocks(evaluation).items():
        assert {name: drawn(page, name) for name in blocks} == blocks, f"{page}: run make figures"


@pytest.mark.slow
def test_the_readme_says_what_probes_found(tables: Any) -> None:
    """Hold the README's sentences on probes to the table that they stand for."""
    titles, _, *lines = (
        [cell.strip("* ") for cell in line.split("|")[1:-1]] for line in tables.invariance().splitlines()
    )
    rows = [dict(zip(titles, line, strict=True)) for line in lines]

    def who(key: str) -> set[str]:
        repeat = [row for row in rows if row["runs"] == "yes"]
        return {row[titles[0]].split()[0].strip(",") for row in repeat if row[key] == "no"}

    assert who("number") == {"mjx", "newton", "physx"}
    assert who("fresh") == {"physx", "isaaclab"}
    assert [key for key in titles if "genesis" in who(key)] == ["set"]


@pytest.mark.slow
def test_rules_not_met_are_counted(evaluation: Any) -> None:
    """Count as gsb-check --protocol does, over the whole set and over its groups."""
    assert evaluation.unmet.findings == {
        "runs": 23, "clocks-sampled": 52, "timed-seconds": 7, "window-begin": 16, "work-evidence": 11,
        "contacts-at-the-end": 7, "sample-step": 3, "same-window": 1,
    }  # fmt: skip
    assert evaluation.unmet.count == 120
    assert sum(result.timed.unmet.count for result in evaluation.results) == 124  # one window, five groups


@pytest.mark.slow
def test_prices_are_those_of_levels(evaluation: Any) -> None:
    """Price six levels, of which two cannot be told apart from the default; no group at the default level."""
    prices = {p.result.label: p for family in evaluation.price_list for p in family.prices}
    assert all(p.level != "default" for p in prices.values())
    priced = {label for label, p in prices.items() if known(p.speed.ratio) is not None}
    assert len(priced) == 6
    assert {(p.result.group.key.simulator, p.level) for p in prices.values() if p.speed.undecided} == {
        ("physx", "enhanced"), ("warp", "contacts-constraint"),
    }  # fmt: skip


@pytest.mark.slow
def test_nobody_is_named_whose_runs_are_wrong(tables: Any, evaluation: Any) -> None:
    """Bar what is INVALID or breaks mechanics in any scene; keep the levels of MJX among the reproducible."""
    barred_at_16 = {c.figures.name for c in tables.on_h200().comparison.contenders if c.figures.barred}
    assert any(name.startswith("isaaclab [backend=newton") for name in barred_at_16)
    compared = evaluate_files([*FILES, *SWEPT]).comparison
    barred = {c.figures.name for c in compared.contenders if c.figures.barred}
    for wrong in ({"brax"}, {"newton", "NVIDIA H200", "determinism=default", "solver=xpbd"}):
        assert any(wrong <= set(re.split(r" \[|, |\]", name)) for name in barred), wrong
    picks = {name for g in compared.guidelines if g.pick for name in g.pick.split("; ")}
    assert picks
    assert not picks & barred
    (reproducible,) = [g for g in compared.guidelines if g.need.startswith("reproducible")]
    for level in ("exclude-nondeterministic", "no-autotune", "run-to-run"):
        assert any(level in one for one in reproducible.unranked)
    for one in (*fastest(evaluation.results), *fastest(tables.evaluate_files(tables.of_protocol(PROTOCOL)).results)):
        assert one.first is not None
        for speed in filter(None, (one.first, one.second)):
            assert speed.result.group.key.simulator not in ("brax", "calibration")
            assert "xpbd" not in speed.result.label


@pytest.mark.slow
def test_six_configurations_meet_the_protocol(tables: Any) -> None:
    """Find of the runs by the protocol those open that the card names, for the reasons that it names."""
    found = tables.evaluate_files(tables.of_protocol(PROTOCOL)).results
    unmet = {str(result.label): set(result.timed.unmet.findings) for result in found}
    assert {name.split()[0]: rules for name, rules in unmet.items() if rules} == {
        "brax": {"contacts-at-the-end", "runs"}, "newton": {"contacts-at-the-end", "runs"},
        "isaaclab": {"work-evidence"}, "physx": {"work-evidence"},
    }  # fmt: skip
    assert sum(not rules for rules in unmet.values()) == 6


@pytest.mark.slow
def test_every_file_is_whole() -> None:
    """Verify every byte of every recording of the three sets."""
    assert (len(FILES), len(NEWER), len(SWEPT)) == (65, 90, 103)
    for path in (*FILES, *NEWER, *SWEPT):
        recording = verified(path)
        device = "NVIDIA H100 80GB HBM3" if path in SWEPT else "NVIDIA H200"
        assert recording.simulation is None or recording.simulation.device == device


@pytest.mark.slow
def test_sweeps_break_the_rules_that_their_card_names(tables: Any) -> None:
    """Find three runs at each number of environments where ten are asked for, and uncounted contacts of PhysX alone."""
    sweeps = tables.evaluate_files(SWEPT).sweeps
    assert len({(sweep.key.scene, sweep.label) for sweep in sweeps}) == len(sweeps) == 12  # no sweep falls into parts
    points = [point for sweep in sweeps for point in sweep.points]
    whole = [point.result for point in points if known(point.result.metrics["fps"].value) is not None]
    assert len(whole) == 33
    for result in whole:
        uncounted = {"work-evidence"} if result.group.key.simulator in ("physx", "isaaclab") else set()
        assert set(result.timed.unmet.findings) - {"clocks-sampled"} == {"runs"} | uncounted
        assert result.metrics["fps"].n == 3


def test_the_set_is_small() -> None:
    """Stay below what a clone can be asked to carry."""
    everything = sum(path.stat().st_size for path in (ROOT / "recordings").rglob("*.mcap"))
    assert everything < 150e6


def test_states_of_mjx_agree_where_fingerprints_do() -> None:
    """Find the environments of MJX (jax) equal in their states too, not by their hashes alone."""
    found = [Recording(p) for p in FILES if p.name.startswith("mjx-jax-inclined")]
    assert found
    for recording in found:
        positions = recording.state("cubes", "position")[-1]
        assert (positions == positions[:1]).all()


@pytest.mark.parametrize("name", ["mjx-jax-run-to-run", "newton-xpbd-run-to-run"])
def test_replays_on_another_machine_are_bit_identical(name: str) -> None:
    """Hold the shipped replays against their originals, and see that another machine made them."""
    original = ROOT / "recordings" / "h200" / f"{name}-inclined-collision-n16-r0.mcap"
    replay = ROOT / "recordings" / "replays" / f"{name}-inclined-collision-n16-replayed.mcap"
    done = call("gsb-diff", original, replay, code=0)
    assert "bit-identical" in done.stdout
    there, here = (open_recording(path).provenance for path in (original, replay))
    assert there.host["threads"] != here.host["threads"]
    assert there.run_id != here.run_id


@pytest.mark.slow
def test_errors_of_tosses_bar_throughputs_of_more_environments() -> None:
    """Name no configuration fastest with 4,096 environments that breaks mechanics with 48, which begin otherwise."""
    tosses = ROOT / "recordings" / "cube-toss-h100"
    (found,) = fastest(evaluate_files(sorted(tosses.glob("*.mcap"))).results)
    options = json.loads(found.first.result.group.key.options)
    assert (found.first.result.group.key.simulator, options["cone"]) == ("warp", "elliptic")


@pytest.mark.slow
def test_the_table_of_devices_is_that_of_the_files() -> None:
    """Compare the runs of every simulator that was recorded on two devices, as the page says."""
    drawn = script("make_devices").table()
    assert drawn in (ROOT / "docs" / "determinism.md").read_text(encoding="utf-8")
    alike = [line for line in drawn.splitlines() if "H100" in line and "H200" in line and "same bits" in line]
    assert len(alike) >= 6
