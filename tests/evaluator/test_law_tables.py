"""The tables of docs/physics/ on laws in closed form: what the scripts measure, and that the pages hold it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.law_changes import EVERY_MASS, Change, change_model, changed_scene
from benchmarks.law_masses import trials as unmoved
from benchmarks.law_power import Setting, recorded_together, table, trials
from benchmarks.loaded_dice import power, throw
from gpusimbench.evaluator.statistics.families import uniformity
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.mujoco.model import compile_scene
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from tests.conftest import call
from tests.scripts import drawn, script

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


def test_a_row_has_measured_values(recorded: Path) -> None:
    """Draw a row for each step, with versions, and the height of the hop."""
    laws = script("make_laws")
    coarse, fine = laws.rows(recorded, "sliding-block")
    assert (coarse.dt, fine.dt) == (0.01, 0.005)
    assert re.fullmatch(r"mujoco \d+\.\d+\.\d+", coarse.engine)
    assert coarse.hop > 2 * fine.hop > 0
    level = coarse.laws["level_acceleration"], fine.laws["level_acceleration"]
    head, _, predicted, *shown = laws.table([coarse, fine]).splitlines()
    assert head.startswith("| engine | step | acceleration of the block on 0 degrees [m/s2] |")
    assert predicted.startswith("| *predicted* | | -2.943 |")
    cells = [[cell.strip().replace("*", "") for cell in line.split("|")[1:-1]] for line in shown]
    assert [row[2] for row in cells] == [f"{law.measured:.4g}" for law in level]
    assert [line.count("**") // 2 for line in shown] == [
        sum(not law.held for law in row.laws.values()) for row in (coarse, fine)
    ]


@pytest.mark.slow
def test_what_nothing_predicts_has_no_verdict(tmp_path: Path) -> None:
    """Show restitutions of MuJoCo, which has no coefficient, without bold type."""
    laws = script("make_laws")
    for dt in laws.STEPS_OF["ball-drop"]:
        call(
            "gsb-record", "--sim", "mujoco", "--scene", "ball-drop", "--dt", dt, "--steps", round(0.8 / dt),
            "--n-env", laws.ENVS, "--runs", 1, "--phases", "capture", "--initial", "random:0.2", "--no-view",
            "--option", "solref=0.02 0.2", "--out", tmp_path / laws.name_of("ball-drop", "mujoco", _BOUNCY, dt), code=0,
        )  # fmt: skip
    coarse, fine = laws.rows(tmp_path, "ball-drop")
    assert set(coarse.laws) == {"low_restitution", "low_gain"}
    predicted, one, other = (
        [cell.strip() for cell in line.split("|")[3:-1]] for line in laws.table([coarse, fine]).splitlines()[2:]
    )
    assert predicted == ["-", "0"]
    assert [cell.startswith("**") for cell in one] == [False, True]  # the energy that the ball gains
    low = fine.laws["low_restitution"].measured
    assert other[0] == f"{low:.4g}"


def test_the_page_has_the_tables_of_the_scripts() -> None:
    """Hold a row of every engine with its version, and a cell for every law, between the markers."""
    laws = script("make_laws")
    six = {"mujoco", "warp", "mjx", "physx", "sapien", "genesis"}
    for name, engines in (
        ("laws of pendulum", six), ("laws of sliding-block", six), ("laws of ball-drop", {"mujoco", "warp", "newton"}),
        ("laws of four-bar", {"mujoco", "warp", "mjx", "genesis"}),
    ):  # fmt: skip
        shown = drawn(laws.PAGE, name)
        assert len(shown.strip().splitlines()) > 4
        assert re.search(r"mujoco \d+\.\d+\.\d+", shown)
        cells = [line.split("|")[1:-1] for line in shown.strip().splitlines()]
        assert len({len(row) for row in cells}) == 1
        assert {row[0].split()[0] for row in cells[3:]} >= engines


def test_engines_that_were_not_measured_anew_keep_their_rows() -> None:
    """Draw the page as it is where one engine alone was measured again; refuse where the columns are others."""
    laws = script("make_laws")
    for scene in laws.SECONDS:
        shown = drawn(laws.PAGE, f"laws of {scene}").strip()
        head, rows = shown.splitlines()[:3], shown.splitlines()[3:]
        engines = list(dict.fromkeys(line.split("|")[1] for line in rows))
        again = "\n".join([*head, *(line for line in rows if line.split("|")[1] == engines[1])])
        assert laws.with_earlier(scene, again, shown) == shown
        other = again.replace("| engine |", "| engine | new law |", 1)
        with pytest.raises(SystemExit, match="record these too: "):
            laws.with_earlier(scene, other, shown)


def test_a_change_is_that_of_the_named_lane_and_of_the_joint() -> None:
    """Change the friction of a block and of its plank, and of no other, and the damping of the named joints."""
    scene = make_scene("sliding-block")
    after = changed_scene(scene, [Change("friction", "level", 0.1)])
    made = {body.name: body.material.kinetic_friction for body in after.bodies}
    assert made["level"] == made["plank-level"] == pytest.approx(0.33)
    assert {value for name, value in made.items() if "level" not in name} == {0.3}
    dampings = {
        name: [joint.friction for joint in robot.joints()]
        for name, subject in (("pendulum", "energy"), ("double-pendulum", "small"))
        if (robot := changed_scene(make_scene(name), [Change("damping", subject, 1e-3)]).robot)
    }
    assert dampings == {"pendulum": [1e-3], "double-pendulum": [0.0, 0.0, 1e-3, 1e-3]}


def test_a_linkage_has_other_links() -> None:
    """Move the pin of a loop that begins closed, give one link more mass about the same centre, and damp all joints."""
    scene = make_scene("four-bar")
    lengths = Change("coupler's length", "rocker", 0.01), Change("rocker's length", "coupler", -0.02)
    robot = changed_scene(scene, [*lengths, Change("rocker's mass", "", 0.1), Change("damping", "energy", 1e-3)]).robot
    assert robot is not None and scene.robot is not None and (linkage := robot.four_bar())
    assert (linkage.ground, linkage.crank) == (0.6, 0.2)
    assert (linkage.coupler, linkage.rocker) == pytest.approx((0.505, 0.392))
    crank, coupler, rocker = robot.start
    ends = [
        0.2 * np.exp(1j * crank) + 0.505 * np.exp(1j * (crank + coupler)), 0.6 + 0.392 * np.exp(1j * rocker)
    ]  # fmt: skip
    assert crank == scene.robot.start[0] and abs(ends[0] - ends[1]) < 1e-12
    assert [joint.friction for joint in robot.joints()] == [1e-3] * 3
    before, after = (
        {link.name: (link.inertial.mass, *link.inertial.inertia[:3], link.inertial.centre) for link in one.links}
        for one in (scene.robot, robot)
    )
    *solid, centre = before.pop("rocker")
    *heavier, same = after.pop("rocker")
    assert heavier == pytest.approx(np.multiply(solid, 1.1)) and same == centre and after == before


def test_a_scene_has_another_gravity_and_restitution() -> None:
    """Change what all bodies have in common."""
    after = changed_scene(make_scene("ball-drop"), [Change("gravity", "", 0.01), Change("restitution", "low", -0.1)])
    assert after.gravity == pytest.approx((0.0, 0.0, -9.81 * 1.01))
    assert [body.material.restitution for body in after.bodies] == pytest.approx([0.54] * 4)


def test_a_model_has_another_moment_and_damping() -> None:
    """Change the middle moment of one body, with what MuJoCo computes of it once, and damp the turns of another."""
    model = compile_scene(make_scene("free-body"), dt=0.01, options=MjcfOptions()).model
    before = model.body_inertia.copy(), model.dof_M0.copy()
    change_model(model, [Change("middle moment", "middle", 0.02), Change("angular damping", "long", 1e-3)])
    body, damped = int(model.body("middle").id), int(model.body("long").id)
    shares = model.body_inertia / before[0].clip(min=1e-12)
    assert shares[body] == pytest.approx((1.0, 1.02, 1.0)) and shares[damped] == pytest.approx((1.0, 1.0, 1.0))
    first = int(model.body_dofadr[body])
    assert model.dof_M0[first : first + 6] / before[1][first : first + 6] == pytest.approx((1, 1, 1, 1, 1.02, 1))
    first = int(model.body_dofadr[damped])
    assert model.dof_damping[first : first + 6] == pytest.approx((0, 0, 0, *(1e-3 * before[0][damped])))
    assert model.dof_damping.sum() == pytest.approx(1e-3 * before[0][damped].sum())


def test_one_recording_has_one_gravity_and_the_friction_of_each_lane() -> None:
    """Put laws of several bodies together only where each of them has the parameter."""
    lanes = [("level_distance", "friction"), ("uphill_distance", "friction"), ("level_acceleration", "friction")]
    assert recorded_together(lanes) == [lanes[:2], lanes[2:]]
    balls = [("low_contact", "gravity"), ("high_contact", "gravity")]
    assert recorded_together(balls) == [balls[:1], balls[1:]]


@pytest.mark.slow
def test_a_damped_pendulum_is_noticed_and_an_undamped_one_is_not(tmp_path: Path) -> None:
    """See the claimed damping in every recording of two repetitions, and break no law without it."""
    counts = trials(Setting("mujoco", "pendulum", 0.01, tmp_path), 2)["energy_change", "damping"]
    assert counts.broken == counts.pairs == [True, True]
    assert counts.broken_unchanged == [False, False]
    assert max(counts.least) < min(counts.breaks)
    assert not list(tmp_path.iterdir())


def test_other_masses_move_nothing_but_what_depends_on_them(tmp_path: Path) -> None:
    """Give every body and link other masses and moments, see no law move that is insensitive to them, and leave out
    those that are not."""
    scene = make_scene("pendulum")
    (link,) = (one for one in scene.robot.links if one.joint is not None)
    (heavier,) = (one for one in changed_scene(scene, [Change(EVERY_MASS, "", 0.2)]).robot.links if one.joint)
    assert heavier.inertial.mass == pytest.approx(1.2 * link.inertial.mass)
    bodies = changed_scene(make_scene("ball-drop"), [Change(EVERY_MASS, "", 0.2)]).bodies
    for body, before in zip(bodies, make_scene("ball-drop").bodies, strict=True):
        assert body.mass == (None if before.mass is None else pytest.approx(1.2 * before.mass))
    counts = unmoved(Setting("mujoco", "pendulum", 0.01, tmp_path), 1, 0.2)
    assert set(counts) == {"period", "energy_change"}
    for one in counts.values():
        assert max(one.moved) < 1e-6
        assert one.broken == one.broken_unchanged == [False]


@pytest.mark.slow
def test_other_friction_is_noticed(tmp_path: Path) -> None:
    """See the claimed friction in both directions, but for 1 of 20 pairs, and break no law without a change."""
    shown = table(Setting("mujoco", "sliding-block", 0.004, tmp_path), 2)
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in shown]
    assert len(rows) == 7
    assert {row[-1] for row in rows} == {"0 of 2"}
    for column in (4, 7):  # 14 chances each: two or fewer misses in 97 of 100 machines that step otherwise
        assert sum(int(row[column].split()[0]) for row in rows if row[column] != "-") >= 12, shown


@pytest.mark.slow
def test_a_heavier_rocker_is_noticed(tmp_path: Path) -> None:
    """See the claimed mass in a pair of recordings and in a verdict, and break no law without it."""
    options = {"integrator": "RK4", "solref": "0.002 1"}
    setting = Setting("mujoco", "four-bar", 0.004, tmp_path, options, only="rocker's mass")
    (counts,) = trials(setting, 1).values()
    assert counts.law.key == "period" and counts.pairs == counts.broken == [True]
    assert counts.broken_unchanged == [False] and 0.0 < counts.least[0] < counts.breaks[0] < 0.1


_COUNTED = """| step | law | change of | size | seen | without | size | broken | without |
| ---: | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |
| 4 ms | speed of it | x | 1 % | 38 of 40 | 2 of 40 | 2 % | 33 of 40 | 0 of 40 |
| 4 ms | b | x | 0.5 % | 35 of 40 | 7 of 40 | - | - | 40 of 40 |
| 4 ms | c | y | 1 % | 38 of 40 | 2 of 40 | - | - | 0 of 40 |

mujoco 4.0.0, 32 environments, 40 repetitions.
"""


def test_rates_are_added_up_and_those_far_from_their_claim_are_named(tmp_path: Path) -> None:
    """Add up the laws of a parameter, and name what a rate of 95 %, or of 5 % without a change, would give in less
    than 1 of 100 counts."""
    power = script("make_power")
    name = next(iter(power.COUNTS))
    (tmp_path / f"{name}.md").write_text(_COUNTED, encoding="utf-8")
    shown = power.block(tmp_path)
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in shown.splitlines() if "| 4 ms" in line]
    assert rows == [
        [
            "pendulum, mujoco 4.0.0",
            "4 ms",
            "x",
            "2",
            "0.5 to 1 %",
            "73 of 80",
            "9 of 80",
            "2 %",
            "33 of 40",
            "40 of 80",
        ],
        ["pendulum, mujoco 4.0.0", "4 ms", "y", "1", "1 %", "38 of 40", "2 of 40", "-", "-", "0 of 40"],
    ]
    assert "111 of 120 pairs with a change were seen, and 33 of 40 verdicts broken" in shown
    assert "without a change 11 of 120 pairs differed. Of the 7 rates of single laws, 2 are so far" in shown
    assert (
        "1 %: speed of it (pendulum, mujoco 4.0.0, 4 ms): 33 of 40; b (pendulum, mujoco 4.0.0, 4 ms): 7 of 40." in shown
    )


def test_a_heavy_face_comes_to_lie_below(tmp_path: Path) -> None:
    """See the face opposite to a heavy one on top in a third of the throws or more, and the law broken by it."""
    setting = Setting("mujoco", "dice-drop", 0.01, tmp_path, n_env=16)
    heavy = throw(setting, 0.5, 1)
    assert sum(heavy.counts) > 150
    assert heavy.counts[5] > sum(heavy.counts) / 3 > sum(heavy.counts) / 8 > heavy.counts[2]
    assert not heavy.law.held


def test_the_power_by_probabilities_is_that_of_the_claim() -> None:
    """Give the size that the law claims the power that it claims it with, and equal faces its level."""
    claim = uniformity([64] * 6, alpha=1e-3, power=0.95)
    one = np.array([1.0 + claim.least] + [1.0 - claim.least / 5.0] * 5) / 6.0
    assert power(one, 384, claim.critical) == pytest.approx(0.95, abs=1e-6)
    assert power(np.full(6, 1.0 / 6.0), 384, claim.critical) == pytest.approx(1e-3, rel=1e-3)
