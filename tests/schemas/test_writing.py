"""The one writer of files: whole or not at all, and never through a link."""

from __future__ import annotations

import ast
import errno
import os
import re
import secrets
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from gpusimbench.schemas import writing
from gpusimbench.schemas.errors import GsbError, UsageError
from tests.limits import full_disk

_ROOT = Path(__file__).parents[2]
_MODE = re.compile(r"[rbt]*[wax+][rwaxbt+]*")
_WRITER = _ROOT / "schemas" / "writing.py"


def test_a_full_disk_leaves_the_earlier_file(tmp_path: Path) -> None:
    """Keep what was there, leave nothing beside it, and say why in one line."""
    path = tmp_path / "result.json"
    writing.write_file(path, "earlier")
    with full_disk(100), pytest.raises(GsbError, match=r"cannot write .*result\.json: File too large"):
        writing.write_file(path, "x" * 101)
    assert path.read_text() == "earlier"
    assert os.listdir(tmp_path) == ["result.json"]


@pytest.mark.parametrize("durable", [True, False])
def test_what_is_to_last_is_flushed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, durable: bool) -> None:
    """Flush a file before it gets its name, and its folder afterwards; neither of what can be made again."""
    flush, flushed = os.fsync, []

    def noted(descriptor: int) -> None:
        flushed.append((os.path.isdir(descriptor), (tmp_path / "a").exists()))
        flush(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    writing.write_file(tmp_path / "a", b"text", durable=durable)
    assert flushed == ([(False, False), (True, True)] if durable else [])


def test_several_files_are_one_result(tmp_path: Path) -> None:
    """Change none of them where the last one does not fit."""
    (tmp_path / "a").write_text("earlier")
    files = {tmp_path / "a": "new", tmp_path / "b" / "c": "new", tmp_path / "d": "x" * 200}
    with full_disk(100), pytest.raises(GsbError, match="cannot write"):
        writing.write_files(files)
    assert {p.name: p.read_text() for p in tmp_path.rglob("*") if p.is_file()} == {"a": "earlier"}
    writing.write_files(files)
    assert {p: p.read_text() for p in tmp_path.rglob("*") if p.is_file()} == files


@pytest.mark.parametrize("links", [True, False])
@pytest.mark.parametrize("failing", [1, 2, 3])
def test_names_are_given_to_all_or_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int, links: bool
) -> None:
    """Take back the names that were given before one could not be; without links, lose no file at least."""
    (tmp_path / "a").write_text("earlier a")
    (tmp_path / "c").write_text("earlier c")
    done, replace = 0, os.replace

    def fail(source: Path, target: Path) -> None:
        nonlocal done
        done += 1
        if done == failing:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        replace(source, target)

    def no_links(*_: object, **__: object) -> None:
        raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))

    monkeypatch.setattr(os, "replace", fail)
    if not links:
        monkeypatch.setattr(os, "link", no_links)
    with pytest.raises(GsbError, match="Input/output error"):
        writing.write_files({tmp_path / name: f"new {name}" for name in "abc"})
    found = {p.name: p.read_text() for p in tmp_path.iterdir()}
    if links:
        assert found == {"a": "earlier a", "c": "earlier c"}
    else:
        assert found == {"a": "earlier a" if failing == 1 else "new a", "c": "earlier c"}


def test_links_are_not_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write through no link, neither under the final name nor under a temporary one that somebody guessed."""
    victim = tmp_path / "victim"
    victim.write_text("mine")
    guesses = iter(["guessed", "other", "third"])
    monkeypatch.setattr(secrets, "token_hex", lambda _: next(guesses))
    (tmp_path / ".gsb-guessed.partial").symlink_to(victim)
    (tmp_path / "result").symlink_to(victim)
    writing.write_file(tmp_path / "result", "new")
    assert victim.read_text() == "mine"
    assert (tmp_path / "result").read_text() == "new"
    assert not (tmp_path / "result").is_symlink()
    (tmp_path / "free").symlink_to(tmp_path / "nowhere")
    with pytest.raises(UsageError, match="exists already"):
        writing.write_new(tmp_path / "free", b"new")
    for opened in (writing.create, writing.reopen, writing.open_lock):
        with pytest.raises(OSError):
            opened(tmp_path / "free")
    assert not (tmp_path / "nowhere").exists()


def test_what_is_no_file_is_written_to(tmp_path: Path) -> None:
    """Write into a pipe and a device, which no file replaces."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    found: list[str] = []
    reader = threading.Thread(target=lambda: found.append(pipe.read_text()))
    reader.start()
    writing.write_file(pipe, "text")
    reader.join()
    assert found == ["text"]
    assert pipe.is_fifo()
    writing.write_file(Path(os.devnull), "text")
    assert Path(os.devnull).is_char_device()
    with (tmp_path / "output").open("w") as output:
        writing.write_file(Path(f"/dev/fd/{output.fileno()}"), "text")
    assert (tmp_path / "output").read_text() == "text"
    assert sorted(os.listdir(tmp_path)) == ["output", "pipe"]


def test_long_names_and_names_that_are_no_text(tmp_path: Path) -> None:
    """Write under every name that a folder takes."""
    for name in ("n" * 255, "caf\udce9"):
        writing.write_file(tmp_path / name, "caf\udce9")
        assert (tmp_path / name).read_text() == "caf\\udce9"


def test_rights_are_those_of_any_new_file(tmp_path: Path) -> None:
    """Let others read what the user's umask lets them read."""
    (tmp_path / "usual").touch()
    writing.write_file(tmp_path / "ours", b"")
    os.close(writing.open_lock(tmp_path / "lock"))
    for name in ("ours", "lock"):
        assert (tmp_path / name).stat().st_mode == (tmp_path / "usual").stat().st_mode


def _writes(tree: ast.AST) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        texts = [a.value for a in (*node.args, *(k.value for k in node.keywords)) if isinstance(a, ast.Constant)]
        said = {n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute)}
        of_os = isinstance(node.func, ast.Attribute) and getattr(node.func.value, "id", "") == "os"
        if name in {"write_text", "write_bytes", "touch", "NamedTemporaryFile", "copyfile", "copy2"}:
            yield node
        elif of_os and name == "open":
            if said & {"O_CREAT", "O_RDWR", "O_TRUNC", "O_WRONLY"} and not said & {"devnull", "O_APPEND"}:
                yield node
        elif (
            of_os
            and name in {"rename", "replace", "link", "symlink"}
            or name in {"open", "FileIO"}
            and any(isinstance(text, str) and _MODE.fullmatch(text) for text in texts)
        ):
            yield node


def test_there_is_no_other_writer() -> None:
    """Write no file but by the writer, whose functions are all safe; what this test finds goes there."""
    found = [
        f"{path.relative_to(_ROOT)}:{call.lineno}"
        for package in ("evaluator", "recorder", "schemas")
        for path in sorted((_ROOT / package).rglob("*.py"))
        if path not in (_WRITER, _ROOT / "schemas" / "build_descriptors.py")
        for call in _writes(ast.parse(path.read_bytes()))
    ]
    assert found == []


@pytest.mark.parametrize(
    "code",
    ["Path(p).write_text('')", "open(p, 'w')", "p.open('xb')", "open(p, mode='r+b')", "os.open(p, os.O_CREAT)",
     "os.replace(p, q)", "FileIO(p, 'w')"],
)  # fmt: skip
def test_other_writers_are_found(code: str) -> None:
    """See each way to write a file."""
    assert list(_writes(ast.parse(code)))
