"""Guidelines: which simulator for which need, each pick derived by a rule that is printed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from gpusimbench.evaluator.metrics.radar import SimulatorResult, radar, require_unique_names
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics.regimes import is_present

Results = Sequence[SimulatorResult]

# "Large parallelism" is within this factor of the largest N_env^max that any simulator sustains.
LARGE_FACTOR = 4

_NAMED = 4  # simulators that lack a figure


class _Figure(NamedTuple):
    text: str  # with its value
    title: str  # where it has none


_FIGURES: dict[str, _Figure] = {
    "fps": _Figure("{:.4g} env-steps/s", "throughput"),
    "n_max": _Figure("N_env^max {}", "N_env^max (a sweep)"),
    "memory_gb": _Figure("{:.4g} GB", "GPU memory increment"),
    "w1_real": _Figure("W1 to real trials {:.2f} cm", "W1 to real trials"),
    "parallel": _Figure("W1 between envs {:.2f} cm", "W1 between envs"),
    "run_to_run": _Figure("W1 between runs {:.2f} cm", "W1 between runs"),
    "fps_articulated": _Figure("{:.4g} env-steps/s", "throughput of a robot"),
    "n_max_articulated": _Figure("N_env^max {}", "N_env^max of a robot (a sweep)"),
}


@dataclass(frozen=True)
class Guideline:
    """One row: a need and the simulator that meets it best among those compared.

    need          what a user wants
    pick          the simulator, exact ties joined by ", "; or why no pick can be made
    rule          how the pick is made, in words
    evidence      the numbers that decided, best first; None without a pick
    runner_up     who would be picked if the pick were not there; None where there is no other that qualifies
    ranking       simulators that qualify with the figures that decided, best first
    disqualified  simulators that have the figures and do not qualify, with them
    barred        simulators that have the figures and earn no pick, each with the reason
    unmeasured    simulators that lack a figure
    unranked      simulators that qualify as well, with a figure missing that would rank them, each with the reason
    """

    need: str
    pick: str | Missing
    rule: str
    evidence: str | None
    runner_up: str | None = None
    ranking: tuple[str, ...] = ()
    disqualified: tuple[str, ...] = ()
    barred: tuple[str, ...] = ()
    unmeasured: tuple[str, ...] = ()
    unranked: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Rule:
    """A rule as data.

    figures   fields of SimulatorResult that a candidate must have
    ranks     a field that only ranks those that qualify; who lacks it qualifies unranked. May be empty
    narrow    candidates, all with these figures -> those that qualify
    score     candidate, all results -> key, highest is best
    """

    need: str
    words: str
    figures: tuple[str, ...]
    narrow: Callable[[Results], list[SimulatorResult]]
    score: Callable[[SimulatorResult, Results], float]
    ranks: str = ""


def guidelines(results: Results) -> list[Guideline]:
    """One row for every need of the benchmark's guidelines.

    The needs are those of GPUSimBench; the paper gives picks and no rule, so the rules are this
    project's own. A simulator that lacks a figure that a rule names is left out of that rule and
    listed. So is one that is barred: INVALID runs, sunk cubes, broken mechanics or broken laws make a figure no
    merit, whatever it is. One simulator alone is no comparison and yields no pick.

    Raises:
        ValueError: two results of the same name.
    """
    require_unique_names(results)
    return [_apply(rule, results) for rule in _RULES]


def _apply(rule: _Rule, results: Results) -> Guideline:
    measured = [r for r in results if all(getattr(r, f) is not None for f in rule.figures)]
    unmeasured = tuple(r.name for r in results if r not in measured)
    if len(measured) < 2:
        have = f"only {measured[0].name} has" if measured else "no simulator has"
        lacking = [f for f in rule.figures if any(getattr(r, f) is None for r in results)]
        missing = f"; missing: {', '.join(_FIGURES[f].title for f in lacking)}" if lacking else ""
        return _no_pick(rule, f"{have} all the figures that the rule needs{missing}", unmeasured)
    barred = tuple(f"{_figures(rule, r)}: {_bar(rule, r)}" for r in measured if _bar(rule, r))
    sound = [r for r in measured if not _bar(rule, r)]
    if not sound:
        return _no_pick(rule, "every simulator that has the figures is barred", unmeasured, barred)
    qualified = rule.narrow(sound)
    if not qualified:
        figures = "; ".join(_figures(rule, r) for r in sound)
        return _no_pick(rule, f"no simulator qualifies: {figures}", unmeasured, barred)
    able = [r for r in qualified if not rule.ranks or getattr(r, rule.ranks) is not None]
    unranked = tuple(f"{_figures(rule, r)}: {r.why_no_fps or 'not timed'}" for r in qualified if r not in able)
    if not able:
        return _no_pick(rule, "no simulator that qualifies can be ranked", unmeasured, barred, unranked)
    scores = {r.name: rule.score(r, results) for r in able}
    ranked = sorted(able, key=lambda r: scores[r.name], reverse=True)
    best = scores[ranked[0].name]
    ranking = tuple(_figures(rule, r, results) for r in ranked)
    evidence = list(ranking)
    if unranked:
        evidence.append("qualify too, not ranked: " + ", ".join(unranked))
    disqualified = tuple(_figures(rule, r) for r in sound if r not in qualified)
    if disqualified:
        evidence.append("do not qualify: " + ", ".join(disqualified))
    if barred:
        evidence.append("barred: " + ", ".join(barred))
    if unmeasured:
        evidence.append("not measured: " + _shortened(unmeasured))
    pick = ", ".join(r.name for r in ranked if scores[r.name] == best)
    runner_up = next((_figures(rule, r, results) for r in ranked if scores[r.name] != best), None)
    said = "; ".join(evidence)
    return Guideline(rule.need, pick, rule.words, said, runner_up, ranking, disqualified, barred, unmeasured, unranked)


def _no_pick(
    rule: _Rule,
    reason: str,
    unmeasured: tuple[str, ...],
    barred: tuple[str, ...] = (),
    unranked: tuple[str, ...] = (),
) -> Guideline:
    return Guideline(
        rule.need, Missing(reason), rule.words, None, barred=barred, unmeasured=unmeasured, unranked=unranked
    )  # fmt: skip


def _bar(rule: _Rule, result: SimulatorResult) -> str:
    """Why a simulator earns no pick by a rule; a robot's figures are not those of loose bodies."""
    articulated = all(figure.endswith("articulated") for figure in rule.figures)
    return result.barred_articulated if articulated else result.barred


def _shortened(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names) if more <= 1 else f"{', '.join(names[:_NAMED])} and {more} more"


def _figures(rule: _Rule, result: SimulatorResult, results: Results | None = None) -> str:
    """A simulator and its figures, e.g. "MJX (5340 env-steps/s, N_env^max 512)"."""
    named = [*rule.figures, *([rule.ranks] if rule.ranks else [])]
    texts = [_FIGURES[f].text.format(value) for f in named if (value := getattr(result, f)) is not None]
    if rule.score is _radar_mean and results is not None:
        texts.insert(0, f"radar mean {_radar_mean(result, results):.3f}")
    return f"{result.name} ({', '.join(texts)})"


def _radar_mean(result: SimulatorResult, results: Results) -> float:
    mean = radar(results).mean(result.name)
    assert mean is not None  # the rule admits only simulators with all six figures
    return mean


def _highest(figure: str) -> Callable[[SimulatorResult, Results], float]:
    return lambda result, _: float(getattr(result, figure))


def _smallest(figure: str) -> Callable[[SimulatorResult, Results], float]:
    return lambda result, _: -float(getattr(result, figure))


def _everyone(results: Results) -> list[SimulatorResult]:
    return list(results)


def _all_zero(*figures: str) -> Callable[[Results], list[SimulatorResult]]:
    return lambda results: [r for r in results if not any(is_present(getattr(r, f)) for f in figures)]


def _large(figure: str) -> Callable[[Results], list[SimulatorResult]]:
    def narrow(results: Results) -> list[SimulatorResult]:
        largest = max(getattr(r, figure) for r in results)
        return [r for r in results if getattr(r, figure) * LARGE_FACTOR >= largest]

    return narrow


_LARGE_WORDS = (
    f"N_env^max within a factor {LARGE_FACTOR} of the largest ({{scene}}), then the highest throughput at N_env^max"
)

_RULES = (
    _Rule(
        "overall balance",
        "highest mean over the six radar axes, among simulators with all six",
        ("fps", "n_max", "memory_gb", "w1_real", "parallel", "run_to_run"),
        _everyone,
        _radar_mean,
    ),
    _Rule(
        "reproducible and fair comparison, repeated runs",
        "W1 between runs 0.00 cm and W1 between envs 0.00 cm, then the highest throughput",
        ("run_to_run", "parallel"),
        _all_zero("run_to_run", "parallel"),
        _highest("fps"),
        "fps",
    ),
    _Rule(
        "sim-to-real, contact-rich, tuning over repeated runs",
        "W1 between runs 0.00 cm, then the smallest W1 to real trials",
        ("run_to_run", "w1_real"),
        _all_zero("run_to_run"),
        _smallest("w1_real"),
    ),
    _Rule(
        "sim-to-real, contact-rich, single run",
        "smallest W1 to real trials",
        ("w1_real",),
        _everyone,
        _smallest("w1_real"),
    ),
    _Rule(
        "large parallelism with articulated robots",
        _LARGE_WORDS.format(scene="articulated robot"),
        ("n_max_articulated", "fps_articulated"),
        _large("n_max_articulated"),
        _highest("fps_articulated"),
    ),
    _Rule(
        "large parallelism with simple agents",
        _LARGE_WORDS.format(scene="simple bodies"),
        ("n_max", "fps"),
        _large("n_max"),
        _highest("fps"),
    ),
    _Rule(
        "memory-limited, modest parallelism",
        "smallest peak memory increment at N_env^max",
        ("memory_gb", "n_max"),
        _everyone,
        _smallest("memory_gb"),
    ),
)
