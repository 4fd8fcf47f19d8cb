"""Describing a folder of recordings: a card, tables, checksums, a manifest; never over anything of somebody else."""

from __future__ import annotations

import html
import json
import re
import shutil
from pathlib import Path
from typing import Any

import polars as pl
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.cli.share import main
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.share.dataset.citation import HUB_NAMES, check_licence, parse_author
from gpusimbench.evaluator.share.dataset.contents import identity, why_not
from gpusimbench.schemas.errors import UsageError
from tests.conftest import call, finished, run_python
from tests.evaluator.sets import WHEN, WORDS, described
from tests.synthetic import changing, grid, write_recording

OURS = {"README.md", "CITATION.cff", "metrics.parquet", "runs.parquet", "manifest.json", "SHA256SUMS"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, small_set: list[Path]) -> Path:
    """Three real runs and a file of another kind, in folders, described; must not be written to."""
    folder = tmp_path_factory.mktemp("described")
    (folder / "deep" / "er").mkdir(parents=True)
    shutil.copy(small_set[0], folder / "deep" / "er")
    (folder / "record.sh").write_text("gsb-record\n")
    (folder / ".gitattributes").write_text("*.mcap filter=lfs\n")
    return described(folder, small_set[1:])


def words_of(card: Path) -> str:
    """A card as its reader sees it: character references as the characters that they stand for."""
    return html.unescape(card.read_text()).replace("\u200b", "")


def front_matter(card: Path) -> dict[str, Any]:
    """The YAML at the top of a card."""
    _, head, _ = card.read_text().split("---\n", 2)
    return yaml.safe_load(head)


def test_sums_are_those_of_sha256sum(made: Path) -> None:
    """Have sha256sum itself check every file but the list."""
    done = finished(["sha256sum", "--strict", "-c", "SHA256SUMS"], cwd=made)
    files = {str(p.relative_to(made)) for p in made.rglob("*") if p.is_file()} - {"SHA256SUMS", ".gitattributes"}
    assert {line.partition(": ")[0] for line in done.stdout.splitlines()} == files
    assert {name.rpartition("/")[2] for name in files} >= OURS - {"SHA256SUMS"}


def test_the_front_matter_is_what_the_hub_reads(made: Path) -> None:
    """Keep to the Hub's names, and point its viewer at tables that are there."""
    head = front_matter(made / "README.md")
    assert head["license"] == "cc-by-4.0"
    assert head["pretty_name"] == "Three short runs"
    assert head["task_categories"] == ["robotics"]
    assert head["size_categories"] == ["n<1K"]
    assert all(isinstance(tag, str) for tag in head["tags"])
    assert [config["config_name"] for config in head["configs"]] == ["metrics", "runs"]
    assert [config.get("default") for config in head["configs"]] == [True, None]
    for config in head["configs"]:
        (data,) = config["data_files"]
        assert pl.read_parquet(made / data["path"]).height > 0


def test_the_card_says_what_the_recordings_say(made: Path, small_set: list[Path]) -> None:
    """Show the group, its throughput, the machine, the command, and how to check and replay."""
    text = words_of(made / "README.md")
    (result,) = evaluate_files(small_set, sample_time=1.0).results
    assert f"{result.metrics['fps'].value:,.0f}" in text
    assert f"| mujoco | {result.group.key.version} |" in text
    assert "4 x 3" in text
    assert "gsb-record --sim mujoco --n-env 4 --runs 3" in text
    assert "gsb-share verify ." in text
    assert f"gsb-audit deep/er/{small_set[0].name}" in text
    assert text.count("sha256:") == 1
    assert not re.search(r"\b(20[0-9]{2})-\d\d-\d\dT", text.replace(str(made), ""))


def test_the_manifest_names_every_file(made: Path) -> None:
    """Give each recording its hash, its run, its group and what the rules say; paths with /."""
    manifest = json.loads((made / "manifest.json").read_text())
    assert manifest["schema_version"] == 2
    assert manifest["written_by"]["gpusimbench"]
    paths = [file["path"] for file in manifest["files"]]
    assert paths == sorted(paths)
    assert "record.sh" in paths
    recordings = [file["recording"] for file in manifest["files"] if "recording" in file]
    assert len(recordings) == 3
    assert {one["check"] for one in recordings} == {"whole"}
    assert {one["group"] for one in recordings} == {"mujoco"}
    assert manifest["content_sha256"] == identity([one["content_hash"] for one in recordings])
    assert {file["path"] for file in manifest["written"]} == OURS - {"manifest.json", "SHA256SUMS"}


def test_the_tables_name_files_as_the_set_does(made: Path) -> None:
    """Have paths in the table that are those of the set, on whatever machine it was made."""
    runs = pl.read_parquet(made / "runs.parquet")
    named = {file["path"] for file in json.loads((made / "manifest.json").read_text())["files"] if "recording" in file}
    assert set(runs["file"]) == named


def test_the_same_folder_gives_the_same_bytes(made: Path, tmp_path: Path) -> None:
    """Describe a copy elsewhere: every file is the same."""
    copy = tmp_path / "copy"
    shutil.copytree(made, copy, ignore=lambda _, names: [name for name in names if name in OURS])
    described(copy, [])
    for name in OURS:
        assert (copy / name).read_bytes() == (made / name).read_bytes(), name


CFF = {
    "type": "object",
    "additionalProperties": False,
    "required": ["authors", "cff-version", "message", "title"],
    "properties": {
        "cff-version": {"const": "1.2.0"},
        "type": {"enum": ["dataset", "software"]},
        "title": {"type": "string", "minLength": 1},
        "message": {"type": "string", "minLength": 1},
        "abstract": {"type": "string", "minLength": 1},
        "license": {"enum": sorted(HUB_NAMES)},
        "doi": {"type": "string", "pattern": r"^10\.\d{4,9}(\.\d+)?/[A-Za-z0-9:/_;\-\.\(\)\[\]\\]+$"},
        "url": {"type": "string", "pattern": "^(https|http|ftp|sftp)://.+"},
        "keywords": {"type": "array", "minItems": 1, "uniqueItems": True, "items": {"type": "string", "minLength": 1}},
        "identifiers": {
            "type": "array",
            "items": {
                "type": "object",
                "additionalProperties": False,
                "required": ["type", "value"],
                "properties": {
                    "type": {"const": "other"},
                    "value": {"type": "string", "minLength": 1},
                    "description": {"type": "string", "minLength": 1},
                },
            },
        },
        "authors": {
            "type": "array",
            "minItems": 1,
            "uniqueItems": True,
            "items": {
                "anyOf": [
                    {
                        "type": "object",
                        "additionalProperties": False,
                        "properties": {
                            "family-names": {"type": "string", "minLength": 1},
                            "given-names": {"type": "string", "minLength": 1},
                            "affiliation": {"type": "string", "minLength": 1},
                            "orcid": {
                                "type": "string",
                                "pattern": "https://orcid\\.org/[0-9]{4}-[0-9]{4}-[0-9]{4}-[0-9]{3}[0-9X]{1}",
                            },
                        },
                    },
                    {
                        "type": "object",
                        "additionalProperties": False,
                        "required": ["name"],
                        "properties": {"name": {"type": "string", "minLength": 1}, "orcid": {"type": "string"}},
                    },
                ]
            },
        },
    },
}
"""What the schema of Citation File Format 1.2.0 asks of the keys that are written here."""


def test_the_citation_is_valid(tmp_path: Path, small: Path) -> None:
    """Hold CITATION.cff against the format's schema, with everything that can be given."""
    import jsonschema

    described(
        tmp_path / "set", [small],
        "--author", "Lovelace, Ada: \"Countess\"; Analytical Engines; 0000-0002-1825-0097",
        "--author", "Some Laboratory",
        "--doi", "https://doi.org/10.5281/zenodo.1003150",
        "--url", "https://example.org/set",
    )  # fmt: skip
    found = yaml.safe_load((tmp_path / "set" / "CITATION.cff").read_text())
    jsonschema.validate(found, CFF)
    assert found["doi"] == "10.5281/zenodo.1003150"
    assert [author.get("name") for author in found["authors"]] == [None, None, "Some Laboratory"]
    assert found["authors"][1]["given-names"] == 'Ada: "Countess"'
    assert found["authors"][1]["orcid"] == "https://orcid.org/0000-0002-1825-0097"


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ("--licence", "CC-BY-4.0"),
        ("--author", "--author 'Family, Given'"),
        ("--title", "--title"),
    ],
)
def test_what_nobody_else_knows_is_asked_for(
    tmp_path: Path, small: Path, capsys: pytest.CaptureFixture[str], missing: str, said: str
) -> None:
    """Refuse to make up a licence, an author or a name, and write nothing."""
    shutil.copy(small, tmp_path)
    words = [word for pair in zip(WORDS[::2], WORDS[1::2], strict=True) if pair[0] != missing for word in pair]
    assert main(["card", str(tmp_path), *words]) == 2
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [small.name]


def test_every_licence_has_a_name_at_the_hub() -> None:
    """Take identifiers however they are written, and refuse those that nobody knows."""
    assert check_licence("cc-by-4.0") == "CC-BY-4.0"
    assert check_licence("LicenseRef-Our-Terms.1") == "LicenseRef-Our-Terms.1"
    for wrong in ("CC", "LicenseRef-", "mine", "LicenseRef-a b"):
        with pytest.raises(UsageError):
            check_licence(wrong)
    assert all(re.fullmatch(r"[a-z0-9.-]+", name) for name in HUB_NAMES.values())


def test_terms_of_ones_own_need_their_text(tmp_path: Path, small: Path) -> None:
    """Want the file LICENSE with a licence that is in no list, and say so to the Hub."""
    shutil.copy(small, tmp_path)
    asked = ["card", str(tmp_path), *WORDS, *WHEN, "--licence", "LicenseRef-Ours"]
    assert main(asked) == 2
    (tmp_path / "LICENSE").write_text("You may look.\n")
    assert main(asked) == 0
    head = front_matter(tmp_path / "README.md")
    assert (head["license"], head["license_name"], head["license_link"]) == ("other", "licenseref-ours", "LICENSE")
    assert "license" not in yaml.safe_load((tmp_path / "CITATION.cff").read_text())


def test_files_of_somebody_are_not_overwritten(tmp_path: Path, small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refuse a README of the folder's own, and one that was written here and changed since."""
    shutil.copy(small, tmp_path)
    (tmp_path / "README.md").write_text("my words\n")
    for more in ([], ["--update"]):
        assert main(["card", str(tmp_path), *WORDS, *WHEN, *more]) == 2
        assert "README.md" in capsys.readouterr().err
    assert (tmp_path / "README.md").read_text() == "my words\n"
    (tmp_path / "README.md").unlink()
    described(tmp_path, [])
    assert main(["card", str(tmp_path), *WORDS, *WHEN]) == 2
    assert "--update" in capsys.readouterr().err
    (tmp_path / "README.md").write_text("my words\n")
    assert main(["card", str(tmp_path), *WORDS, *WHEN, "--update"]) == 2
    assert "changed since" in capsys.readouterr().err
    assert (tmp_path / "README.md").read_text() == "my words\n"


def test_what_was_written_is_refreshed(
    tmp_path: Path, small_set: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Describe a folder anew after a recording was added, and with words of the publisher; then nothing is new."""
    described(tmp_path / "set", small_set[:1])
    shutil.copy(small_set[1], tmp_path / "set")
    (tmp_path / "about.md").write_text("We did **this** by hand.\n")
    described(tmp_path / "set", [], "--update", "--about", str(tmp_path / "about.md"))
    text = (tmp_path / "set" / "README.md").read_text()
    assert "We did **this** by hand." in text
    assert "2 recordings of" in text
    capsys.readouterr()
    described(tmp_path / "set", [], "--update", "--about", str(tmp_path / "about.md"))
    assert "nothing to write" in capsys.readouterr().out


def test_a_set_of_an_earlier_version_is_written_anew(
    tmp_path: Path, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Do what gsb-share verify says of a manifest of an earlier version; leave one of a later version as it is."""
    described(tmp_path, [small])
    manifest = tmp_path / "manifest.json"
    now = manifest.read_text()
    for version in (1, 3):
        manifest.write_text(now.replace('"schema_version": 2', f'"schema_version": {version}'))
        assert main(["verify", str(tmp_path)]) == 3
        assert f"schema version {version}, and 2 is known here" in capsys.readouterr().err
        assert main(["card", str(tmp_path), *WORDS, *WHEN, "--update"]) == (0 if version == 1 else 3)
        assert (manifest.read_text() == now) == (version == 1)


def test_damaged_recordings_are_named(
    tmp_path: Path, small_set: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Name a damaged file in card and manifest, compute nothing from it, and end with 3; name failed runs, too."""
    described(tmp_path, small_set[:2])
    data = bytearray(small_set[2].read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "broken.mcap").write_bytes(data)
    (tmp_path / "crashed.mcap.partial").write_bytes(data[: len(data) // 3])
    write_recording(tmp_path, None, status="FAILED", reason="no memory | at all", name="failed.mcap")
    assert main(["card", str(tmp_path), *WORDS, *WHEN, "--update"]) == 3
    said = capsys.readouterr().err
    assert "broken.mcap is damaged" in said
    assert "crashed.mcap.partial is damaged" in said
    files = json.loads((tmp_path / "manifest.json").read_text())["files"]
    found = {file["path"]: file["recording"] for file in files}
    assert found["broken.mcap"]["check"] == "damaged"
    assert found["broken.mcap"]["findings"]
    assert found["failed.mcap"]["status"] == "failed"
    card = words_of(tmp_path / "README.md")
    assert "## Problems" in card
    assert re.search(r"\| broken.mcap \| damaged \| .+ \|", card)
    assert "| failed.mcap | failed | no memory | at all |" in card
    assert "no memory &#124; at all" in (tmp_path / "README.md").read_text()
    assert "4 x 2" in card
    assert str(tmp_path) not in card + (tmp_path / "manifest.json").read_text()


def test_what_may_be_personal_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Warn of home folders and addresses of mail that recordings hold, with how many of them."""

    environment = {"XLA_FLAGS": "--x=/Users/joe/y", "JAX_NOTE": "jane@example.org"}
    argv = ["gsb-record", "--out", "/home/jane/runs"]
    change = changing("provenance.json", argv=argv, environment=environment)
    for run in range(2):
        write_recording(tmp_path, grid(1), run=run, change=change)
    main(["card", str(tmp_path), *WORDS])
    said = capsys.readouterr().err
    for text in ("/home/jane/runs", "/Users/joe/y", "jane@example.org"):
        assert re.search(rf"2 recordings with a \S+ .*{re.escape(text)}, in provenance.json", said)


@pytest.mark.parametrize("name", ["back\\slash.mcap", "col:on.mcap", "line\nfeed.mcap"])
def test_names_that_mean_something_elsewhere_are_refused(
    tmp_path: Path, small: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """Refuse names that another system takes for a path, and those that a list of digests cannot hold."""
    shutil.copy(small, tmp_path / name)
    assert main(["card", str(tmp_path), *WORDS]) == 2
    assert "rename it" in capsys.readouterr().err


def test_links_and_names_that_collide_are_refused(
    tmp_path: Path, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refuse a link out of the folder, and two names that are one on some systems."""
    (tmp_path / "set").mkdir()
    shutil.copy(small, tmp_path / "set" / "a.mcap")
    (tmp_path / "set" / "b.mcap").symlink_to(small)
    assert main(["card", str(tmp_path / "set"), *WORDS]) == 2
    assert "b.mcap" in capsys.readouterr().err
    (tmp_path / "set" / "b.mcap").unlink()
    shutil.copy(small, tmp_path / "set" / "A.mcap")
    assert main(["card", str(tmp_path / "set"), *WORDS]) == 2
    assert "one file on some systems" in capsys.readouterr().err


def test_a_folder_without_recordings_is_nothing(tmp_path: Path) -> None:
    """End with 5 where there is nothing to describe, and with 2 where there is no folder."""
    assert main(["card", str(tmp_path), *WORDS]) == 5
    assert main(["card", str(tmp_path / "none"), *WORDS]) == 2


HOSTILE = "<script>alert(1)</script> [x](http://evil) `a` | b\n# c @all www.evil.org ![](x) \x1b[2J"


def test_text_of_strangers_is_no_markup(tmp_path: Path) -> None:
    """Show simulators, reasons and commands of a stranger as text: no link, no tag, no cell of its own."""

    change = changing("provenance.json", argv=["gsb-record", "```\n# out", HOSTILE])
    write_recording(tmp_path, grid(1), simulator=HOSTILE, name="a.mcap", change=change)
    write_recording(tmp_path, None, simulator="b", status="FAILED", reason=HOSTILE, name="=1+1.mcap", run=1)
    main(["card", str(tmp_path), *WORDS])
    card = (tmp_path / "README.md").read_text()
    prose, block, _ = re.split(r"^````$", card, flags=re.MULTILINE)
    assert "```" in block
    assert "<script" not in prose
    assert not re.search(r"(?<!\\)\]\(http://evil", prose)
    assert "://evil" not in prose
    assert "\x1b" not in card
    assert "@all" not in prose
    tables = re.findall(r"(?:^\|.*\n)+", prose, flags=re.MULTILINE)
    assert len(tables) == 3  # problems, one scene, machines
    assert all(len({row.count("|") for row in one.splitlines()}) == 1 for one in tables)
    yaml.safe_load((tmp_path / "CITATION.cff").read_text())


@given(st.text(max_size=40))
def test_a_name_that_is_taken_stays_in_its_folder(path: str) -> None:
    """Let no path of a set lead out of the folder that it is put into."""
    if not why_not(path):
        root = Path("/set")
        assert (root / path).is_relative_to(root)
        assert ".." not in (root / path).parts
        assert not Path(path).is_absolute()


def test_authors_are_names() -> None:
    """Tell persons from organisations, check ORCIDs by their digit, and refuse what is neither."""
    assert parse_author("Doe, Jane").shown == "Jane Doe"
    assert parse_author("Doe, Jane; Lab").affiliation == "Lab"
    for wrong in ("", ", Jane", "a;b;c;d", "Doe, Jane; Lab; 0000-0002-1825-0098", "Doe, Jane; ; x", "a\nb"):
        with pytest.raises(UsageError):
            parse_author(wrong)


def test_the_command_as_it_is_installed(tmp_path: Path, small: Path) -> None:
    """Describe and verify in processes of their own, from another folder."""
    shutil.copy(small, tmp_path)
    done = call("gsb-share", "card", ".", *WORDS, *WHEN, cwd=tmp_path, code=0)
    assert "1 recording in 1 group" in done.stdout
    call("gsb-share", "verify", ".", cwd=tmp_path, code=0)


def test_polars_is_asked_for_before_any_work(tmp_path: Path, small: Path) -> None:
    """Say which package is missing, with how to get it, and write nothing."""
    shutil.copy(small, tmp_path)
    code = (
        "import sys\nsys.modules['polars'] = None\nfrom gpusimbench.evaluator.cli.share import main\n"
        f"sys.exit(main({['card', str(tmp_path), *WORDS]!r}))"
    )
    done = run_python(code, code=2)
    assert "gpusimbench[tables]" in done.stderr
    assert len(list(tmp_path.iterdir())) == 1
