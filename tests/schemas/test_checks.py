"""Values out of a stranger's JSON: what is taken, at the very limits, and what is refused by name."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from typing import Any

import pytest

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording


def nested(depth: int) -> dict[str, Any]:
    """An object that holds so many lists within each other."""
    inner: Any = []
    for _ in range(depth - 1):
        inner = [inner]
    return {"a": inner} if depth else {}


@pytest.mark.parametrize(
    ("read", "taken", "refused"),
    [
        (lambda r: checks.text(r, "key"), ["", "a"], [1, None, ["a"]]),
        (lambda r: checks.whole(r, "key", -2, 3), [-2, 0, 3], [-3, 4, True, 1.0, "1", None]),
        (lambda r: checks.number(r, "key", -2.0, 3.0), [-2, 0.5, 3.0], [-2.001, 3.001, True, "1", None, math.nan]),
        (lambda r: checks.flag(r, "key"), [True, False], [0, 1, "true", None]),
        (lambda r: checks.mapping(r, "key"), [{}, {"a": 1}], [[], None, "a"]),
        (lambda r: checks.items(r, "key"), [[], [1, "a"]], [{}, None, "a"]),
        (lambda r: list(checks.texts(r, "key")), [[], ["a", ""]], ["a", ["a", 1]]),
        (lambda r: checks.text_map(r, "key"), [{}, {"a": "b"}], [[], {"a": 1}]),
        (lambda r: checks.objects(r, "key"), [[], [{}, {"a": 1}]], [{}, [1]]),
    ],
)
def test_kinds_and_limits(read: Callable[[dict[str, Any]], Any], taken: list[Any], refused: list[Any]) -> None:
    """Return a value of the right kind and size as it is, and name the key of any other."""
    for value in taken:
        assert read({"key": value}) == value
    for value in refused:
        with pytest.raises(DamagedRecording):
            read({"key": value})


def test_what_is_missing() -> None:
    """Take the default where there is one, what is empty of a collection, and refuse everything else."""
    assert checks.text({}, "key", default="d") == "d"
    assert checks.whole({}, "key", 0, 9, default=7) == 7
    assert (checks.flag({}, "key"), checks.mapping({}, "key"), checks.items({}, "key")) == (False, {}, [])
    for read in (lambda: checks.text({}, "key"), lambda: checks.whole({}, "key", 0, 9)):
        with pytest.raises(DamagedRecording, match="key is not"):
            read()


@pytest.mark.parametrize("value", [[1, 2.5, -3], [sys.float_info.max, 0, 0]])
def test_vectors(value: list[float]) -> None:
    """Return as many finite numbers as were asked for."""
    assert checks.vector(value, 3, "it") == tuple(map(float, value))


@pytest.mark.parametrize(
    "value", [[1, 2], [1, 2, 3, 4], (1, 2, 3), [1, 2, True], [1, 2, "3"], [1, 2, math.inf], [1, 2, math.nan], None]
)
def test_what_is_no_vector(value: Any) -> None:
    """Refuse other lengths and kinds, and numbers that are not finite."""
    with pytest.raises(DamagedRecording, match="it is not a list of 3 finite numbers"):
        checks.vector(value, 3, "it")


def test_huge_numbers_are_not_shown() -> None:
    """Say that a number is huge, in place of its digits, from thirty on."""
    with pytest.raises(DamagedRecording, match=": a huge number$"):
        checks.whole({"key": -(10**30)}, "key", 0, 9)
    with pytest.raises(DamagedRecording, match=": 999999"):
        checks.whole({"key": 10**30 - 1}, "key", 0, 9)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"a": NaN}', '{"a": Infinity}', "{}{}"])
def test_what_is_no_object(text: str) -> None:
    """Refuse what is not JSON, and JSON that is no object."""
    with pytest.raises(DamagedRecording, match=r"^name is not "):
        checks.load("name", text)


def test_how_deep_an_object_may_be() -> None:
    """Take lists and objects up to a depth, and refuse the next."""
    deepest = nested(checks.MAX_DEPTH - 1)
    assert checks.load("name", json.dumps(deepest)) == deepest
    with pytest.raises(DamagedRecording, match="more than 64 deep"):
        checks.load("name", json.dumps(nested(checks.MAX_DEPTH)))


@pytest.mark.parametrize("where", ["key", "value", "inside"])
def test_how_long_a_text_may_be(where: str) -> None:
    """Take texts and keys up to a length, and refuse one more character, wherever it is."""

    def document(length: int) -> str:
        text = "x" * length
        return json.dumps({"key": {text: 1}, "value": {"a": text}, "inside": {"a": [[text]]}}[where])

    checks.load("name", document(checks.MAX_JSON_TEXT))
    with pytest.raises(DamagedRecording, match="a text of 1048577 characters"):
        checks.load("name", document(checks.MAX_JSON_TEXT + 1))


def test_a_budget_is_for_all_documents_of_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add bytes and values of all documents, each once however often it is read; take as much as there may be."""
    monkeypatch.setattr(checks, "MAX_JSON_BYTES", 20)
    monkeypatch.setattr(checks, "MAX_JSON_VALUES", 7)
    budget = checks.Budget()
    for _ in range(3):
        assert checks.load("first", '{"a":[1,2]}', budget) == {"a": [1, 2]}  # 11 bytes, 4 marks at most
    assert checks.load("second", b'{"b":  1}', budget) == {"b": 1}  # 9 bytes, 2 marks at most
    with pytest.raises(DamagedRecording, match="third has 1 bytes; at most 20"):
        budget.take("third", "1")
    monkeypatch.setattr(checks, "MAX_JSON_BYTES", 100)
    budget = checks.Budget()
    budget.take("first", '{"a":[1,2]}')
    budget.take("second", b"[1,")
    with pytest.raises(DamagedRecording, match="third has 1 values; at most 7"):
        budget.take("third", "1")
