"""What is asked of a run beside its configuration, as texts."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from gpusimbench.schemas.initial import Given, Initial, drawn, initial_words, parse_initial
from gpusimbench.schemas.treatment import Intervention, Keep, Vary, snapshot_name

SHA = "0123456789abcdef" * 4


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [
        (parse_initial, "random:0.5", Initial(0.5)),
        (parse_initial, "random:3.0", Initial(3.0)),
        (parse_initial, "random:0.5,shift:7", Initial(0.5, shift=7)),
        (parse_initial, "random:0.5,but:0", Initial(0.5, but=0)),
        (parse_initial, "random:0.5,but:3", Initial(0.5, but=3)),
        (parse_initial, "random:0.5,mirror:y", Initial(0.5, mirror="y")),
        (parse_initial, "random:0.5,mirror:xy", Initial(0.5, mirror="xy")),
        (parse_initial, "random:0.5,relabel:reverse", Initial(0.5, relabel="reverse")),
        (parse_initial, f"states:{SHA}", Given(SHA)),
        (parse_initial, f"snapshot:0:{SHA}", Given(SHA, 0)),
        (parse_initial, f"snapshot:12:{SHA}", Given(SHA, 12)),
        (Intervention.parse, "reset@0", Intervention("reset", 0)),
        (Intervention.parse, "poison@20", Intervention("poison", 20)),
        (Intervention.parse, "excursion@20+5", Intervention("excursion", 20, 5)),
        (Keep.parse, "failing", Keep()),
        (Keep.parse, "failing,within:2.5", Keep(2.5)),
        (Keep.parse, "failing,within:1000000000.0", Keep(1e9)),
    ],
)
def test_texts_and_what_they_mean(parse: Callable[[str], object], text: str, value: object) -> None:
    """Read a text, and write the same."""
    assert parse(text) == value
    assert str(value) == text


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (parse_initial, ""), (parse_initial, "random:"), (parse_initial, "random:0"), (parse_initial, "random:3.1"),
        (parse_initial, "random:-1"), (parse_initial, "random:0.5,shift:1,but:1"), (parse_initial, "random:0.5,but:"),
        (parse_initial, "random:0.5,mirror:z"), (parse_initial, "random:0.5,mirror:yx"),
        (parse_initial, "random:0.5,mirror:"), (parse_initial, "random:0.5,mirror:y,but:1"),
        (parse_initial, "random:0.5,relabel:"), (parse_initial, "random:0.5,relabel:1"),
        (parse_initial, "random:0.5,turn:y"), (parse_initial, f"states:{SHA}0"), (parse_initial, "states:"),
        (parse_initial, f"snapshot:{SHA}"),
        (Intervention.parse, "reset"), (Intervention.parse, "reset@1+2"), (Intervention.parse, "excursion@1"),
        (Intervention.parse, "excursion@1+0"), (Intervention.parse, "freeze@1"), (Intervention.parse, "reset@01"),
        (Keep.parse, ""), (Keep.parse, "failing,within:0"), (Keep.parse, "failing,within:1.1e9"),
        (Keep.parse, "failing,within:-1"), (Keep.parse, "passing"),
    ],
)  # fmt: skip
def test_texts_that_mean_nothing(parse: Callable[[str], object], text: str) -> None:
    """Refuse every other text."""
    with pytest.raises(ValueError):
        parse(text)


def test_only_what_was_drawn_is_drawn() -> None:
    """Tell states that were drawn from those that were given, and from the scene's own."""
    assert drawn("random:0.5") == Initial(0.5)
    assert drawn("") is None
    assert drawn(f"states:{SHA}") is None


def test_digests_are_short_in_tables() -> None:
    """Show the first characters of a digest, and everything else as it is."""
    assert initial_words(f"snapshot:12:{SHA}") == "snapshot:12:0123456789ab"
    assert initial_words("random:0.5,but:3") == "random:0.5,but:3"
    assert snapshot_name(7) == "snapshot-7.npz"


@pytest.mark.parametrize(
    ("kind", "treated", "poisoned"),
    [("reset", {0, 2, 4}, set()), ("set", {0, 1, 2, 3, 4}, set()), ("poison", {1}, {1})],
)
def test_who_is_treated(kind: str, treated: set[int], poisoned: set[int]) -> None:
    """Name the environments that something is done to, and those that need not be finite."""
    intervention = Intervention(kind, 3)
    assert set(intervention.treated(5)) == treated
    assert intervention.poisoned(5) == poisoned
    assert intervention.poisoned(1) == set()
    assert list(intervention.stops(100)) == [3]


def test_a_teacher_comes_again() -> None:
    """Stop after each whole multiple of the steps, and not after the last step."""
    assert list(Intervention.parse("teacher@3").stops(9)) == [3, 6]
    assert Intervention.parse("teacher@3").kind.repeats


@pytest.mark.parametrize("text", ["mass:0.5", "mass:0.5,shift:3", "mass:0.5,but:0"])
def test_parameters_in_their_usual_places(text: str) -> None:
    """Give the same spreads with every environment in its own place."""
    assert Vary.parse(text).usual == Vary.parse("mass:0.5")
    assert (Vary.parse(text).usual == Vary.parse(text)) is (text == "mass:0.5")
