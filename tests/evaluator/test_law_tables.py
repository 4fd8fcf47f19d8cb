"""The tables of docs/physics.md on laws in closed form: what the scripts measure, and that the page holds it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.law_power import Setting, changed, table, trials
from gpusimbench.recorder.scenes.registry import make_scene
from tests.conftest import call
from tests.scripts import script

_BOUNCY = ("--option", "solref=0.02 0.2")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Blocks on MuJoCo C at 10 and 5 ms, for half a second, where docs/make_laws.py looks for them."""
    folder = tmp_path_factory.mktemp("laws")
    laws = script("make_laws")
    for dt in (0.01, 0.005):
        target = folder / laws.name_of("sliding-block", "mujoco", (), dt)
        call(
            "gsb-record", "--sim", "mujoco", "--scene", "sliding-block", "--dt", dt, "--steps", round(0.5 / dt),
            "--n-env", laws.ENVS, "--runs", 1, "--phases", "capture", "--initial", "random:0.8", "--no-view",
            "--out", target, code=0,
        )  # fmt: skip
    return folder


def test_a_row_has_measured_values_and_how_they_change_with_the_step(recorded: Path) -> None:
    """Draw a row for each step, with versions, changes behind the values of the second, and the height of the hop."""
    laws = script("make_laws")
    coarse, fine = laws.rows(recorded, "sliding-block")
    assert (coarse.dt, fine.dt) == (0.01, 0.005)
    assert re.fullmatch(r"mujoco \d+\.\d+\.\d+", coarse.engine)
    assert coarse.hop > 2 * fine.hop > 0
    level = coarse.laws["level_acceleration"], fine.laws["level_acceleration"]
    head, _, predicted, *shown = laws.table([coarse, fine]).splitlines()
    assert head.startswith("| engine | step | acceleration of the block on 0 degrees [m/s2] |")
    assert predicted.startswith("| *predicted* | | -2.943 |")
    change = 100 * (level[1].measured - level[0].measured) / 2.943
    cells = [[cell.strip().replace("*", "") for cell in line.split("|")[1:-1]] for line in shown]
    assert cells[0][2] == f"{level[0].measured:.4g}"
    assert cells[1][2] == f"{level[1].measured:.4g} ({change:+.2g} %)"
    assert [line.count("**") // 2 for line in shown] == [
        sum(not law.held for law in row.laws.values()) for row in (coarse, fine)
    ]


@pytest.mark.slow
def test_what_nothing_predicts_has_neither_a_verdict_nor_a_share(tmp_path: Path) -> None:
    """Show restitutions of MuJoCo, which has no coefficient, without bold type, and their differences as they are."""
    laws = script("make_laws")
    for dt in laws.STEPS_OF["ball-drop"]:
        call(
            "gsb-record", "--sim", "mujoco", "--scene", "ball-drop", "--dt", dt, "--steps", round(0.8 / dt),
            "--n-env", laws.ENVS, "--runs", 1, "--phases", "capture", "--initial", "random:0.2", "--no-view",
            "--option", "solref=0.02 0.2", "--out", tmp_path / laws.name_of("ball-drop", "mujoco", _BOUNCY, dt), code=0,
        )  # fmt: skip
    coarse, fine = laws.rows(tmp_path, "ball-drop")
    assert set(coarse.laws) == {
        f"{ball}_{what}" for ball in ("low", "middle", "high") for what in ("restitution", "gain")
    }
    predicted, one, other = (
        [cell.strip() for cell in line.split("|")[3:-1]] for line in laws.table([coarse, fine]).splitlines()[2:]
    )
    assert predicted == ["-", "0"] * 3
    assert [cell.startswith("**") for cell in one] == [False, True] * 3  # the energy that each ball gains
    low = coarse.laws["low_restitution"].measured, fine.laws["low_restitution"].measured
    assert other[0] == f"{low[1]:.4g} ({low[1] - low[0]:+.2g})"


def test_the_page_has_the_tables_of_the_scripts() -> None:
    """Hold a row of every engine with its version, and a cell for every law, between the markers."""
    laws = script("make_laws")
    page = laws.PAGE.read_text(encoding="utf-8")
    six = {"mujoco", "warp", "mjx", "physx", "sapien", "genesis"}
    for name, engines in (
        ("laws of pendulum", six), ("laws of sliding-block", six), ("laws of ball-drop", {"mujoco", "warp", "newton"}),
        ("laws of four-bar", {"mujoco", "warp", "mjx", "genesis"}), ("power of the laws", set()),
    ):  # fmt: skip
        shown = page.split(laws.BEGIN.format(name))[1].split(laws.END.format(name))[0]
        assert len(shown.strip().splitlines()) > 4
        assert re.search(r"mujoco \d+\.\d+\.\d+", shown)
        if engines:
            cells = [line.split("|")[1:-1] for line in shown.strip().splitlines()]
            assert len({len(row) for row in cells}) == 1
            assert {row[0].split()[0] for row in cells[3:]} >= engines


def test_totals_are_those_of_all_rows() -> None:
    """Add up what was seen and broken, with and without a change, and leave out what was not claimed."""
    head = "| step | law | change of | size | seen | without | size | broken | without |\n| --- |\n"
    rows = "| 4 ms | a of b | x | 1 % | 9 of 10 | 1 of 10 | 2 % | 8 of 8 | 0 of 10 |\n"
    rows += "| 4 ms | b | x | 1 % | 10 of 10 | 0 of 10 | - | - | 3 of 10 |\n\n"
    said = script("make_laws").totals(head + rows + "mujoco 4.0.0, 32 environments, 10 repetitions.")
    assert said == (
        "All rows together: 19 of 20 pairs with a change were seen, and 8 of 8 verdicts broken; without a change 1 of "
        "20 pairs differed, and 3 of 20 verdicts were broken."
    )


def test_a_change_is_that_of_the_named_lane_and_of_the_joint() -> None:
    """Change the friction of a block and of its plank, and of no other, and the damping of the joint."""
    scene = make_scene("sliding-block")
    made = {body.name: body.material.kinetic_friction for body in changed(scene, {"level": 0.1}, 0.0).bodies}
    assert made["level"] == made["plank-level"] == pytest.approx(0.33)
    assert {value for name, value in made.items() if "level" not in name} == {0.3}
    robot = changed(make_scene("pendulum"), {}, 1e-3).robot
    assert robot is not None
    assert [joint.friction for joint in robot.joints()] == [1e-3]


def test_a_damped_pendulum_is_noticed_and_an_undamped_one_is_not(tmp_path: Path) -> None:
    """See the claimed damping in every recording of two repetitions, and break no law without it."""
    counts = trials(Setting("mujoco", "pendulum", 0.01, tmp_path), 2)["energy_change", "damping"]
    assert counts.broken == counts.pairs == [True, True]
    assert counts.broken_unchanged == [False, False]
    assert max(counts.least) < min(counts.breaks)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_other_friction_is_noticed(tmp_path: Path) -> None:
    """See the claimed friction in both directions, but for 1 of 20 pairs, and break no law without a change."""
    shown = table(Setting("mujoco", "sliding-block", 0.004, tmp_path), 2)
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in shown]
    assert len(rows) == 7
    assert {row[-1] for row in rows} == {"0 of 2"}
    for column in (4, 7):  # 14 chances each: two or fewer misses in 97 of 100 machines that step otherwise
        assert sum(int(row[column].split()[0]) for row in rows if row[column] != "-") >= 12, shown
