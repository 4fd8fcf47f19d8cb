"""Guidelines: the rules on made-up and on published figures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gpusimbench.evaluator.metrics.guidelines import Guideline, guidelines
from gpusimbench.evaluator.metrics.radar import SimulatorResult
from gpusimbench.evaluator.missing import Missing

PUBLISHED = [
    SimulatorResult("Genesis", 2.234e4, 2**11, 7.8, 4.78, 0.0, 0.0, 11.124e6, 2**17),
    SimulatorResult("Isaac Lab", 47.189e4, 2**12, 3.3, 5.40, 4.21, 0.0, 1.851e6, 2**15),
    SimulatorResult("Madrona", 48.108e4, 2**18, 9.5, 211.6, 32.53, 11.47),
    SimulatorResult("ManiSkill", 7.375e4, 2**12, 8.3, 2.52, 4.76, 0.0, 0.149e6, 2**15),
    SimulatorResult("MJX", 0.534e4, 2**9, 10.6, 3.97, 0.0, 0.0, 1.905e6, 2**19),
    SimulatorResult("MuJoCo Warp", 16.6e4, 2**11, 5.9, 4.23, 4.55, 2.15, 3.541e6, 2**19),
    SimulatorResult("Playground", 0.003e4, 2**8, 8.9, 3.38, 0.0, 1.39, 0.135e6, 2**17),
]

# Where a rule and the paper's own pick (in the comment) differ, the paper weighs something that
# its figures do not state.
PICKS = {
    "overall balance": "Isaac Lab",
    "reproducible and fair comparison, repeated runs": "Genesis",  # MJX, Genesis
    "sim-to-real, contact-rich, tuning over repeated runs": "ManiSkill",  # MJX
    "sim-to-real, contact-rich, single run": "ManiSkill",  # ManiSkill, Playground
    "large parallelism with articulated robots": "Genesis",
    "large parallelism with simple agents": "Madrona",
    "memory-limited, modest parallelism": "Isaac Lab",  # MuJoCo Warp
}


def row(results: list[SimulatorResult], need: str) -> Guideline:
    (found,) = [g for g in guidelines(results) if g.need.startswith(need)]
    return found


def test_needs() -> None:
    """Cover every need once, with a rule in words."""
    rows = guidelines(PUBLISHED)
    assert [g.need for g in rows] == list(PICKS)
    assert all(g.rule for g in rows)


@pytest.mark.parametrize(("need", "pick"), PICKS.items())
def test_published_figures(need: str, pick: str) -> None:
    """Apply the rules to the published figures."""
    found = row(PUBLISHED, need)
    assert found.pick == pick


def test_evidence_names_the_numbers() -> None:
    """Print the deciding numbers, who does not qualify and who was not measured."""
    found = row([*PUBLISHED, SimulatorResult("New", fps=1e9)], "reproducible")
    assert found.evidence.startswith(
        "Genesis (W1 between runs 0.00 cm, W1 between envs 0.00 cm, 2.234e+04 env-steps/s); MJX ("
    )
    assert "do not qualify: Isaac Lab (W1 between runs 0.00 cm, W1 between envs 4.21 cm" in found.evidence
    assert found.evidence.endswith("not measured: New")


def test_overall_prints_the_radar_mean() -> None:
    """Print the radar mean that decides the overall pick."""
    found = row(PUBLISHED, "overall")
    assert found.evidence.startswith("Isaac Lab (radar mean 0.")


def test_nobody_qualifies() -> None:
    """Make no pick where no simulator meets the condition."""
    found = row([PUBLISHED[2], PUBLISHED[5]], "reproducible")
    assert isinstance(found.pick, Missing) and found.evidence is None
    assert found.pick.reason.startswith("no simulator qualifies: Madrona (W1 between runs 11.47 cm")


def test_one_alone_is_no_comparison() -> None:
    """Make no pick where only one simulator has the figures."""
    found = row([PUBLISHED[0], SimulatorResult("New", fps=1.0)], "memory")
    lacking = "missing: GPU memory increment, N_env^max (a sweep)"
    assert found.pick == Missing(f"only Genesis has all the figures that the rule needs; {lacking}")


def test_nothing_measured() -> None:
    """Give a reason in every row where there is nothing to compare."""
    for results in ([], [SimulatorResult("a"), SimulatorResult("b")]):
        for found in guidelines(results):
            assert found.pick.reason.startswith("no simulator has all the figures that the rule needs")
            assert ("; missing: " in found.pick.reason) == bool(results)
    found = row([SimulatorResult(n, run_to_run=0.0) for n in "ab"], "reproducible")
    assert found.pick.reason.endswith("; missing: W1 between envs")


def test_exact_ties_are_both_named() -> None:
    """Name all simulators that share the best value."""
    tied = [SimulatorResult(n, memory_gb=m, n_max=8) for n, m in (("a", 2.0), ("b", 1.0), ("c", 1.0))]
    assert row(tied, "memory").pick == "b, c"


def test_large_parallelism_leaves_out_small_ones() -> None:
    """Leave the fastest out where it sustains few envs."""
    results = [
        SimulatorResult("few", fps=1e9, n_max=2**9),
        SimulatorResult("many", fps=1e5, n_max=2**16),
        SimulatorResult("most", fps=1e4, n_max=2**18),
    ]
    assert row(results, "large parallelism with simple").pick == "many"


def test_refuses_repeated_names() -> None:
    """Refuse two results of one name."""
    with pytest.raises(ValueError, match="more than one"):
        guidelines([PUBLISHED[0], PUBLISHED[0]])


def barred(name: str, **why: str) -> list[SimulatorResult]:
    """The published figures, one simulator of which earns no pick."""
    return [replace(r, **why) if r.name == name else r for r in PUBLISHED]


def test_sunk_cubes_bar_a_pick() -> None:
    """Pick the runner-up of a simulator that is barred, and show who was barred and why."""
    sound = row(PUBLISHED, "large parallelism with simple agents")
    found = row(barred("Madrona", barred="9 of 27 bodies per env sank"), "large parallelism with simple agents")
    assert sound.pick == "Madrona"
    assert found.pick == "Isaac Lab"  # whose N_env^max is the largest of what is left
    assert "barred: Madrona (N_env^max 262144, 4.811e+05 env-steps/s): 9 of 27 bodies per env sank" in found.evidence
    assert found.barred == ("Madrona (N_env^max 262144, 4.811e+05 env-steps/s): 9 of 27 bodies per env sank",)


def test_bars_of_loose_bodies_and_of_robots_are_two() -> None:
    """Let cubes that sank say nothing of a robot, and the other way round."""
    need = "large parallelism with articulated robots"
    assert row(barred("Genesis", barred="cubes sank"), need).pick == "Genesis"
    assert row(barred("Genesis", barred_articulated="2 of 3 runs are INVALID"), need).pick == "MuJoCo Warp"


def test_everyone_barred_is_no_pick() -> None:
    """Make no pick where nobody is left, and keep the reasons."""
    found = guidelines([replace(r, barred="broken") for r in PUBLISHED])[0]
    assert found.pick == Missing("every simulator that has the figures is barred")
    assert len(found.barred) == len(PUBLISHED)


def test_reproducible_without_a_throughput() -> None:
    """Let a simulator qualify as reproducible whose throughput cannot be compared: unranked, with the reason."""
    why = "timed over steps 20 to 120 of the scene, and others over steps 100 to 1,100"
    other = [replace(r, fps=None, why_no_fps=why) if r.name == "MJX" else r for r in PUBLISHED]
    found = row(other, "reproducible")
    assert found.pick == "Genesis"
    assert found.unranked == (f"MJX (W1 between runs 0.00 cm, W1 between envs 0.00 cm): {why}",)
    assert f"qualify too, not ranked: {found.unranked[0]}" in found.evidence
    assert "MJX" not in found.unmeasured
    alone = row([replace(r, fps=None, why_no_fps=why) for r in PUBLISHED], "reproducible")
    assert alone.pick == Missing("no simulator that qualifies can be ranked")
    assert len(alone.unranked) == 2


def test_runner_up() -> None:
    """Name who comes next with its numbers, and nobody where nobody else qualifies."""
    found = row(PUBLISHED, "sim-to-real, contact-rich, single run")
    assert found.runner_up == "Playground (W1 to real trials 3.38 cm)"
    assert row(PUBLISHED, "large parallelism with simple agents").runner_up is None


@pytest.mark.parametrize(
    ("lacking", "named"), [(4, "S0, S1, S2, S3"), (5, "S0, S1, S2, S3, S4"), (6, "S0, S1, S2, S3 and 2 more")]
)
def test_many_unmeasured_are_counted(lacking: int, named: str) -> None:
    """Name a few simulators that lack a figure, and count the others, unless a name takes the place of the count."""
    others = [SimulatorResult(f"S{i}", fps=1.0) for i in range(lacking)]
    evidence = row([*PUBLISHED, *others], "sim-to-real, contact-rich, single run").evidence
    assert evidence.endswith(f"not measured: {named}")
