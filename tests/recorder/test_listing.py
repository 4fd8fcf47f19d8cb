"""gsb-record --list NAME: one simulator or one scene, whole."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from typing import Any

import pytest

from gpusimbench.recorder.options import meanings
from gpusimbench.recorder.simulators.registry import BUILT_IN, Entry
from tests.conftest import Command

every_engine = pytest.mark.parametrize("entry", BUILT_IN, ids=lambda entry: entry.name)


def _shown(gsb_record: Command, name: str) -> tuple[str, dict[str, Any]]:
    text, record = gsb_record("--list", name), gsb_record("--list", name, "--json")
    assert text.returncode == record.returncode == 0, text.stderr + record.stderr
    return text.stdout, json.loads(record.stdout)


@every_engine
def test_every_option_has_a_meaning(entry: Entry) -> None:
    """Explain each option in the docstring of its dataclass, or of one that it inherits."""
    options = entry.adapter().Options
    assert meanings(options).keys() == {field.name for field in fields(options)}


@every_engine
def test_levels_without_effect_exist(entry: Entry) -> None:
    """Name devices and levels that the simulator has, and never the default."""
    adapter = entry.adapter()
    for device, levels in adapter.levels_without_effect.items():
        assert device in entry.devices
        assert levels.keys() <= adapter.determinism_levels.keys() - {"default"}
        assert all(levels.values())


@every_engine
def test_one_engine(gsb_record: Command, entry: Entry) -> None:
    """Show where it steps, its abilities and scenes, each option with its meaning, each level with its effect."""
    text, record = _shown(gsb_record, entry.name)
    about, adapter = record["simulator"], entry.adapter()
    flat = " ".join(text.split())
    assert [o["name"] for o in about["options"]] == [f.name for f in fields(adapter.Options)]
    assert {level["level"]: level["sets"] for level in about["levels"]} == adapter.determinism_levels
    for option in about["options"]:
        assert f" {option['name']}=" in text
        assert " ".join(option["meaning"].split()[:3]) in flat
    for level in about["levels"]:
        assert f" {level['level']} " in text
        none = adapter.levels_without_effect.get(about["device_here"], {})
        assert level["effect_here"] == (level["level"] not in none)
    assert all(" ".join(claim.split()[:4]) in flat for claim in about["state"].values())
    assert f"device on this machine: {about['device_here']}" in text
    assert flat.count("NO EFFECT on this machine") == sum(not level["effect_here"] for level in about["levels"])
    assert f"scenes: {', '.join(about['scenes'])}" in text
    # A path is as long as its owner made it, and stays on one line, so that it can be copied.
    assert max(len(line) for line in text.splitlines()[1:] if not line.startswith("environment: ")) <= 200


def test_flags_of_a_gpu(gsb_record: Command) -> None:
    """Say of XLA's flags that they do nothing on a CPU, where this machine has no GPU."""
    _, record = _shown(gsb_record, "brax")
    if record["simulator"]["device_here"] != "cpu":
        pytest.skip("this machine has a GPU")
    assert [level["level"] for level in record["simulator"]["levels"] if level["effect_here"]] == ["default"]


def test_a_scene(gsb_record: Command) -> None:
    """Show of a scene what it needs, its times, and which simulators can run it."""
    text, record = _shown(gsb_record, "free-fall")
    assert {"mujoco", "warp"} <= set(record["scene"]["simulators"])
    assert f"positions are compared at {record['scene']['sample_time']:g} s" in text


def test_measured_trials(gsb_record: Command) -> None:
    """Show of measured trials that there is nothing to choose."""
    text, record = _shown(gsb_record, "real")
    assert record["simulator"]["name"] == "real"
    assert "options" not in text


def test_an_unknown_name(gsb_record: Command) -> None:
    """End with 2 and the name that may have been meant, of simulators and scenes."""
    for given, meant in (("mujco", "mujoco"), ("freefall", "free-fall")):
        done = gsb_record("--list", given, code=2)
        assert f"did you mean '{meant}'" in done.stderr


def test_meanings() -> None:
    """Read names with commas, names that begin so, and meanings of several lines; leave sentences alone."""

    @dataclass(frozen=True)
    class Base:
        """Options.

        Sentences  are not rows of the table, unless an option is named so.

        a, b   one
               and more
        """

        a: int = 0
        b: int = 0

    @dataclass(frozen=True)
    class Of(Base):
        """More.

        b         another
        gpu_...   sizes
        """

        gpu_x: int = 0
        gpu_y: int = 0
        c: int = 0

    assert meanings(Of) == {"a": "one and more", "b": "another", "gpu_x": "sizes", "gpu_y": "sizes"}
