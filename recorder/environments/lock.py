"""``python -m gpusimbench.recorder.environments.lock --index URL [NAME...]``: NAME.in to NAME.txt.

uv resolves each for every Python of its specification, and an index in PEP 503's form tells the hashes. Only files for
Linux and these Pythons are kept: a hash for every platform would be ten times as much text.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import urllib.request
from functools import cache
from html import unescape
from urllib.parse import unquote

from packaging.requirements import Requirement
from packaging.tags import Tag
from packaging.utils import InvalidWheelFilename, canonicalize_name, parse_wheel_filename

from gpusimbench.recorder.environments.store import SPECIFICATIONS, Specification
from gpusimbench.schemas.writing import write_file

_HEAD = """\
# Made by recorder/environments/lock.py from {source}: not to be edited.
# Installed with --no-deps --require-hashes{beforehand}.
"""

_LINK = re.compile(r'href="[^"]*/([^"/#]+)#sha256=([0-9a-f]{64})"')
_MACHINES = ("x86_64", "aarch64")
_CUDA = re.compile(r"^(nvidia-(?!ml-py)|cuda-|triton$|torch$|torchvision$)")
"""What comes with a build of torch, whichever it is."""


def lock(specification: Specification, index: str) -> str:
    """The text of a requirements file."""
    lines = []
    for requirement in _resolved(specification):
        name = canonicalize_name(requirement.name)
        if specification.beforehand and _CUDA.match(name):
            continue
        version = next(iter(requirement.specifier)).version
        hashes = _hashes(index, name, version, specification)
        if not hashes:
            raise SystemExit(f"{name} {version}: the index has no file of it for Linux and these Pythons")
        marker = f" ; {requirement.marker}" if requirement.marker else ""
        lines.append(" \\\n".join([f"{name}=={version}{marker}", *(f"    --hash=sha256:{h}" for h in hashes)]))
    first = f", after {', '.join(specification.beforehand)}" if specification.beforehand else ""
    head = _HEAD.format(source=f"{specification.simulator}.in", beforehand=first)
    return head + "\n".join(lines) + "\n"


def _resolved(specification: Specification) -> list[Requirement]:
    source = specification.requirements.with_suffix(".in")
    text = source.read_text() + "\n".join(specification.beforehand) + "\n"
    oldest, newest = min(specification.pythons), max(specification.pythons)
    command = ["uv", "pip", "compile", "-", "--quiet", "--universal", "--no-header", "--no-annotate"]
    command += ["--python-version", f"3.{oldest}"]
    if "# no-deps" in text:
        command.append("--no-deps")
    try:
        done = subprocess.run(command, input=text, capture_output=True, text=True)
    except FileNotFoundError:
        raise SystemExit("uv is not on PATH: pip install uv") from None
    if done.returncode:
        raise SystemExit(f"{source.name}: {done.stderr.strip()}")
    found = [Requirement(line) for line in done.stdout.splitlines() if line and not line.startswith("#")]
    places = [
        {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": machine, "os_name": "posix",
         "python_version": f"3.{minor}", "python_full_version": f"3.{minor}.0", "implementation_name": "cpython",
         "platform_python_implementation": "CPython", "extra": ""}
        for minor in range(oldest, newest + 1) for machine in _MACHINES
    ]  # fmt: skip
    return [r for r in found if r.marker is None or any(r.marker.evaluate(place) for place in places)]


def _hashes(index: str, name: str, version: str, specification: Specification) -> list[str]:
    files = {unquote(unescape(file)): digest for file, digest in _LINK.findall(_page(index, name))}
    wheels = {digest for file, digest in files.items() if _fits(file, version, specification)}
    if wheels:
        return sorted(wheels)
    sdist = re.compile(rf"{re.escape(name).replace('-', '[-_.]')}-{re.escape(version)}\.tar\.gz", re.IGNORECASE)
    return sorted(digest for file, digest in files.items() if sdist.fullmatch(file.replace("\\", "")))


def _fits(file: str, version: str, specification: Specification) -> bool:
    if not file.endswith(".whl"):
        return False
    try:
        _, found, _, tags = parse_wheel_filename(file)
    except InvalidWheelFilename:
        return False
    return str(found) == version and any(_usable(tag, specification) for tag in tags)


def _usable(tag: Tag, specification: Specification) -> bool:
    platform = tag.platform == "any" or ("linux" in tag.platform and tag.platform.endswith(_MACHINES))
    exact = tag.interpreter in {f"cp3{minor}" for minor in specification.pythons} and not tag.abi.endswith("t")
    stable = tag.abi == "abi3" or tag.interpreter in ("py3", "py2") or tag.interpreter.startswith("py3")
    return platform and "musl" not in tag.platform and (exact or stable)


@cache
def _page(index: str, name: str) -> str:
    with urllib.request.urlopen(f"{index.rstrip('/')}/{name}/", timeout=60) as page:
        text: str = page.read().decode()
    return text


def main() -> int:
    """Entry point."""
    p = argparse.ArgumentParser(prog="python -m gpusimbench.recorder.environments.lock", description=__doc__)
    p.add_argument("--index", required=True, metavar="URL", help="simple index that has hashes in its links (PEP 503)")
    p.add_argument("simulators", nargs="*", metavar="NAME", default=list(SPECIFICATIONS), help="default: all")
    arguments = p.parse_args()
    for name in arguments.simulators:
        specification = SPECIFICATIONS[name]
        write_file(specification.requirements, lock(specification, arguments.index))
        sys.stderr.write(f"{specification.requirements.name}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
