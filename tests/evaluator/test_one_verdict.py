"""One verdict on damage: what gsb-check passes, no command calls damaged, and the other way round."""

from __future__ import annotations

import contextlib
import io
import json
import random
import shutil
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from gpusimbench.schemas.provenance import PROVENANCE, SCENE, SIMULATION
from tests.evaluator.test_strangers import FORGERIES
from tests.hostile.corpus import _shown
from tests.hostile.mutate import MUTATORS
from tests.synthetic import grid, write_recording

_WRONG: tuple[Any, ...] = (None, {}, {"a": [1]}, [], [1, 2, 3], [[]], 10**400, 1e300, -1, 0, True, "x", "")
_DAMAGED = 3
_NOT_TOO_LARGE = [name for name in MUTATORS if "bomb" not in name]  # bombs have tests of their own
_CARD = ("--title", "forged", "--licence", "CC-BY-4.0", "--author", "Nobody, N.")


def _write(folder: Path, name: str, **changed: Any) -> Path:
    # everything that a recorder writes, so that every part can be spoiled
    rich: dict[str, Any] = {
        "gpu_bytes": (10**9, 2 * 10**9), "host_bytes": (10**8, 10**8), "allocator_peak": 10**8, "whole": True,
        "clocks": {"build": 1.0, "compile_timed": 0.5}, "environment": {"XLA_FLAGS": "-"}, "shown": _shown(2),
        "origins": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
    }  # fmt: skip
    (folder / name).unlink(missing_ok=True)
    return write_recording(folder, grid(2), name=name, **{**rich, **changed})


def _run(command: str, *arguments: object) -> tuple[int, str]:
    """Exit code and complaints of a command; whatever it raises fails the test."""
    main = import_module(f"gpusimbench.evaluator.cli.{command}").main
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = main([str(one) for one in arguments])
    return int(code), said.getvalue()


def _check_one_verdict(path: Path, good: Path, folder: Path, what: str) -> int:
    """Run every command on a file, hold their verdicts against that of gsb-check, and return its exit code."""
    gathered = folder / "set"
    shutil.rmtree(gathered, ignore_errors=True)
    gathered.mkdir()
    shutil.copy(path, gathered / path.name)
    shutil.rmtree(folder / "packed", ignore_errors=True)
    checked, findings = _run("check", path)
    codes = {
        "eval": _run("eval", path, "--no-cache"),
        "info": _run("info", path),
        "diff": _run("diff", path, good),
        "diff with itself": _run("diff", path),
        "pack": _run("share", "pack", path, "--out", folder / "packed"),
        "card": _run("share", "card", gathered, *_CARD),
        "verify": _run("share", "verify", gathered),
        "leaderboard": _run("share", "leaderboard", path, "--out", folder / "board", "--no-cache"),
    }
    for command, (code, said) in codes.items():
        assert code in (0, 3, 4, 5), f"{what}: {command} ends with {code}: {said}"
        assert code != _DAMAGED or checked == _DAMAGED, f"{what}: gsb-check ends with {checked}, {command}: {said}"
    for command in ("info", "card", "verify"):  # which look for all that gsb-check looks for
        code, said = codes[command]
        assert (code == _DAMAGED) == (checked == _DAMAGED), f"{what}: {findings}; {command}: {said}"
    return checked


def _paths(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the values of a JSON document are; of a list the first, and of a long one its fifth."""
    if at:
        yield at
    if isinstance(value, dict):
        for key in value:
            yield from _paths(value[key], (*at, key))
    elif isinstance(value, list) and value:
        for index in (0, 4)[: 1 + (len(value) > 4)]:
            yield from _paths(value[index], (*at, index))


def _field_forgeries(folder: Path) -> list[tuple[str, tuple[Any, ...], Any]]:
    found: dict[str, Any] = {}
    _write(folder, "told.mcap", change=lambda name, record: found.update({name: json.loads(json.dumps(record))}))
    return [
        (name, path, wrong)
        for name in (PROVENANCE, SIMULATION, SCENE)
        for path in _paths(found[name])
        for wrong in _WRONG
    ]


def _put(attachment: str, path: tuple[Any, ...], value: Any) -> Callable[[str, dict[str, Any]], None]:
    def change(name: str, record: Any) -> None:
        if name == attachment:
            for key in path[:-1]:
                record = record[key]
            record[path[-1]] = value

    return change


def _check_fields(folder: Path, count: int, seed: int) -> None:
    good = _write(folder, "good.mcap")
    assert _check_one_verdict(good, good, folder, "a good file") == 0
    forgeries = _field_forgeries(folder)
    codes = set()
    for name, path, wrong in random.Random(seed).sample(forgeries, count):
        bad = _write(folder, "bad.mcap", change=_put(name, path, wrong))
        codes.add(_check_one_verdict(bad, good, folder, f"{name} {path} {wrong!r:.30}"))
    assert {0, _DAMAGED} <= codes


def _check_mutants(folder: Path, count: int) -> None:
    good = _write(folder, "good.mcap")
    corpus = [_write(folder, f"{c}.mcap", compression=c, run_id=c).read_bytes() for c in ("none", "zstd")]
    for number in range(count):
        for name in _NOT_TOO_LARGE[number % 4 :: 4]:
            mutant = MUTATORS[name](random.Random(f"{name} {number}"), corpus)
            bad = folder / "bad.mcap"
            bad.write_bytes(mutant.data)
            _check_one_verdict(bad, good, folder, f"{name} {number}")


def test_a_field_of_another_type(tmp_path: Path) -> None:
    """Agree on files whose metadata have null, objects, lists, texts and huge numbers in their fields."""
    _check_fields(tmp_path, 10, seed=30)


def test_spoiled_bytes(tmp_path: Path) -> None:
    """Agree on files whose bytes, records and messages were spoiled."""
    _check_mutants(tmp_path, 2)


@pytest.mark.slow
def test_many_fields(tmp_path: Path) -> None:
    """The same of more fields."""
    _check_fields(tmp_path, 50, seed=30)


@pytest.mark.slow
def test_much_spoiled(tmp_path: Path) -> None:
    """The same of more files."""
    _check_mutants(tmp_path, 4)


@pytest.mark.parametrize(
    ("attachment", "path", "value"),
    [
        (SIMULATION, ("fields", 0, "unit"), "cm"),
        (SIMULATION, ("fields", 0, "items", 0), "another"),
        (SCENE, ("sample_time",), {}),
        (SCENE, ("bodies", 0, "material", "restitution"), [1, 2, 3]),
        (SCENE, ("board",), "table"),
        (SCENE, ("gravity",), None),
        (PROVENANCE, ("gpus", 0, "name"), {}),
        (PROVENANCE, ("host", "memory_bytes"), "much"),
        (PROVENANCE, ("software", "packages"), []),
    ],
)
def test_what_only_some_commands_refused(attachment: str, path: tuple[Any, ...], value: Any, tmp_path: Path) -> None:
    """Call damaged in every command what gsb-check, gsb-info, card or verify passed, or ended in a traceback for."""
    bad = _write(tmp_path, "bad.mcap", change=_put(attachment, path, value))
    assert _check_one_verdict(bad, _write(tmp_path, "good.mcap"), tmp_path, "forged") == _DAMAGED


def test_a_wrong_crc_of_the_summary(tmp_path: Path) -> None:
    """Call a file damaged whose summary fails its CRC, wherever it is read."""
    bad, good = _write(tmp_path, "bad.mcap"), _write(tmp_path, "good.mcap")
    data = bytearray(bad.read_bytes())
    data[-9] ^= 1  # the last byte of the footer, before the magic
    bad.write_bytes(data)
    assert _check_one_verdict(bad, good, tmp_path, "summary") == _DAMAGED
    for command, code in (("eval", 3), ("diff", 3), ("view", 3)):
        also = {"eval": ("--no-cache",), "diff": (good,), "view": ("--no-open", "--out", tmp_path / "v.html")}[command]
        assert _run(command, bad, *also)[0] == code


@pytest.mark.parametrize("forgery", sorted(FORGERIES)[::7])
def test_forged_files(forgery: str, tmp_path: Path) -> None:
    """Agree that files which gsb-eval sets aside are damaged."""
    bad = write_recording(tmp_path, grid(2), name="bad.mcap", **FORGERIES[forgery])
    assert _run("eval", bad, "--no-cache")[0] == _DAMAGED
    assert _check_one_verdict(bad, _write(tmp_path, "good.mcap"), tmp_path, forgery) == _DAMAGED
