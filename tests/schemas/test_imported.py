"""What an engine made of a model, and how it moved, as attachments: read back as written, or refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas import arrays
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.imported import KINDS, PARAMETERS, Drop, Imported, Trials

_TEXTS = st.text(st.characters(exclude_characters="\0\t", codec="utf-8"), max_size=5)  # NumPy cuts zeros at the end


@st.composite
def _imported(draw: st.DrawFn) -> Imported:
    kinds = draw(st.lists(st.sampled_from(list(KINDS)), unique=True))
    names = {kind: tuple(draw(st.lists(_TEXTS, unique=True, max_size=3))) for kind in KINDS if kind in kinds}
    values: dict[str, Any] = {}
    for parameter in draw(st.lists(st.sampled_from(PARAMETERS), unique=True)):
        if parameter.kind not in names:
            continue
        shape = len(names[parameter.kind]), draw(st.integers(1, 3))
        cells = _TEXTS if parameter.unit == "name" else st.floats(allow_nan=False)
        drawn = draw(st.lists(cells, min_size=shape[0] * shape[1], max_size=shape[0] * shape[1]))
        values[parameter.key] = np.array(drawn, dtype=np.str_ if parameter.unit == "name" else np.float64).reshape(
            shape
        )
    return Imported(names, values, draw(st.dictionaries(_TEXTS, _TEXTS, max_size=3)))


@given(_imported())
def test_parameters_come_back(made: Imported) -> None:
    """Read back names, values and reasons, whichever kinds and parameters there are."""
    found = Imported.decoded(made.encoded())
    assert (found.names, found.unread) == (made.names, made.unread)
    assert found.values.keys() == made.values.keys()
    for key, array in made.values.items():
        assert found.values[key].shape == array.shape
        assert found.values[key].tolist() == array.tolist()


def _some() -> dict[str, Any]:
    return {
        "joints/names": np.array(["a", "b"]),
        "joints/type": np.array([["hinge"], ["slide"]]),
        "joints/range": np.array([[-1.0, 1.0], [-np.inf, np.inf]]),
        "unread": np.array(["joints/axis\twhy"]),
    }


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("joints/names", np.array([["a", "b"]]), "joints/names is no list of names"),
        ("joints/names", np.array([1, 2]), "joints/names is no list of names"),
        ("joints/names", np.array(["a", "a"]), "two joints have one name"),
        ("joints/names", np.array(["a"]), "joints/type has the shape"),
        ("joints/names", None, "joints/type has the shape"),
        ("joints/range", np.array([-1.0, 1.0]), "joints/range has the shape"),
        ("joints/range", np.zeros((2, 0)), "joints/range has the shape"),
        ("joints/range", np.array([["x"], ["y"]]), "joints/range is of type"),
        ("joints/type", np.zeros((2, 1)), "joints/type is of type"),
        ("unread", np.zeros((2, 1)), "unread is no list of texts"),
        ("unread", np.array([1.0]), "unread is no list of texts"),
    ],
)
def test_parameters_that_cannot_be(key: str, value: Any, said: str) -> None:
    """Refuse arrays that do not fit their names, are of another type, and names that are there twice."""
    assert Imported.decoded(arrays.encode(_some())).names == {"joints": ("a", "b")}
    changed = {name: array for name, array in (_some() | {key: value}).items() if array is not None}
    with pytest.raises(DamagedRecording, match=said):
        Imported.decoded(arrays.encode(changed))


def _trials() -> dict[str, Any]:
    # three poses, two links, four trials of five steps, a joint
    return {
        "links": np.array(["a", "b"]),
        "given/joints/qpos": np.ones((3, 1, 1)),
        "position": np.full((3, 2, 3), 2.0),
        "orientation": np.full((3, 2, 4), 3.0),
        "start/joints/qpos": np.full((1, 1), 4.0),
        "kinds": np.array(["rest", "joint", "joint", "actuator"]),
        "targets": np.array(["", "a", "b", "m"]),
        "velocity/joints/qvel": np.full((5, 4, 1, 1), np.nan),
        "contacts": np.arange(-1, 3),
    }


def test_trials_come_back() -> None:
    """Read back every array, and numbers that are none."""
    told = _trials()
    found = Trials.decoded(Trials.decoded(arrays.encode(told)).encoded())
    assert (found.links, found.kinds, found.targets) == tuple(tuple(told[k]) for k in ("links", "kinds", "targets"))
    for array, key in (
        (found.given["joints/qpos"], "given/joints/qpos"),
        (found.position, "position"),
        (found.orientation, "orientation"),
        (found.start["joints/qpos"], "start/joints/qpos"),
        (found.velocity["joints/qvel"], "velocity/joints/qvel"),
        (found.contacts, "contacts"),
    ):
        assert np.array_equal(array, told[key], equal_nan=True)
    assert found.contacts.dtype == np.int64
    empty = {**told, "velocity/joints/qvel": np.zeros((2, 4, 1, 1))}  # a step, and the row before it
    assert len(Trials.decoded(arrays.encode(empty)).velocity["joints/qvel"]) == 2


@pytest.mark.parametrize(
    ("key", "change"),
    [
        *((key, lambda a: None) for key in ("links", "position", "orientation", "kinds", "targets", "contacts")),
        *((key, lambda a: a[:-1]) for key in ("links", "position", "orientation", "kinds", "targets", "contacts")),
        *((key, lambda a: a[..., None]) for key in _trials()),
        ("given/joints/qpos", lambda a: a[:-1]),
        ("velocity/joints/qvel", lambda a: a[:, :-1]),
        ("velocity/joints/qvel", lambda a: a[:1]),
        ("velocity/joints/other", lambda _: np.zeros((4, 4, 1, 1))),
        ("position", lambda a: a[..., :2]),
        ("orientation", lambda a: a[..., :3]),
        ("contacts", lambda _: np.array([0.0, 1.0, np.inf, 2.0])),
        ("contacts", lambda _: np.array(["0", "1", "2", "3"])),
        ("targets", lambda _: np.arange(4)),
    ],
)  # fmt: skip
def test_trials_that_cannot_be(key: str, change: Callable[[Any], Any]) -> None:
    """Refuse an array that is missing, of other axes, of another length than what it belongs to, or of another type."""
    told = _trials()
    changed = change(told.pop(key, None))
    with pytest.raises(DamagedRecording, match=r"^import-trials\.npz"):
        Trials.decoded(arrays.encode(told if changed is None else {**told, key: changed}))


def _drop() -> dict[str, Any]:
    return {
        "time": np.array([0, 0.1, 0.2]),
        "contact": np.array([0, 0, 1]),
        "height": np.array([1, 0.9, np.nan]),
        "momentum": np.array([0, -1, -2.0]),
        "weight": np.array(9.81),
    }


def test_a_drop_comes_back() -> None:
    """Read back every array, and heights that are no numbers."""
    found = Drop.decoded(Drop.decoded(arrays.encode(_drop())).encoded())
    assert found.contact.tolist() == [False, False, True]
    for name in ("time", "height", "momentum", "weight"):
        assert np.array_equal(getattr(found, name), _drop()[name], equal_nan=True)


@pytest.mark.parametrize(
    ("key", "change"),
    [
        *((key, lambda a: None) for key in _drop()),
        *((key, lambda a: a[..., None]) for key in _drop()),
        *((key, lambda a: a[:-1]) for key in ("time", "contact", "height", "momentum")),
        ("time", lambda a: a[::-1]),
        ("time", lambda a: np.array([0, 1, np.inf])),
        ("weight", lambda a: -a),
        ("weight", lambda _: np.array(np.nan)),
        ("contact", lambda _: np.array(["0", "0", "1"])),
    ],
)
def test_a_drop_that_cannot_be(key: str, change: Callable[[Any], Any]) -> None:
    """Refuse an array that is missing, of other axes or length, or times and weights that cannot be."""
    told = _drop()
    changed = change(told.pop(key))
    with pytest.raises(DamagedRecording, match=r"^import-drop\.npz"):
        Drop.decoded(arrays.encode(told if changed is None else {**told, key: changed}))
