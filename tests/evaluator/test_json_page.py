"""docs/json.md names every key of the JSON of gsb-eval in the section of its place, and no key that is not there. No
key vanishes, or changes its type, while the version stays.

python -m tests.evaluator.test_json_page    writes the list of keys anew
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from gpusimbench.evaluator.json_values import MISSING
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.details import Details
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.statistics.permutation import Floor
from gpusimbench.schemas.commands import SCHEMA_VERSION
from tests.conftest import call, recorded, run_python
from tests.json_keys import NAMES, Keys, broken, check, keys_of, write
from tests.test_docs import blocks, commands, shell

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "json.md"

SETS = {
    "several runs, a sweep that fails, a shared GPU, outcomes of throughput, a damaged file": (
        "recordings/mujoco-amd-r*", "recordings/mujoco-pyramidal-r*", "recordings/sweeps-h100/warp-free-fall-n*-r0",
        "recordings/sweeps-h100/warp-franka-n*-r0", "recordings/h100/mjx-jax-*-r[0-7]",
        "recordings/h100/warp-dense-*-r0", "tests/hostile/found/summary-crc",
    ),
    "tosses and a reference": ("recordings/cube-toss/mujoco-*", "recordings/cube-toss/real-*"),
    "a model file, levels of determinism, overflow": ("recordings/walker-h100/*",),
    "a probe, a sweep with states": ("recordings/vary-h100/warp-*T0320*", "recordings/vary-h100/warp-*T032[134]*"),
}  # fmt: skip

SECTIONS = {
    "Top level": ("",),
    "A group": ("groups",),
    "A metric": ("groups.metrics",),
    "Further numbers": ("groups.metrics.extra",),
    "The timed phase": ("groups.timed", "sweeps.points.timed", "compared.timed", "capability.scenes.timed",
                        "price_list.default.timed", "price_list.levels.timed"),
    "Validity": ("groups.validity",),
    "Physics": ("groups.physics", "groups.laws"),
    "Divergence": ("groups.divergence",),
    "Sweeps": ("sweeps", "accumulation", "convergence"),
    "Comparison": ("compared", "radar", "guidelines"),
    "Published table": ("capability",),
    "Determinism": ("price_list",),
    "Probes": ("probes",),
    "Files": ("recordings",),
}  # fmt: skip
"""Which places of the JSON a section of the page is about; what lies deeper belongs to the section of that place."""

ELSEWHERE = {"Sweeps": ("A group",), "Published table": ("A group", "Comparison"), "Determinism": ("A group",)}
"""Sections that refer to another section for some of their keys."""

OTHERS = {
    "A group": {"gsb-record": "a command", "misplaced": "recordings that count misplaced contacts"},
    "Validity": dict.fromkeys(("misplaced_contacts", "of"), "recordings that count misplaced contacts"),
    "A metric": {"certified": "W1 of sets of more than 5000 points", "sampled": "pairs of more runs than are shipped"},
    "Further numbers": {
        "ci95": "a key of a metric", "rounding": "no runs so nearly equal",
    },
    "Divergence": {"_m": "the end of a key", "_rad": "the end of a key: no bodies, and no drawn initial states"},
    "Sweeps": {"positions": "a scene without joints, at four time steps"},
    "Published table": {"compared": "a section", "none": "a sweep without a complete run",
                        "other": "a sweep that an error ended"},
    "Determinism": {"name=value": "a form"},
}  # fmt: skip
"""What else stands in backticks in a section, and why the JSON of these recordings does not have it there."""


@dataclass
class Found:
    """Keys at the places of a section, and texts that are values there."""

    keys: set[str] = field(default_factory=set)
    texts: set[str] = field(default_factory=set)


def gather(value: Any, place: str, named: int, into: dict[str, Found]) -> None:
    """Sort all keys and texts of a part of the JSON by section.

    named  levels of keys below that are names
    """
    if isinstance(value, dict):
        for key, below in value.items():
            if named:
                gather(below, place, named - 1, into)
                continue
            into[section_of(place)].keys.add(key)
            within = f"{place}.{key}".lstrip(".")
            gather(below, within, 2 if key == "radar" else int(key in NAMES), into)
    elif isinstance(value, list):
        for each in value:
            gather(each, place, named, into)
    elif isinstance(value, str):
        into[section_of(place)].texts.add(value)


def declared(kind: type) -> Iterator[str]:
    """Keys of a part of what JSON has under `extra`, by the fields of its class; none of a part that names its own."""
    for one in fields(kind):
        if not one.metadata.get("hidden"):
            yield one.name
            stack = [get_type_hints(kind)[one.name]]
            while stack:
                hint = stack.pop()
                stack += get_args(hint)
                if isinstance(hint, type) and is_dataclass(hint) and hint not in (Missing, Floor):
                    yield from declared(hint)


def kinds(kind: type[Details] = Details) -> Iterator[type[Details]]:
    """All classes of details, however deep."""
    for one in kind.__subclasses__():
        yield one
        yield from kinds(one)


def section_of(place: str) -> str:
    """The section of the page that is about a place."""
    while True:
        for section, places in SECTIONS.items():
            if place in places:
                return section
        place = place.rpartition(".")[0]


def made() -> list[Any]:
    """The JSON of varied recordings."""
    sets = [sorted(p for pattern in patterns for p in ROOT.glob(f"{pattern}.mcap")) for patterns in SETS.values()]
    asked = [(*files, "--no-cache") for files in sets]
    pendulums = [
        path
        for dt, seconds in ((0.04, 2), (0.02, 5), (0.01, 5), (0.005, 5))  # 2 s are less than a period, which is a law
        for path in recorded(
            "--sim", "mujoco", "--scene", "pendulum", "--n-env", 8, "--runs", 1, "--phases", "capture", "--dt", dt,
            "--steps", round(seconds / dt), "--initial", "random:0.8", "--no-view",
        )
    ]  # fmt: skip
    every = (*asked, (*pendulums, "--sample-time", 1, "--no-cache"))
    return [json.loads(call("gsb-eval", *arguments, "--json", "-").stdout) for arguments in every]


@pytest.fixture(scope="module")
def documents() -> list[Any]:
    """The same, made once."""
    return made()


@pytest.fixture(scope="module")
def found(documents: list[Any]) -> dict[str, Found]:
    """Their keys and texts, by section of the page."""
    by_section = {section: Found() for section in SECTIONS}
    for document in documents:
        gather(document, "", 0, by_section)
    by_section["Further numbers"].keys.update(of_details())
    return by_section


def of_details() -> set[str]:
    """Keys that the JSON of some recording has under `extra`, also of those that are not shipped."""
    return {key for kind in kinds() if kind.record is Details.record for key in declared(kind)}


def listed(documents: Iterable[Any]) -> Keys:
    """The keys of the documents, and those of details."""
    return {**keys_of(documents), **{f"extra: {key}": [] for key in sorted(of_details())}}


@pytest.fixture(scope="module")
def page() -> dict[str, str]:
    """The sections of the page."""
    heads = re.split(r"^## (.*)$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    text = dict(zip(heads[1::2], heads[2::2], strict=True))
    return {section: next(t for head, t in text.items() if head.startswith(section)) for section in SECTIONS}


def quoted(text: str) -> set[str]:
    """What stands in backticks, paths as their parts; without null and the empty text."""
    whole = [name.replace("[]", "") for name in re.findall(r"`([^`]+)`", text)]
    parts = {part for name in whole for part in ([name] if " " in name else name.split("."))}
    return parts - {"null", '""'}


def ruled(keys: set[str]) -> set[str]:
    """Keys that the rule of missing values at the top of the page explains: reasons beside a key, and of an entry."""
    return {key for key in keys if key == "missing" or (key.endswith(MISSING) and key.removesuffix(MISSING) in keys)}


def test_the_page_names_every_key_and_no_other(found: dict[str, Found], page: dict[str, str]) -> None:
    """Name each key of the JSON in the section that is about its place, or where that section says; and put nothing
    else in backticks there but texts of the JSON and what the test lists."""
    places = {place.rpartition(".")[2] for places in SECTIONS.values() for place in places}
    missing, unknown, listed = {}, {}, {}
    for section, there in found.items():
        told, others = quoted(page[section]), OTHERS.get(section, {}).keys()
        elsewhere = {name for other in ELSEWHERE.get(section, ()) for name in quoted(page[other])}
        missing[section] = there.keys - told - elsewhere - ruled(there.keys)
        unknown[section] = told - there.keys - there.texts - others - places - set(METRICS)
        listed[section] = others & (there.keys | there.texts)
    assert {section: sorted(names) for section, names in missing.items() if names} == {}
    assert {section: sorted(names) for section, names in unknown.items() if names} == {}
    assert {section: sorted(names) for section, names in listed.items() if names} == {}, "they are there now"


def test_no_key_vanishes_while_the_version_stays(documents: list[Any]) -> None:
    """Find every key that is listed for this version with values of the listed types, and list every key."""
    assert check("eval", listed(documents)) == []


def test_a_reason_stands_where_a_value_does_not(documents: list[Any]) -> None:
    """Give a reason with no value that is there, by the rule at the top of the page, in every object."""
    seen: set[bool] = set()

    def look(value: Any, place: str) -> None:
        if isinstance(value, dict):
            for key in [key for key in value if key.endswith(MISSING)]:
                there = value[key.removesuffix(MISSING)] not in (None, [], {})
                assert isinstance(value[key], str) and not (there and value[key]), f"{place}.{key}"
                seen.add(there)
            assert not value.get("missing") or not any(isinstance(v, float) for v in value.values()), place
        for key, below in value.items() if isinstance(value, dict) else enumerate(value):
            if isinstance(below, (dict, list)):
                look(below, f"{place}.{key}")

    for document in documents:
        look(document, "")
    assert seen == {True, False}


def test_a_key_that_vanishes_breaks_the_version() -> None:
    """Tell keys that vanished, or whose values have another type, from keys that are new."""
    kept = keys_of([{"a": 1, "options": {"x": 1.5}, "b": [{"c": None}, {"c": "text"}]}])
    assert kept == {"a": ["number"], "b": ["list"], "b[].c": ["null", "text"], "options.*": ["number"]}
    assert broken(kept, keys_of([{"a": 2, "options": {"y": 2}, "b": [{"c": None, "new": 1}, {"c": ""}]}])) == []
    assert broken(kept, keys_of([{"a": "2", "options": {"y": 2}, "b": []}])) == [
        "b[].c has vanished", "a is text, was number",
    ]  # fmt: skip


def test_the_page_has_the_version() -> None:
    """State on the page the version that the documents have."""
    assert f"`schema_version` is {SCHEMA_VERSION}." in PAGE.read_text(encoding="utf-8")


def test_the_example_runs(tmp_path: Path) -> None:
    """Write the file and read it as the page shows."""
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    (asked,), (program,) = commands(PAGE), blocks(PAGE, "python")
    done = shell(asked, tmp_path)
    assert done.stdout
    (line,) = run_python(program, cwd=tmp_path).stdout.splitlines()
    assert re.fullmatch(r"mujoco \d+ env-steps/s", line)


def test_the_questions_are_answered(tmp_path: Path) -> None:
    """Print for each question of the page, asked of the file that its command writes, what the page shows."""
    if shutil.which("jq") is None:
        pytest.skip("jq is not installed")
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    (asked,), questions = commands(PAGE), blocks(PAGE, "sh")
    shell(asked, tmp_path)
    assert len(questions) == 3
    assert [shell(question.rstrip(), tmp_path).stdout for question in questions] == blocks(PAGE, "text")


if __name__ == "__main__":
    write("eval", listed(made()))
