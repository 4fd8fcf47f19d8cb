"""Split tree: which samples left which others over simulated time, and below it how many are distinct."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gpusimbench.evaluator.metrics.identity import Branch, SplitTree
from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.svg import element, figure, number, text, title
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import in_ranges

_WIDTH = 480.0
_LEFT, _RIGHT, _TOP = 44.0, 150.0, 10.0
_SIDE = _WIDTH - _LEFT - _RIGHT
_ROW, _NARROW_ROW, _NARROW_FROM = 17.0, 12.0, 24
_COUNTS = 56.0  # height of the count below the tree
_NAMED = 4  # ranges of samples in a label

Scale = Callable[[float], float]


def tree_chart(tree: SplitTree, *, dt: float, of: str, names: Sequence[int], label: str) -> str:
    """The tree; empty where nothing ever left anything.

    dt     time step [s]
    of     what the samples are: "env" or "run"
    names  of the samples, as readers know them
    label  of the group, for the picture's label

    A branch is a line from where it left to the right edge; its samples stand there. The axis is that of the splits,
    with a margin on both sides: before and after them nothing happens.
    """
    if len(tree.branches) < 2:
        return ""
    begin, end = window(tree)
    height = _ROW if len(tree.branches) <= _NARROW_FROM else _NARROW_ROW
    rows = {at: _TOP + (i + 0.5) * height for i, at in enumerate(_order(tree))}
    floor = _TOP + height * len(rows) + 4
    bottom = floor + _COUNTS

    def x(step: float) -> float:
        return _LEFT + _SIDE * (min(max(step, begin), end) - begin) / (end - begin)

    drawn = [_branch(tree, at, branch, rows, x, dt, of, names) for at, branch in enumerate(tree.branches)]
    columns = [(t, x(t / dt)) for t in plot.ticks(begin * dt, end * dt, at_most=6)]
    return figure(
        _WIDTH,
        bottom + 40,
        f"Split tree of the {of}s of {label}: {len(tree.branches) + tree.not_kept} branches",
        *(element("line", x1=at, x2=at, y1=_TOP, y2=bottom, class_="faint") for _, at in columns),
        *drawn,
        *_counts(tree, x, floor + 6, bottom),
        plot.frame(_LEFT, _TOP, _SIDE, bottom - _TOP),
        *(plot.bottom(at, bottom, plot.tick_label(t)) for t, at in columns),
        text("simulated time [s]", _LEFT + _SIDE / 2, bottom + 32, class_="mid"),
    )


def window(tree: SplitTree) -> tuple[float, float]:
    """The steps between which the tree is drawn."""
    first, last = tree.branches[1].step, tree.branches[-1].step
    margin = max(1.0, 0.15 * (last - first))
    return max(first - margin, tree.first_step), min(max(last + margin, first + 1.0), max(tree.last_step, first + 1))


def members(branch: Branch, of: str, names: Sequence[int]) -> str:
    """The samples that stayed in a branch, by name: "7 envs: 0, 3-8", the first few of many."""
    shown = in_ranges([names[m] for m in branch.members], at_most=_NAMED)
    if branch.stayed == 1:
        return f"{of} {shown}"
    more = "" if len(branch.members) == branch.stayed or shown.endswith("...") else ", ..."
    return f"{branch.stayed} {of}s: {shown}{more}"


def _order(tree: SplitTree) -> list[int]:
    """Branches from top to bottom: below each the branches that left it, the latest nearest, so that no lines cross."""
    children = gathered((branch.parent, at) for at, branch in enumerate(tree.branches) if branch.parent is not None)
    order, waiting = [], [0]
    while waiting:
        at = waiting.pop()
        order.append(at)
        # what left at one step stands in order of its samples
        waiting += sorted(
            children.get(at, []), key=lambda child: (tree.branches[child].step, -tree.branches[child].sample)
        )
    return order


def _branch(
    tree: SplitTree, at: int, branch: Branch, rows: dict[int, float], x: Scale, dt: float, of: str, names: Sequence[int]
) -> str:
    y, start = rows[at], x(branch.step)
    data = f"M{number(start)} {number(y)}H{number(_LEFT + _SIDE)}"
    said = f"{members(branch, of, names)}; all recorded steps"
    if branch.parent is not None:
        data = f"M{number(start)} {number(rows[branch.parent])}V{number(y)}H{number(_LEFT + _SIDE)}"
        who = f"{of} {names[tree.branches[branch.parent].sample]}"
        said = (
            f"{branch.left} left {who} at step {branch.step} ({branch.step * dt:g} s); {branch.stayed} stayed together"
        )
    shown = element("path", title(said), d=data, class_="g0 branch")
    small = "small" if len(rows) > _NARROW_FROM else ""
    return shown + text(members(branch, of, names), _LEFT + _SIDE + 6, y + 4, class_=small)


def _counts(tree: SplitTree, x: Scale, top: float, bottom: float) -> list[str]:
    """How many samples are distinct by their histories, as a staircase."""
    most = len(tree.branches)
    steps = [b.step for b in tree.branches[1:]]

    def y(count: int) -> float:
        return bottom - 6 - (bottom - top - 10) * (count - 1) / (most - 1)

    data = f"M{number(_LEFT)} {number(y(1))}"
    for count, step in enumerate(steps, start=2):
        data += f"H{number(x(step))}V{number(y(count))}"
    return [
        element("line", x1=_LEFT, x2=_LEFT + _SIDE, y1=top - 4, y2=top - 4, class_="axis"),
        element("path", d=f"{data}H{number(_LEFT + _SIDE)}", class_="g1 branch"),
        plot.left(_LEFT, y(1), "1"),
        plot.left(_LEFT, y(most), str(most)),
        text("distinct so far", _LEFT + _SIDE + 6, (top + bottom) / 2 + 4, class_="small"),
    ]
