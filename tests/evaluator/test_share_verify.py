"""Verifying a set: whatever was done to it is found, wherever it is, and no manifest leads anywhere else."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import fsspec
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusimbench.evaluator.cli.share import main
from gpusimbench.evaluator.share.dataset.contents import sum_of
from gpusimbench.evaluator.share.dataset.manifest import load_manifest
from gpusimbench.evaluator.share.dataset.places import child
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import Location
from tests.evaluator.sets import WHEN, WORDS, described, rename_in
from tests.synthetic import write_recording
from tests.web import serving


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, small_set: list[Path]) -> Path:
    """Two real runs and a file of another kind, one of them in a folder; must not be written to."""
    folder = tmp_path_factory.mktemp("verified")
    (folder / "below").mkdir()
    shutil.copy(small_set[0], folder / "below" / "a b.mcap")
    (folder / "notes.txt").write_text("notes\n")
    return described(folder, small_set[1:2])


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    """The same, to be changed."""
    return Path(shutil.copytree(made, tmp_path / "set"))


def findings(where: Path | str, capsys: pytest.CaptureFixture[str], code: int) -> list[dict[str, str]]:
    """What verify finds, in its JSON."""
    capsys.readouterr()
    assert main(["verify", str(where), "--json", "-"]) == code
    return json.loads(capsys.readouterr().out)["findings"]


def test_a_set_is_what_it_says(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Find nothing wrong with a set that nobody touched, and say what was looked at."""
    assert main(["verify", str(made)]) == 0
    said = capsys.readouterr().out
    assert "2 recordings have their content hashes" in said
    assert "every value of metrics.parquet and runs.parquet follows" in said
    assert "not looked at: whether what README.md and CITATION.cff say follows from the recordings" in said
    assert findings(made, capsys, 0) == []


def test_what_downloaders_leave_is_no_part_of_it(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Look over names that begin with a dot, and say so."""
    (copy / ".gitattributes").write_text("*\n")
    (copy / ".cache").mkdir()
    (copy / ".cache" / "x.mcap").write_text("x")
    assert main(["verify", str(copy)]) == 0
    assert "names that begin with a dot: .cache, .gitattributes" in capsys.readouterr().out


@settings(max_examples=25)
@given(data=st.data())
@pytest.mark.slow
def test_any_byte_of_any_file_counts(made: Path, data: st.DataObject) -> None:
    """Flip any bit of any byte of any file of a set: verify does not end with 0."""
    files = sorted(p.relative_to(made) for p in made.rglob("*") if p.is_file())
    chosen = data.draw(st.sampled_from(files))
    at = data.draw(st.integers(0, (made / chosen).stat().st_size - 1))
    bit = data.draw(st.integers(0, 7))
    with tempfile.TemporaryDirectory() as folder:
        spoiled = Path(shutil.copytree(made, Path(folder, "set")))
        content = bytearray((spoiled / chosen).read_bytes())
        content[at] ^= 1 << bit
        (spoiled / chosen).write_bytes(content)
        assert main(["verify", str(spoiled)]) in (3, 4)


def _remove(folder: Path) -> None:
    (folder / "below" / "a b.mcap").unlink()


def _cut(folder: Path) -> None:
    path = folder / "notes.txt"
    path.write_bytes(path.read_bytes()[:-1])


def _add(folder: Path) -> None:
    (folder / "more.txt").write_text("more")


def _link(folder: Path) -> None:
    kept = folder.parent / "kept"
    (folder / "notes.txt").rename(kept)
    (folder / "notes.txt").symlink_to(kept)


def _link_folder(folder: Path) -> None:
    (folder / "below").rename(folder.parent / "below")
    (folder / "below").symlink_to(folder.parent / "below")


def _sums(folder: Path) -> None:
    (folder / "SHA256SUMS").unlink()


def _sums_shorter(folder: Path) -> None:
    lines = (folder / "SHA256SUMS").read_text().splitlines(keepends=True)
    (folder / "SHA256SUMS").write_text("".join(lines[:-1]))


def _sums_twice(folder: Path) -> None:
    text = (folder / "SHA256SUMS").read_text()
    (folder / "SHA256SUMS").write_text(text + text.splitlines(keepends=True)[0])


@pytest.mark.parametrize(
    ("spoil", "code", "kind", "path"),
    [
        (_remove, 3, "missing", "below/a b.mcap"),
        (_cut, 3, "changed", "notes.txt"),
        (_add, 4, "not named", "more.txt"),
        (_link, 3, "not named", "notes.txt"),
        (_link_folder, 3, "not named", "below"),
        (_sums, 3, "missing", "SHA256SUMS"),
        (_sums_shorter, 4, "disagrees", "runs.parquet"),
        (_sums_twice, 3, "changed", "SHA256SUMS"),
    ],
)
def test_what_is_done_to_files_is_named(
    copy: Path, capsys: pytest.CaptureFixture[str], spoil: Callable[[Path], None], code: int, kind: str, path: str
) -> None:
    """Name what is missing, changed, added, or a link that was not followed."""
    spoil(copy)
    assert (kind, path) in {(f["kind"], f["file"]) for f in findings(copy, capsys, code)}


def write_table(folder: Path, table: pl.DataFrame, **options: Any) -> None:
    """Put another table in the place of metrics.parquet, and make every digest agree with it."""
    path = folder / "metrics.parquet"
    old = sum_of(path)
    table.write_parquet(path, **options)
    new = sum_of(path)
    told = '"bytes": {},\n   "sha256": "{}"'
    rename_in(folder, told.format(old.bytes, old.sha256).encode(), told.format(new.bytes, new.sha256).encode())


def test_a_table_that_was_made_up_is_found(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Change a value in the table, and every digest with it: the recordings tell, and which value it is."""
    table = pl.read_parquet(copy / "metrics.parquet")
    changed = pl.when(pl.col("metric") == "fps").then(pl.col("value") * 2).otherwise(pl.col("value")).alias("value")
    write_table(copy, table.with_columns(changed))
    (found,) = findings(copy, capsys, 4)
    assert (found["kind"], found["file"]) == ("disagrees", "metrics.parquet")
    assert found["said"].startswith("mujoco, fps: value is ")
    assert "relative difference 5.0e-01" in found["said"]


def test_a_table_that_somebody_else_wrote_may_be_right(
    made: Path, copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Take a table with other bytes and the same values; of values that differ a little, by what is allowed."""
    for factor, arguments, code in ((1.0, [], 0), (1 + 1e-12, [], 4), (1 + 1e-12, ["--tolerance", "1e-9"], 0)):
        table = pl.read_parquet(made / "metrics.parquet").with_columns(pl.col("value") * factor)
        write_table(copy, table, compression="uncompressed")
        assert main(["verify", str(copy), *arguments]) == code, capsys.readouterr().out


@pytest.mark.parametrize("name", ["set[1]", "set=1", "*"])
def test_a_folder_may_have_any_name(name: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Read the tables of the folder that was named, and take its name for no pattern."""
    shutil.copytree(made, tmp_path / name)
    write_table(tmp_path / name, pl.read_parquet(made / "metrics.parquet"), compression="uncompressed")
    assert findings(tmp_path / name, capsys, 0) == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b'"status": "complete"', b'"status": "invalid"', "status is 'invalid' in manifest.json"),
        (b'"check": "whole"', b'"check": "broken"', "check is 'broken'"),
        (b'"group": "mujoco"', b'"group": "warp"', "group is 'warp'"),
    ],
)
def test_a_manifest_that_says_otherwise_is_found(
    copy: Path, capsys: pytest.CaptureFixture[str], old: bytes, new: bytes, said: str
) -> None:
    """Hold what a manifest says of each recording against the recording."""
    rename_in(copy, old, new)
    found = findings(copy, capsys, 4)
    assert len(found) == 2
    assert all(said in one["said"] for one in found)


def test_recordings_are_held_against_the_rules(tmp_path: Path, small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Name a published recording that breaks a rule, and one that is damaged, though every digest is right."""
    shutil.copy(small, tmp_path)
    write_recording(tmp_path, None, name="says-little.mcap")
    assert main(["card", str(tmp_path), *WORDS, *WHEN]) == 4
    assert {(f["kind"], f["file"]) for f in findings(tmp_path, capsys, 4)} == {("breaks a rule", "says-little.mcap")}
    (tmp_path / "cut.mcap").write_bytes(small.read_bytes()[:-30])
    assert main(["card", str(tmp_path), *WORDS, *WHEN, "--update"]) == 3
    assert ("damaged", "cut.mcap") in {(f["kind"], f["file"]) for f in findings(tmp_path, capsys, 3)}


def files_of(folder: Path) -> dict[str, bytes]:
    """What a web server has of a folder, by the path of its addresses."""
    found = {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return {quote(str(path)): data for path, data in found.items()}


def test_a_set_on_a_web_server(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Verify a set by its address: what is fetched is said, and what a server cannot tell, too."""
    with serving() as web:
        web.files = {f"sets/{path}": data for path, data in files_of(made).items()}
        address = f"{web.address}/sets?signature=secret"
        assert main(["verify", address]) == 0
        told = capsys.readouterr()
        assert "fetching 7 files" in told.err
        assert "not looked at: whether there are files that manifest.json does not name" in told.out
        assert "secret" not in told.out + told.err
        web.files["sets/notes.txt"] = b"other\n"
        (found,) = findings(f"{web.address}/sets/", capsys, 3)
        assert (found["kind"], found["file"]) == ("changed", "notes.txt")
        del web.files["sets/notes.txt"]
        (found,) = findings(f"{web.address}/sets", capsys, 3)
        assert found["kind"] == "missing"
        assert main(["verify", f"{web.address}/sets", "--limit", "1e-6"]) == 2
        assert "--limit" in capsys.readouterr().err
        assert main(["verify", f"{web.address}/none"]) == 3


def test_a_file_that_grew_is_not_fetched(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Fetch nothing of a file whose size is not that of the manifest."""
    with serving() as web:
        web.files = {
            str(p.relative_to(made)).replace(" ", "%20"): p.read_bytes() for p in made.rglob("*") if p.is_file()
        }
        web.files["below/a%20b.mcap"] += bytes(8 << 20)
        web.forget()
        (found,) = findings(web.address, capsys, 3)
        assert found["file"] == "below/a b.mcap"
        assert web.sent < 8 << 20


def test_a_set_on_another_file_system(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Verify a set where files can be listed: one that the manifest does not name is found."""
    system = fsspec.filesystem("memory")
    for path in made.rglob("*"):
        if path.is_file():
            system.pipe_file(f"/some/set/{path.relative_to(made)}", path.read_bytes())
    assert main(["verify", "memory://some/set"]) == 0, capsys.readouterr().out
    system.pipe_file("/some/set/below/more.mcap", b"x")
    assert [(f["kind"], f["file"]) for f in findings("memory://some/set", capsys, 4)] == [
        ("not named", "below/more.mcap")
    ]


@pytest.mark.parametrize(
    ("base", "expected"),
    [
        ("https://a.org/set?sig=1", "https://a.org/set/b%20c.mcap?sig=1"),
        ("hf://datasets/a/b", "hf://datasets/a/b/b c.mcap"),
        ("zip://::https://a.org/set.zip", "zip://b c.mcap::https://a.org/set.zip"),
        ("zip://in::file:///x.zip", "zip://in/b c.mcap::file:///x.zip"),
    ],
)
def test_addresses_of_files(base: str, expected: str) -> None:
    """Put a path behind the address of a folder, before its query and within its archive."""
    assert child(Location(base), "b c.mcap").url == expected


def _manifest(**changed: Any) -> dict[str, Any]:
    digest = "0" * 64
    return {
        "schema_version": 2, "kind": "gpusimbench set of recordings", "title": "t", "licence": "MIT",
        "sample_time_s": 5.0, "content_sha256": digest, "rules": "integrity-1", "written_by": {},
        "files": [{"path": "a.mcap", "bytes": 1, "sha256": digest}], "written": [],
        **changed,
    }  # fmt: skip


def _file(path: str, **changed: Any) -> dict[str, Any]:
    return _manifest(files=[{"path": path, "bytes": 1, "sha256": "0" * 64, **changed}])


HOSTILE = {
    "parent": _file("../a.mcap"),
    "parent within": _file("b/../../a.mcap"),
    "absolute": _file("/etc/passwd"),
    "windows": _file("C:\\x.mcap"),
    "backslash": _file("..\\a.mcap"),
    "hidden": _file(".ssh/id"),
    "empty": _file(""),
    "itself": _file("manifest.json"),
    "sums": _file("sha256sums"),
    "long": _file("a" * 10_000),
    "deep path": _file("/".join("a" * 100)),
    "line feed": _file("a\nb"),
    "surrogate": _file("a\ud800"),
    "right to left": _file("a\u202egnp.mcap"),
    "huge": _file("a.mcap", bytes=10**30),
    "negative": _file("a.mcap", bytes=-1),
    "a truth": _file("a.mcap", bytes=True),
    "a fraction": _file("a.mcap", bytes=1.5),
    "short digest": _file("a.mcap", sha256="0"),
    "digest in capitals": _file("a.mcap", sha256="A" * 64),
    "no list": _manifest(files={}),
    "texts": _manifest(files=["a"]),
    "twice": _manifest(files=_file("a.mcap")["files"] * 2),
    "collision": _manifest(files=[*_file("a.mcap")["files"], *_file("A.mcap")["files"]]),
    "accents": _manifest(files=[*_file("\u00e9")["files"], *_file("e\u0301")["files"]]),
    "many": _manifest(files=_file("a")["files"] * 20_001),
    "time": _manifest(sample_time_s=1e300),
    "no time": _manifest(sample_time_s=0),
    "other version": _manifest(schema_version=3),
    "older version": _manifest(schema_version=1),
    "other kind": _manifest(kind="something"),
    "recording": _file("a.mcap", recording=[]),
    "outcome": _file(
        "a.mcap",
        recording={
            "content_hash": "",
            "run_id": "",
            "status": "",
            "reason": "",
            "group": "",
            "check": "fine",
            "findings": [],
        },
    ),  # fmt: skip
}


@pytest.mark.parametrize("manifest", HOSTILE.values(), ids=HOSTILE.keys())
def test_hostile_manifests_are_refused(
    manifest: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refuse a manifest that leads elsewhere or says what cannot be, in one line, before any file is looked at."""
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    assert main(["verify", str(tmp_path)]) == 3
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert "manifest.json" in said.err
    assert len(said.err) < 600


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{", "nothing", '{"kind": NaN}', "[" * 100_000, '{"a":' * 100_000, '{"a": 1, "a": 1}', "\ufeff{}",
        '{"kind": "gpusimbench set of recordings", "kind": "gpusimbench set of recordings"}', " " * (17 << 20),
        '{"n": ' + "9" * 5000 + "}",
    ],
    ids=range(12),
)  # fmt: skip
def test_what_is_no_manifest_is_refused(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse what is no JSON, nests without end, has a key twice or is too large."""
    (tmp_path / "manifest.json").write_text(text)
    assert main(["verify", str(tmp_path)]) == 3
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_key_that_is_there_twice_is_refused() -> None:
    """Refuse two readings of one manifest, however deep."""
    text = json.dumps(_manifest()).replace('"bytes": 1', '"bytes": 1, "bytes": 2')
    with pytest.raises(DamagedRecording, match="twice"):
        load_manifest(text.encode())


def test_no_set_is_no_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Say what to do with a folder that nobody described, and refuse what is no folder."""
    assert main(["verify", str(tmp_path)]) == 3
    assert "gsb-share card" in capsys.readouterr().err
    assert main(["verify", str(tmp_path / "none")]) == 2


@pytest.mark.parametrize("arguments", [["--limit", "0"], ["--tolerance", "-1"], ["--tolerance", "nan"]])
def test_numbers_that_cannot_be(made: Path, arguments: list[str]) -> None:
    """Refuse limits and tolerances that are none."""
    assert main(["verify", str(made), *arguments]) == 2
