"""The player and the geometry of a model: links where their joints have them, every kind of shape in the picture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import RecordingWriter
from gpusimbench.evaluator.player.encode import box_of, facets_of
from gpusimbench.evaluator.player.poses import items_of, surroundings
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.figures.palette import GROUPS_LIGHT
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.fields import joint_field
from gpusimbench.schemas.view.geometry import GEOMETRY, Mesh, Shape
from tests.browser import Browser, needs_chromium
from tests.conftest import call
from tests.evaluator.test_player_page import PAINTED, pixels, text, written

_CUBE = [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
_SIDES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
          [1, 5, 7], [1, 7, 3]]  # fmt: skip
_SHAPES: dict[str, dict[str, Any]] = {
    "box": {"kind": "box", "size": [1, 1, 1]},
    "cylinder": {"kind": "cylinder", "radius": 0.5, "length": 1},
    "ellipsoid": {"kind": "ellipsoid", "size": [1, 1, 1]},
    "sphere": {"kind": "sphere", "radius": 0.5},
    "capsule": {"kind": "capsule", "radius": 0.25, "length": 0.5},
    "mesh": {"kind": "mesh", "mesh": 0},
}


def pendulum(folder: Path, shape: dict[str, Any], **more: Any) -> Path:
    """A recording of a program that attaches the geometry of a pendulum, which turns by a quarter about y."""
    joint = {"kind": "hinge", "group": "joints", "name": "turn", "axis": [0, 1, 0], "reference": 0}
    bodies = [
        {"name": "world"},
        {"name": "arm", "parent": 0, "position": [0, 0, 2], "joints": [joint]},
        {"name": "tip", "parent": 1, "position": [0, 0, -1], "shapes": [{"shape": shape}]},
    ]
    mesh = {"points": np.ravel(_CUBE).tolist(), "triangles": np.ravel(_SIDES).tolist()}
    record = {"bodies": bodies, "meshes": [mesh], "simplified": ["the tip is drawn as it never was"], **more}
    folder.mkdir(exist_ok=True)
    with RecordingWriter(
        folder / "pendulum.mcap", simulator="own", version="1", scene="pendulum", n_env=1, steps=1, dt=0.1,
        fields=[joint_field("joints", "qpos", "float64", ("turn",))],
        attachments={GEOMETRY: ("application/json", json.dumps(record).encode())},
    ) as writer:  # fmt: skip
        writer.append(np.zeros((1, 1, 1)))
        writer.append(np.full((1, 1, 1), np.pi / 2))
    return folder / "pendulum.mcap"


def test_links_are_where_their_joints_have_them(tmp_path: Path) -> None:
    """Turn the tip about the arm's hinge, and draw no dot for the arm, which is known to have no shape."""
    recording = Recording(pendulum(tmp_path, _SHAPES["box"]))
    items = items_of(recording, 0, [range(2)])
    assert items.bodies == (("robot", "arm"), ("robot", "tip"))
    np.testing.assert_allclose(items.position[:, 1], [[0, 0, 1], [-1, 0, 2]], atol=1e-12)
    assert [len(shapes) for shapes in surroundings(recording).bodies.values()] == [0, 1]
    done = call("gsb-view", recording.path, "--no-open", "--out", tmp_path / "view.html", code=0)
    assert "The tip is drawn as it never was" in done.stderr


def test_a_damaged_geometry(tmp_path: Path) -> None:
    """Say what is wrong with it, and keep what states and clocks say."""
    path = pendulum(tmp_path, {"kind": "mesh", "mesh": 7})
    done = call("gsb-check", path, code=ExitCode.DATA_LOST)
    assert "mesh is not a whole number from 0 to 0" in done.stdout
    assert len(Recording(path).state("joints", "qpos")) == 2


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Shape("cylinder", (0.5, 2.0)), np.pi / 2),
        (Shape("ellipsoid", (1.0, 2.0, 3.0)), np.pi),
        (Shape("mesh", (1.0, 1.0, 1.0), mesh=Mesh(np.array(_CUBE), np.array(_SIDES))), 1.0),
    ],
)
def test_faces_look_outward(shape: Shape, volume: float) -> None:
    """Close the surface of a shape by faces that enclose its volume, but for the corners of what is round."""
    found = facets_of(shape)
    points = np.array(found[0])
    enclosed = sum(
        points[a] @ np.cross(points[b], points[c]) / 6
        for a, *others in found[1]
        for b, c in zip(others, others[1:], strict=False)
    )
    assert 0.93 * volume < enclosed <= volume * (1 + 1e-9)
    np.testing.assert_allclose(np.ptp(points, axis=0), box_of(shape), rtol=0.02)


@needs_chromium
def test_every_shape_is_in_the_picture(browser: Browser, tmp_path: Path) -> None:
    """Draw each kind of shape as large as it is: a mesh of a cube like the box, an ellipsoid like the ball."""
    seen = {}
    for name, shape in _SHAPES.items():
        browser.open(written(tmp_path, [Recording(pendulum(tmp_path / name, shape))]))
        browser.evaluate(PAINTED)
        seen[name] = pixels(browser, GROUPS_LIGHT[0])
        assert browser.errors == []
        assert text(browser, ".outside") == ""  # the arm has no shape, and is not outside
    assert min(seen.values()) > 5000, seen
    assert seen["mesh"] == pytest.approx(seen["box"], rel=0.1)
    assert seen["ellipsoid"] == pytest.approx(seen["sphere"], rel=0.1)
