"""Names of groups: short, unique, and about what matters."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.groups import TOLD_AS, GroupKey, group, key_of
from gpusimbench.evaluator.runs.labels import footnotes, labels, options_given, row_names, short_device
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.provenance import PROVENANCE, SIMULATION
from tests.conftest import Command, call
from tests.synthetic import changing, grid, write_recording


def named(folder: Path, *kinds: dict[str, Any]) -> list[str]:
    """Labels of one recording of each kind."""
    recordings = [open_recording(write_recording(folder, grid(1), **kind)) for kind in kinds]
    return sorted(labels([g.key for g in group(recordings)], options_given(recordings)))


@pytest.mark.parametrize(
    ("kinds", "expected"),
    [
        (
            [{"options": {"impl": impl, "cone": "elliptic"}} for impl in ("jax", "warp")],
            ["synthetic [impl=jax]", "synthetic [impl=warp]"],
        ),
        (
            [{"options": {"rng": f"uint32 4x2 keys, hash {n}7dc4e2a90b3f581"}} for n in (3, 8)]
            + [{"options": {"rng": "seed 3"}}],
            ["synthetic [rng=37dc4e2a]", "synthetic [rng=87dc4e2a]", "synthetic [rng=seed 3]"],
        ),
        (
            [
                {"options": {"seeds": ", ".join(map(str, seeds))}}
                for seeds in (range(5, 69), range(5, 70), (7, 5), (*range(64), 99), (*range(64), 98))
            ],
            [
                "synthetic [seeds=5..68]",
                "synthetic [seeds=5..69]",
                "synthetic [seeds=65 with hash 88520199]",
                "synthetic [seeds=65 with hash f00bfa6f]",
                "synthetic [seeds=7, 5]",
            ],
        ),
        (
            [{"options": {"solver": "xpbd", "relaxation": 0.9}}, {"options": {"solver": "mujoco"}}],
            ["synthetic [relaxation=0.9, solver=xpbd]", "synthetic [solver=mujoco, relaxation=unset]"],
        ),
        (
            [
                {"determinism": level, "switches": switches, "environment": variables}
                for level, switches, variables in (
                    ("default", {"deterministic": False}, {}),
                    ("run", {"deterministic": True, "atomics": "off"}, {"XLA_FLAGS": "--xla_gpu_deterministic_ops"}),
                )
            ],
            ["synthetic [determinism=default]", "synthetic [determinism=run]"],
        ),
        (
            [
                {"determinism": level, "switches": {"precision": precision}}
                for level in ("default", "full")
                for precision in ("f32", "f64")
            ],
            [
                f"synthetic [determinism={level}, precision={p}]"
                for level in ("default", "full")
                for p in ("f32", "f64")
            ],
        ),
        ([{}, {"built": False, "status": "FAILED", "options": {"cone": "cubic"}}], None),
    ],
)
def test_labels(tmp_path: Path, kinds: list[dict[str, Any]], expected: list[str] | None) -> None:
    """Show what tells groups of one simulator apart; a level of determinism stands for the switches that it sets."""
    found = named(tmp_path, *kinds)
    assert len(set(found)) == len(kinds)
    assert all(len(label) < 80 for label in found)
    if expected is None:
        assert any("never built" in label and "scene" not in label for label in found)
    else:
        assert found == expected


def test_a_failed_run_joins_what_was_asked_for(tmp_path: Path) -> None:
    """Put a run that was never built to the group of the same request, also where another machine ran it too."""
    files = [
        write_recording(tmp_path, grid(2)),
        write_recording(tmp_path, grid(2), run=1, built=False, status="FAILED", reason="no memory"),
        write_recording(tmp_path, grid(2), gpu_bytes=(1, 2)),
        write_recording(tmp_path, grid(2), run=1, built=False, status="FAILED", reason="lost", gpu_bytes=(1, 2)),
    ]
    groups = group([open_recording(f) for f in files])
    assert [len(g.recordings) for g in groups] == [2, 2]
    assert all(g.outcomes["failed"] == 1 for g in groups)


def test_another_precision_is_named(tmp_path: Path) -> None:
    """Tell float32 from float64 by name, before settings that nobody chose; a run that was never built has neither."""
    finals: list[Any] = [grid(2, "float32"), grid(2, "float64")]
    files = [write_recording(tmp_path, final, switches={"x": str(final.dtype)}) for final in finals]
    recordings = [open_recording(file) for file in files]
    assert sorted(labels([g.key for g in group(recordings)])) == ["synthetic [float32]", "synthetic [float64]"]
    failed = open_recording(
        write_recording(tmp_path, None, built=False, status="FAILED", reason="no memory", options={"cone": "x"})
    )
    found = labels([g.key for g in group([*recordings, failed])], {"synthetic": frozenset({"cone"})})
    assert sum("float32" in label for label in found) == sum("float64" in label for label in found) == 1
    assert not any("#" in label for label in found)


def test_protocol_stands_in_a_footnote(tmp_path: Path) -> None:
    """Name neither warm-up nor environment variables where options tell groups apart, and say both below the table."""
    kinds: list[dict[str, Any]] = [
        {"options": {"impl": "warp"}, "warmup": 100, "elapsed_s": 2.0},
        {
            "options": {"impl": "jax"}, "warmup": 20, "timed_steps": 100, "elapsed_s": 2.0,
            "environment": {"XLA_FLAGS": "--xla_gpu_autotune_level=0 --xla_dump_to=x"},
            "switches": {"xla_flags_of_level": "--xla_gpu_autotune_level=0"},
        },
        {"simulator": "other", "warmup": 100, "elapsed_s": 2.0},
    ]  # fmt: skip
    recordings = [open_recording(write_recording(tmp_path, grid(1), **kind)) for kind in kinds]
    keys = [g.key for g in group(recordings)]
    said = dict(zip(labels(keys, options_given(recordings)), footnotes(keys), strict=True))
    assert sorted(said) == ["other", "synthetic [impl=jax]", "synthetic [impl=warp]"]
    assert said["other"] == ()
    protocol, variable = said["synthetic [impl=jax]"]
    assert "100 steps after 20 warm-up steps" in protocol
    assert "1,000 after 100: throughput not comparable" in protocol
    assert "XLA_FLAGS=--xla_dump_to=x, unlike others" in variable  # what the level sets is the level's
    assert said["synthetic [impl=warp]"] == (variable.replace("=--xla_dump_to=x", "=unset"),)


def test_an_option_without_a_value_parts_no_groups(tmp_path: Path) -> None:
    """Take a recorder that names an option, and gives it no value, for one that does not have the option yet."""
    files = [
        write_recording(tmp_path, grid(1), run=run, in_force={"solver": "xpbd", **more})
        for run, more in enumerate(({}, {"mujoco_solver": None}))
    ]
    assert len(group([open_recording(file) for file in files])) == 1


def test_what_an_engine_remarked_parts_no_groups(tmp_path: Path) -> None:
    """Take runs for alike whose engines warned in other words, also where these stand among the switches."""
    said = ("njmax is raised to 40", "njmax is raised to 64")
    kinds: list[dict[str, Any]] = [
        {},
        *({"change": changing(SIMULATION, remarks=[sentence])} for sentence in said),
        *({"switches": {"warnings": [sentence]}} for sentence in said),
    ]
    files = [write_recording(tmp_path, grid(1), run=run, **kind) for run, kind in enumerate(kinds)]
    recordings = [open_recording(file) for file in files]
    assert len(group(recordings)) == 1
    told = [recording.simulation.remarks for recording in recordings if recording.simulation]
    assert told == [(), *((sentence,) for sentence in said), *((sentence,) for sentence in said)]
    apart = [write_recording(tmp_path, grid(1), switches={"warnings": flag}) for flag in (True, False)]
    assert len(group([open_recording(file) for file in apart])) == 2  # a switch of that name that is no remark


@pytest.mark.parametrize(("cpu", "notes"), [("test", 2), ("another", 0)])
def test_variables_of_another_device_are_no_note(tmp_path: Path, cpu: str, notes: int) -> None:
    """Compare environment variables on one device alone: those of another machine differ anyway."""
    kinds: list[dict[str, Any]] = [{"environment": {"OMP_NUM_THREADS": "1"}}, {"cpu": cpu}]
    keys = [g.key for g in group([open_recording(write_recording(tmp_path, grid(1), **kind)) for kind in kinds])]
    assert sum(map(len, footnotes(keys))) == notes


def test_what_alone_tells_groups_apart_is_named(tmp_path: Path) -> None:
    """Name the protocol, or an environment variable, where nothing else differs: labels stay unique."""
    assert named(tmp_path, {"warmup": 20, "elapsed_s": 2.0}, {"warmup": 100, "elapsed_s": 2.0}) == [
        "synthetic [warmup=100]",
        "synthetic [warmup=20]",
    ]
    assert named(tmp_path, {"environment": {"OMP_NUM_THREADS": "1"}}, {}) == [
        "synthetic [OMP_NUM_THREADS=1]",
        "synthetic [OMP_NUM_THREADS=unset]",
    ]


def test_an_option_of_another_simulator_tells_nothing(tmp_path: Path) -> None:
    """Leave out an option that a user gave to one simulator only from the labels of another, where it follows."""
    mine = {"options": {"cone": "pyramidal"}, "simulator": "one"}
    theirs = [{"options": {"solver": s}, "in_force": {"solver": s, "cone": s}} for s in ("a", "b")]
    recordings = []
    for kind in (mine, {"simulator": "one"}, *theirs):
        recordings.append(open_recording(write_recording(tmp_path, grid(1), **kind)))
    found = labels([g.key for g in group(recordings)], options_given(recordings))
    assert sorted(found)[-2:] == ["synthetic [solver=a]", "synthetic [solver=b]"]


def test_a_scene_is_named_for_all_groups_or_none(tmp_path: Path) -> None:
    """Name the scene of all groups of a simulator there, if one of them has the name of another scene's, or none."""
    [one] = group([open_recording(write_recording(tmp_path, grid(1)))])
    places = [("a", 1), ("a", 2), ("b", 2), ("b", 3), ("c", 5), ("c", 6), ("d", 7)]
    keys = [replace(one.key, scene=scene, n_env=n_env) for scene, n_env in places]
    assert [label.removeprefix("synthetic ") for label in labels(keys)] == [
        "[a, n_env=1]", "[a, n_env=2]", "[b, n_env=2]", "[b, n_env=3]", "[n_env=5]", "[n_env=6]", "[d]",
    ]  # fmt: skip


def test_what_stands_beside_a_label(tmp_path: Path) -> None:
    """Leave out of labels what a table shows beside them, and number those that are alike even so."""
    kinds: list[dict[str, Any]] = [
        {"simulator": "a", "scene": scene, "warmup": warmup}
        for scene in ("free-fall", "inclined-collision")
        for warmup in (10, 20)
    ]
    keys = [g.key for g in group([open_recording(write_recording(tmp_path, grid(1), **kind)) for kind in kinds])]
    assert sorted(labels(keys, beside=("scene",))) == ["a [warmup=10]"] * 2 + ["a [warmup=20]"] * 2
    assert len(set(labels(keys))) == 4


def test_given_states_that_follow_from_the_number_of_environments(small: Path) -> None:
    """Name given states only where they differ among as many environments, and then by the beginning of their hash."""
    key = group([open_recording(small)])[0].key
    few, many, others = (
        replace(key.with_settings(initial=f"states:{digit * 64}"), n_env=n)
        for n, digit in ((4, "a"), (8, "b"), (4, "c"))
    )
    assert labels([few, many]) == ["mujoco [n_env=4]", "mujoco [n_env=8]"]
    assert labels([few, others]) == ["mujoco [initial=states:aaaaaaaa]", "mujoco [initial=states:cccccccc]"]
    assert labels([few, replace(few.with_settings(initial=""), n_env=8)]) == [
        "mujoco [n_env=4, initial=states:aaaaaaaa]",
        "mujoco [n_env=8]",
    ]


def test_names_of_rows_leave_out_what_stands_beside_them(tmp_path: Path) -> None:
    """Name groups by options and levels; size and protocol are in no name, and what is alike in all has a number."""
    kinds = [{"determinism": level, "timed_steps": steps} for level in ("default", "full") for steps in (3, 5)]
    recordings = [open_recording(write_recording(tmp_path, grid(n), **kind)) for n in (1, 2) for kind in kinds]
    keys = [g.key for g in group(recordings)]
    assert len(keys) == 8
    given = options_given(recordings)
    marks = ["" if key.timed_steps == 5 else "¹" for key in keys]
    named = dict(zip(((key.determinism, key.timed_steps, key.n_env) for key in keys), row_names(keys, given, marks),
                     strict=True))  # fmt: skip
    assert named["full", 5, 1] == named["full", 5, 2] == "synthetic [full]"
    assert named["full", 3, 1] == "synthetic [full] ¹"
    assert set(row_names(keys, given, [""] * 8)) == {
        f"synthetic [{level}] #{i}" for level in ("default", "full") for i in (1, 2)
    }


@pytest.mark.parametrize(
    ("device", "short"),
    [
        ("NVIDIA H100 80GB HBM3", "H100"),
        ("NVIDIA GeForce RTX 5070", "RTX 5070"),
        ("Intel(R) Xeon(R) Processor, 16 threads", "Xeon, 16 threads"),
        ("", ""),
    ],
)
def test_devices_are_short(device: str, short: str) -> None:
    """Leave out what all devices of a maker have in their names."""
    assert short_device(device) == short


def test_a_modified_engine_does_not_stand_under_the_name_of_the_released_one(tmp_path: Path, gsb_eval: Command) -> None:
    """Put MODIFIED behind its name in every table, keep its options, and compare it with nothing that was published."""
    why = "PhysX 5.8.0, where SAPIEN 3.0.3 is released with 105.1"
    kinds = ({"switches": {"modified": why}, "options": {"enable_tgs": value}} for value in ("true", "false"))
    runs = [*kinds, {"options": {"enable_tgs": "true"}}]
    assert named(tmp_path, *({"simulator": "maniskill", **run} for run in runs)) == [
        "maniskill",
        "maniskill MODIFIED [enable_tgs=false]",
        "maniskill MODIFIED [enable_tgs=true]",
    ]
    files = sorted(map(str, tmp_path.glob("*.mcap")))
    results = json.loads(gsb_eval(*files, "--json", "-").stdout)
    simulators = sorted(result["simulator"] for result in results["groups"])
    assert simulators == ["maniskill", "maniskill MODIFIED", "maniskill MODIFIED"]
    alone = tmp_path / "alone"
    alone.mkdir()
    write_recording(alone, grid(1), simulator="maniskill", switches={"modified": why}, name="m.mcap")
    page = tmp_path / "page"
    gsb_eval(str(alone), "--html", str(page))
    assert "maniskill MODIFIED" in (page / "index.html").read_text()
    assert why in (page / "index.html").read_text()
    assert "maniskill MODIFIED 1.0 on" in call("gsb-info", str(alone / "m.mcap")).stdout
    assert "maniskill MODIFIED 1.0" in call("gsb-diff", str(alone / "m.mcap"), files[0]).stdout


def test_a_run_that_failed_joins_those_of_a_modified_engine(tmp_path: Path) -> None:
    """A run that ended before its engine said anything is counted among those that were asked for the same."""
    modified = {"switches": {"modified": "another PhysX"}}
    write_recording(tmp_path, grid(1), name="a.mcap", **modified)
    write_recording(tmp_path, grid(1), name="b.mcap", run=1, built=False, status="FAILED")
    groups = group([open_recording(path) for path in sorted(tmp_path.glob("*.mcap"))])
    assert [len(found.recordings) for found in groups] == [2]


@pytest.mark.parametrize(
    ("simulator", "package", "groups"),
    [
        ("warp", "genesis-world", 1),
        ("genesis", "genesis-world", 2),
        ("warp", "mujoco", 2),
        ("theirs", "genesis-world", 2),
    ],
)
def test_packages_that_other_simulators_execute_part_no_groups(
    tmp_path: Path, simulator: str, package: str, groups: int
) -> None:
    """Count the version of a package where the simulator may execute it; one that is not built in may execute all."""

    other = changing(PROVENANCE, "software", packages={package: "2"})
    files = [write_recording(tmp_path, grid(1), simulator=simulator, run=run) for run in (0, 1)]
    files.append(write_recording(tmp_path, grid(1), simulator=simulator, run=2, change=other))
    assert len(group([open_recording(file) for file in files])) == groups


def test_options_that_an_engine_tells_by_another_name() -> None:
    """Tell no group apart by an option that was given the value that is in force without it, and alias no option that
    there is not."""
    recording = open_recording(Path(__file__).parents[2] / "recordings" / "humanoid" / "genesis-cpu.mcap")
    assert recording.configuration.options == {"solver": recording.simulation.options["constraint_solver"]}
    assert "solver" not in json.loads(key_of(recording).options)
    for simulator, names in TOLD_AS.items():
        assert names.keys() <= {field.name for field in fields(find_simulator(simulator).adapter().Options)}


def test_settings_of_a_key_are_parsed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parse the JSON of each key once, however many others it is told apart from."""
    some = {f"o{n}": n for n in range(3)}
    keys = [
        GroupKey(
            "s", "1", "d", "scene", "", 16, 0.01, 0, 0, 0, "default", json.dumps({**some, "n": n}),
            json.dumps({"w": n}),
            json.dumps({"VARIABLE": n}), json.dumps({f"f{n}": ["float32"]}), "[]",
        )
        for n in range(20)
    ]  # fmt: skip
    parsed: Counter[str] = Counter()
    loads = json.loads

    def counted(text: str) -> Any:
        parsed[text] += 1
        return loads(text)

    monkeypatch.setattr(json, "loads", counted)
    given = {"s": frozenset({"n"})}
    assert labels(keys, given) == [f"s [n={n}]" for n in range(20)]
    assert all(len(notes) == 1 for notes in footnotes(keys))
    row_names(keys, given, [""] * len(keys))
    assert set(parsed.values()) == {1}
