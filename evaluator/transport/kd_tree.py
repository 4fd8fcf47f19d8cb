"""A kd-tree over priced points, which finds the best of distance plus price.

Plain boxes with a least price are no use here: where one cloud is shifted against the other, prices fall about as fast
as distances grow, and every box on the way looks as good as any other. So each node holds a plane below its prices.
With it the bound of a node is off by the square of its size, not by its size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.transport.compiled import compiled

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]

LEAF = 8
"""Points of a leaf, at most."""

DEPTH = 64
"""Room for the search's stack: more levels than 2^31 points need."""

_TINY = 1e-300
_RIDGE = 1e-3
"""Of the plane's fit, relative: points of a leaf may lie on a line."""

# Columns of a node. The plane below its prices is C + GX (x - CX) + GY (y - CY).
CX, CY = 0, 1  # centre of the bounding box
HX, HY = 2, 3  # its half widths
GX, GY = 4, 5  # slope of the plane
C = 6  # height of the plane at the centre
LIFT = 7  # what to add to C, for a bound on the height of the parent's plane
COLUMNS = 8


@dataclass(frozen=True)
class Tree:
    """A complete binary tree; node k has the children 2k+1 and 2k+2.

    order     numbers of the points in the tree's order, shape [n]
    points    the points in that order, shape [n, 2]
    begin     first point of each node, shape [n_node]
    end       one past its last
    nodes     boxes and planes of the nodes, shape [n_node, COLUMNS]
    leaf      leaf of each point, shape [n]
    first     number of the first leaf
    """

    order: npt.NDArray[np.intp]
    points: Floats
    begin: Integers
    end: Integers
    nodes: Floats
    leaf: Integers
    first: int


def build(points: Floats) -> Tree:
    """The tree of points [n, 2], n >= 1, split at medians of the wider side; its planes are not set yet.

    Points that are equal stay in their order, so that the tree depends on nothing but the points.
    """
    n = len(points)
    depth = max(0, int(np.ceil(np.log2(n / LEAF))))
    order, bounds = np.arange(n), np.array([0, n])
    levels = [bounds]
    for _ in range(depth):
        placed, begin = points[order], bounds[:-1]
        extent = np.maximum.reduceat(placed, begin) - np.minimum.reduceat(placed, begin)
        node = np.repeat(np.arange(len(begin)), np.diff(bounds))
        along = placed[np.arange(n), np.argmax(extent, axis=1)[node]]
        order = order[np.lexsort((along, node))]
        halves = np.empty(2 * len(begin) + 1, dtype=bounds.dtype)
        halves[::2], halves[1::2] = bounds, (bounds[:-1] + bounds[1:]) // 2
        bounds = halves
        levels.append(bounds)
    first = 2**depth - 1
    tree = Tree(
        order,
        np.ascontiguousarray(points[order]),
        np.concatenate([level[:-1] for level in levels]).astype(np.int32),
        np.concatenate([level[1:] for level in levels]).astype(np.int32),
        np.empty((2 * first + 1, COLUMNS)),
        np.repeat(np.arange(first, 2 * first + 1, dtype=np.int32), np.diff(bounds)),
        first,
    )
    set_boxes(tree.points, tree.begin, tree.end, tree.nodes)
    return tree


@compiled
def set_boxes(points: Floats, begin: Integers, end: Integers, nodes: Floats) -> None:
    """Write the bounding box of each node."""
    for k in range(len(begin)):
        x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
        for j in range(begin[k], end[k]):
            x0, x1 = min(x0, points[j, 0]), max(x1, points[j, 0])
            y0, y1 = min(y0, points[j, 1]), max(y1, points[j, 1])
        x, y = x0 + 0.5 * (x1 - x0), y0 + 0.5 * (y1 - y0)
        nodes[k, CX], nodes[k, CY] = x, y
        nodes[k, HX], nodes[k, HY] = max(x1 - x, x - x0), max(y1 - y, y - y0)


@compiled
def set_planes(points: Floats, prices: Floats, begin: Integers, end: Integers, nodes: Floats) -> None:
    """Lay a plane below the prices of each node: the slope by least squares, at most 1, the height exactly."""
    for k in range(len(begin)):
        cx, cy, n = nodes[k, CX], nodes[k, CY], end[k] - begin[k]
        sx, sy, sp, xx, xy, yy, xp, yp = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(begin[k], end[k]):
            x, y, p = points[j, 0] - cx, points[j, 1] - cy, prices[j]
            sx += x
            sy += y
            sp += p
            xx += x * x
            xy += x * y
            yy += y * y
            xp += x * p
            yp += y * p
        xx, xy, yy = xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n
        xp, yp = xp - sx * sp / n, yp - sy * sp / n
        ridge = _RIDGE * (xx + yy)
        xx, yy = xx + ridge, yy + ridge
        determinant = xx * yy - xy * xy
        gx, gy = 0.0, 0.0
        if determinant > _TINY:
            gx, gy = (yy * xp - xy * yp) / determinant, (xx * yp - xy * xp) / determinant
            steep = np.sqrt(gx * gx + gy * gy)
            if steep > 1.0:  # distances have a slope of 1, so prices need none above it
                gx, gy = gx / steep, gy / steep
        nodes[k, GX], nodes[k, GY] = gx, gy
        nodes[k, C] = _height(k, points, prices, begin, end, nodes)
        if k > 0:
            up = (k - 1) // 2
            ux, uy = nodes[up, GX], nodes[up, GY]
            lift = -ux * (cx - nodes[up, CX]) - uy * (cy - nodes[up, CY])
            nodes[k, LIFT] = lift - abs(gx - ux) * nodes[k, HX] - abs(gy - uy) * nodes[k, HY]


@compiled
def _height(k: int, points: Floats, prices: Floats, begin: Integers, end: Integers, nodes: Floats) -> float:
    """The greatest height at which the node's plane is below all its prices."""
    height = np.inf
    for j in range(begin[k], end[k]):
        rise = nodes[k, GX] * (points[j, 0] - nodes[k, CX]) + nodes[k, GY] * (points[j, 1] - nodes[k, CY])
        height = min(height, prices[j] - rise)
    return height


@compiled
def lift_planes(
    j: int, points: Floats, prices: Floats, begin: Integers, end: Integers, nodes: Floats, leaf: Integers
) -> None:
    """Raise the planes above point j, whose price has risen; planes never fall."""
    k = leaf[j]
    height = _height(k, points, prices, begin, end, nodes)
    while height > nodes[k, C]:
        nodes[k, C] = height
        if k == 0:
            break
        k = (k - 1) // 2
        left, right = 2 * k + 1, 2 * k + 2
        height = min(nodes[left, C] + nodes[left, LIFT], nodes[right, C] + nodes[right, LIFT])


@compiled
def _bound(k: int, x: float, y: float, nodes: Floats) -> float:
    """A lower bound on distance plus price in node k, seen from (x, y).

    For any unit vector s, |q - x| >= s . (q - x). With s towards the centre, distance plus plane is linear in q, and
    least in a corner of the box.
    """
    dx, dy = nodes[k, CX] - x, nodes[k, CY] - y
    r = np.sqrt(dx * dx + dy * dy)
    s = 1.0 / (r + _TINY)
    lower: float = r + nodes[k, C]
    lower -= abs(dx * s + nodes[k, GX]) * nodes[k, HX] + abs(dy * s + nodes[k, GY]) * nodes[k, HY]
    return lower


@compiled
def search(
    x: float, y: float, guess: int, slack: float, points: Floats, prices: Floats, begin: Integers, end: Integers,
    nodes: Floats, first: int, stack: Integers, bounds: Floats,
) -> tuple[int, float, float]:  # fmt: skip
    """The point of least distance plus price from (x, y), to within `slack`.

    Args:
        x, y: where from.
        guess: a point to begin with; -1 for none.
        slack: by how much a better point may be missed, >= 0.
        points, prices, begin, end, nodes, first: of the tree, planes set.
        stack, bounds: scratch, each of shape [DEPTH].

    Returns:
        The point, its distance plus price, and a lower bound on that of all other points (inf where there are none).
    """
    best, least, other, passed = -1, np.inf, np.inf, np.inf
    if guess >= 0:
        dx, dy = x - points[guess, 0], y - points[guess, 1]
        best, least = guess, np.sqrt(dx * dx + dy * dy) + prices[guess]
    stack[0], bounds[0] = 0, _bound(0, x, y, nodes)
    top = 1
    while top > 0:
        top -= 1
        k, bound = stack[top], bounds[top]
        cut = min(least - slack, other)
        while bound < cut and k < first:
            near, far = 2 * k + 1, 2 * k + 2
            bound, beyond = _bound(near, x, y, nodes), _bound(far, x, y, nodes)
            if beyond < bound:
                near, far, bound, beyond = far, near, beyond, bound
            if beyond < cut:
                stack[top], bounds[top] = far, beyond
                top += 1
            else:
                passed = min(passed, beyond)
            k = near
        if bound >= cut:
            passed = min(passed, bound)
            continue
        for j in range(begin[k], end[k]):
            dx, dy = x - points[j, 0], y - points[j, 1]
            value = np.sqrt(dx * dx + dy * dy) + prices[j]
            if value < other and j != best:
                if value < least:
                    best, least, other = j, value, least
                else:
                    other = value
    return best, least, min(other, passed)
