"""What the HTML page shows of sweeps: the curves of each scene, and the paper's points beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from evaluator.published import SCALING, AtLargest
from evaluator.report import words
from evaluator.report.figures import lines
from evaluator.report.figures.scaling import Curve, Foreign, scaling_chart
from evaluator.sweeps import Sweep

_DEVICE, _HOST = "memory_peak_increment", "host_memory_peak_increment"
_MEMORY = {_DEVICE: "device memory increment", _HOST: "host memory increment"}


@dataclass(frozen=True)
class Chart:
    """A figure with its words; `svg` is empty where there is nothing to draw."""

    title: str
    svg: Markup


@dataclass(frozen=True)
class SceneSweeps:
    """The sweeps of one scene, each with its swatch, and their figures."""

    scene: str
    sweeps: list[tuple[Markup, Sweep]]
    charts: list[Chart]


def scene_sweeps(sweeps: Sequence[Sweep]) -> Iterator[SceneSweeps]:
    """By scene, in order."""
    for scene in dict.fromkeys(s.key.scene for s in sweeps):
        of_scene = [s for s in sweeps if s.key.scene == scene]
        marked = [(Markup(lines.swatch(i)), s) for i, s in enumerate(of_scene)]
        yield SceneSweeps(scene, marked, [c for c in _charts(of_scene, {}) if c.svg])


def beside_published(sweeps: Sequence[Sweep]) -> Iterator[SceneSweeps]:
    """The paper's points at N_env^max, with the sweeps of the same scene where there are any."""
    for scene in ("free-fall", "franka"):
        of_scene = [s for s in sweeps if s.key.scene == scene]
        marked = [(Markup(lines.swatch(i)), s) for i, s in enumerate(of_scene)]
        points = {r.simulator: at for r in SCALING if (at := r.free_fall if scene == "free-fall" else r.franka)}
        yield SceneSweeps(scene, marked, [c for c in _charts(of_scene, points) if c.svg])


def _charts(sweeps: Sequence[Sweep], paper: dict[str, AtLargest]) -> Iterator[Chart]:
    speed = [Foreign(name, at.n_env_max, at.fps) for name, at in paper.items()]
    curves = [_curve(i, s, "fps") for i, s in enumerate(sweeps)]
    yield _chart("throughput", "throughput [env steps/s]", steps_label, curves, speed)
    for metric, said in _MEMORY.items():
        memory = [Foreign(name, at.n_env_max, at.memory_gb * 1e9) for name, at in paper.items()]
        curves = [_curve(i, s, metric) for i, s in enumerate(sweeps) if s.memory == metric]
        if metric == _DEVICE or not paper:
            yield _chart(said, said, words.size, curves, memory)


def _chart(title: str, value: str, tick: Callable[[float], str], curves: list[Curve], foreign: list[Foreign]) -> Chart:
    return Chart(title, Markup(scaling_chart(curves, value=value, tick=tick, foreign=foreign)))


def _curve(index: int, sweep: Sweep, name: str) -> Curve:
    found = [(p.n_env, p.result.metrics[name]) for p in sweep.points]
    points = tuple((float(n), m.value * words.BYTES.get(m.unit, 1.0)) for n, m in found if m.value)
    model = sweep.models.get(name)
    return Curve(
        index,
        sweep.label,
        points,
        model=model.at if model else None,
        n_max=sweep.n_max,
        failed=next((p.n_env for p in sweep.points if p.n_env > (sweep.n_max or 0) and not p.complete), None),
        ends=f"N_env^max {sweep.n_max}: {words.shortened(sweep.ends)}",
    )


def steps_label(value: float) -> str:
    """A number of steps or environments as a tick's label."""
    for scale, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= scale:
            return f"{value / scale:g}{letter}"
    return f"{value:g}"
