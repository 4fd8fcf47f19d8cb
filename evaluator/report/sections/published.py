"""The paper's figures, marked as the paper's."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.render.document import EMPTY, Block, Cell, Gallery, Section, Text, Tone, table
from gpusimbench.evaluator.report.scaling import beside_published
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results import published
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.group_metrics import W1_PARALLEL, W1_REAL, W1_RUN_TO_RUN
from gpusimbench.evaluator.results.published import AtLargest

_NOT_OURS = (
    f"These are the paper's figures, not results of this report. Source: {published.SOURCE}; its authors' machine: "
    f"{published.MACHINE}. Speed and memory of another machine do not compare with those of this report; types and "
    "distances hold for the versions and switches of that time."
)


def section(source: Source) -> Section | None:
    """None where they were not asked for."""
    if not source.published:
        return None
    distances = (metric.titled for metric in (W1_REAL, W1_PARALLEL, W1_RUN_TO_RUN))
    blocks: list[Block] = [
        Text(_NOT_OURS, Tone.WARNING),
        table(
            "published-variability",
            f"Variability as published: inclined-collision, 16 envs, 10 runs. {published.SOURCE}",
            ["simulator", "version", *distances, "type"],
            [
                (r.simulator, published.SIMULATOR_VERSIONS[r.simulator], str(r.w1_real), str(r.parallel),
                 str(r.run_to_run), str(r.regime))
                for r in published.VARIABILITY
            ],
        ),
        *_beside(source),
        table(
            "published-scaling",
            f"Throughput and memory as published, at the largest number of envs sustained. {published.SOURCE}",
            ["simulator", *(f"{scene}: {what}" for scene in ("free-fall", "franka") for what in
                            ("N_env^max", FPS.titled, "memory [GB]"))],
            [(r.simulator, *_at(r.free_fall), *_at(r.franka)) for r in published.SCALING],
        ),
    ]  # fmt: skip
    return Section("published", "Figures of the paper", tuple(blocks), "not results of this report", folded=True)


def _at(found: AtLargest | None) -> tuple[Cell, Cell, Cell]:
    if found is None:
        return Cell("not supported", tone=Tone.QUIET), EMPTY, EMPTY
    return (
        Cell(f"{found.n_env_max:,}", float(found.n_env_max)),
        Cell(f"{found.fps:,.0f}", found.fps),
        Cell(f"{found.memory_gb:.1f}", found.memory_gb),
    )


def _beside(source: Source) -> Iterator[Block]:
    for scene in beside_published(source.evaluation.sweeps):
        ours = ", ".join(f"{sweep.label} on {sweep.key.device or 'no device'}" for _, sweep in scene.sweeps)
        said = f"curves: this report's, {ours}" if ours else "this report has no sweep of this scene"
        drawn = Gallery(tuple(scene.charts), 28)
        legend = Text(f"Diamonds with names: the paper's, on its machine, at N_env^max; {said}.", Tone.QUIET)
        key = f"published-{scene.scene}"
        yield Section(key, f"{scene.scene}: the paper's figures beside these sweeps", (drawn, legend))
