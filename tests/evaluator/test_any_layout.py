"""Random groups, fields, names and units: every command ends with a documented exit code and says what is true."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, note, settings
from hypothesis import strategies as st

from gpusimbench.schemas.fields import BODY_FIELDS, FIELD_KINDS, StateField, body_field, joint_field
from tests.conftest import call
from tests.layouts import Layout, states, write

_DTYPES = st.sampled_from(["float32", "float64"])
_NAMES = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12)
_ITEMS = st.lists(_NAMES, min_size=1, max_size=4, unique=True).map(tuple)
_GROUP = st.from_regex(r"[a-z0-9_]{1,10}", fullmatch=True).filter(lambda name: name != "view")
_UNITS = st.sampled_from(["m", "rad", "m/s", "deg", "", "%", "N m"])


@st.composite
def _bodies(draw: st.DrawFn, group: str) -> list[StateField]:
    items, dtype = draw(_ITEMS), draw(_DTYPES)
    named = draw(st.lists(st.sampled_from(BODY_FIELDS), min_size=1, unique=True))
    return [body_field(group, name, dtype, items) for name in named]


@st.composite
def _joints(draw: st.DrawFn, group: str) -> list[StateField]:
    items, dtype = draw(_ITEMS), draw(_DTYPES)
    slides = draw(st.sets(st.sampled_from(items)))
    return [
        joint_field(group, name, dtype, items, slides=slides)
        for name in draw(st.sampled_from([("qpos",), ("qpos", "qvel")]))
    ]


@st.composite
def _odd(draw: st.DrawFn, group: str) -> list[StateField]:
    """A field of any name that is no part of the format, with any unit, unit per item, frame and components."""
    items = draw(_ITEMS)
    units = tuple(draw(_UNITS) for _ in items)
    name = draw(st.from_regex(r"[a-z0-9_]{1,10}", fullmatch=True).filter(lambda name: name not in FIELD_KINDS))
    components = draw(st.lists(_NAMES, min_size=1, max_size=4, unique=True).map(tuple))
    field = StateField(group, name, draw(_DTYPES), items, components, draw(_UNITS), draw(_NAMES))
    return [replace(field, item_units=units)] if draw(st.booleans()) else [field]


@st.composite
def _layouts(draw: st.DrawFn) -> Layout:
    groups = draw(st.lists(_GROUP, min_size=1, max_size=3, unique=True))
    fields = tuple(f for group in groups for f in draw(st.one_of(_bodies(group), _joints(group), _odd(group))))
    return Layout(
        draw(_NAMES), fields, n_env=draw(st.integers(1, 3)), steps=draw(st.integers(1, 4)),
        noise=draw(st.sampled_from([0.0, 1e-3])),
    )  # fmt: skip


def _same(layout: Layout, one: int, other: int) -> bool:
    pairs = zip(states(layout, one), states(layout, other), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def _run(*command: Any, codes: tuple[int, ...]) -> Any:
    done = call(*command)
    note(f"{command[0]}: {done.returncode}: {done.stdout[-300:]}{done.stderr[-300:]}")
    assert done.returncode in codes, command
    assert "Traceback" not in done.stderr
    shown = done.stdout + done.stderr
    assert not any(mark in shown for mark in "\x1b\x00\x07\u202e")
    return done


@pytest.mark.slow
@settings(max_examples=25)
@given(_layouts())
def test_all_commands_on_any_layout(layout: Layout) -> None:
    """Check, show, evaluate, compare and draw; hold what is said against what was written."""
    positions = any(field.field == "position" for field in layout.fields)
    qpos = {unit for field in layout.fields if field.field == "qpos" for unit in field.units}
    alike = _same(layout, 0, 1)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        a, b, c, d = (write(folder, layout, run) for run in range(4))
        checked = _run("gsb-check", a, codes=(0,))
        assert checked.stdout.startswith("PASSED")
        shown = _run("gsb-info", a, "--all", codes=(0,)).stdout
        assert all(field.name in shown for field in layout.fields)
        done = _run("gsb-eval", a, b, "--json", "-", "--no-cache", codes=(0,))
        (group,) = json.loads(done.stdout)["groups"]
        metrics = group["metrics"]
        assert metrics["distinct_runs"]["value"] == (1 if alike else 2)
        for name, metric in metrics.items():
            assert (metric["value"] is None) == bool(metric.get("value_missing")), name
        if not positions:
            assert 'needs a group with the field "position"' in metrics["w1_run_to_run"]["value_missing"]
        assert (metrics["joint_slide_run_to_run"]["value"] is not None) == ("m" in qpos)
        if "rad" in qpos:
            assert metrics["joint_angle_run_to_run"]["value"] is not None
        if alike:
            assert {metrics[n]["value"] for n in metrics if n.endswith("_run_to_run")} <= {None, 0.0}
        _run("gsb-eval", a, b, "--all", "--html", folder / "report", "--no-cache", codes=(0,))
        said = _run("gsb-diff", a, b, "--all", codes=(0,) if alike else (4,)).stdout
        assert ("differ from step" in said) != alike
        _run("gsb-diff", a, codes=(0, 4) if layout.n_env > 1 else (5,))
        compared = _run("gsb-compare", "--base", a, b, "--head", c, d, "--json", "-", "--no-cache", codes=(0, 4, 5))
        findings = {f["name"]: f for one in json.loads(compared.stdout)["compared"] for f in one["findings"]}
        assert ("outcome_joint_slides" in findings) == ("m" in qpos)
        drawn = _run("gsb-view", a, "--no-open", "--out", folder / "view.html", codes=(0,) if positions else (5,))
        assert positions or "no place follows" in drawn.stderr
