"""Spoil recordings where a reader's branches are, and hold four ways to read them against each other.

    pip install atheris
    python -m tests.hostile.fuzz --seconds 3600 --keep found/

Prints a line for each finding and how many files were read at the end; exits with 1 where there was one. What was found
is under --keep; mend the fault, and put the file into tests/hostile/found/, which test_found.py reads.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import random
import re
import struct
import sys
import tempfile
import time
import traceback
from pathlib import Path

_KINDS = 200  # of findings that are kept
_LONGEST = 1 << 18
_TELL_S = 300.0


def main(argv: list[str] | None = None) -> int:
    """Entry point; libFuzzer ends the process itself."""
    p = argparse.ArgumentParser(prog="python -m tests.hostile.fuzz", description=(__doc__ or "").splitlines()[0])
    p.add_argument("--seconds", type=int, default=60)
    p.add_argument("--keep", type=Path, default=Path("found"), metavar="DIR", help="where to keep what was found")
    p.add_argument("--seed", type=int, default=0, help="default: a random one")
    given = p.parse_args(argv)
    import atheris

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with atheris.instrument_imports(include=["gpusimbench"]):
        import gpusimbench.evaluator.check.integrity  # noqa: F401
        import gpusimbench.evaluator.read.recording  # noqa: F401
    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    seeds = folder / "seeds"
    seeds.mkdir()
    _seed(seeds)
    run = _Run(
        folder / "fuzzed.mcap", given.keep, [path.read_bytes() for path in sorted(seeds.iterdir())], given.seconds
    )
    options = [
        sys.argv[0], str(seeds), f"-max_total_time={given.seconds + 600}", f"-max_len={_LONGEST}", "-len_control=0",
        "-timeout=120", "-rss_limit_mb=4096", f"-seed={given.seed}", f"-artifact_prefix={given.keep}/",
        "-print_final_stats=1",
    ]  # fmt: skip
    given.keep.mkdir(parents=True, exist_ok=True)
    atheris.Setup(options, run.read, custom_mutator=run.mutate)
    atheris.Fuzz()
    return 0


def _seed(folder: Path) -> None:
    # small recordings of every kind, and what was found before
    from tests.hostile import records as mcap
    from tests.hostile.corpus import make_synthetic
    from tests.hostile.mutate import MUTATORS

    with tempfile.TemporaryDirectory() as made:
        good = [path.read_bytes() for path in make_synthetic(Path(made))]
    found = sorted((Path(__file__).parent / "found").glob("*.mcap"))
    other = [MUTATORS["other_layout"](random.Random(i), good).data for i in range(6)]
    for number, data in enumerate([*good, *other, *(path.read_bytes() for path in found)]):
        (folder / f"{number:03}").write_bytes(data)
    assert mcap.split(good[0])


class _Run:
    """Reads what the fuzzer makes, and notes what is wrong."""

    def __init__(self, path: Path, keep: Path, good: list[bytes], seconds: float) -> None:
        self._path, self._keep, self._good, self._seconds = path, keep, good, seconds
        self._began = self._told = time.monotonic()
        self.read_files = 0
        self.found: dict[str, int] = {}

    def read(self, data: bytes) -> None:
        """One file."""
        from tests.hostile.oracles import disagreement

        self.read_files += 1
        self._path.write_bytes(data)
        try:
            # gsb-check takes longer than the others together
            what, told = disagreement(self._path, thorough=self.read_files % 4 == 0), ""
        except BaseException as error:
            if isinstance(error, (KeyboardInterrupt, SystemExit)):
                raise
            where = traceback.extract_tb(error.__traceback__)[-1]
            what = f"{type(error).__name__}: {Path(where.filename).name}:{where.lineno}: {str(error)[:200]}"
            told = traceback.format_exc()
        if what:
            self._note(what, told, data)
        now = time.monotonic()
        if now - self._told > _TELL_S or now - self._began > self._seconds:
            self.tell()
            self._told = now
        if now - self._began > self._seconds:
            os._exit(1 if self.found else 0)  # what the fuzzer starts on its own end is not run

    def _note(self, what: str, told: str, data: bytes) -> None:
        kind = re.sub(r"0x[0-9a-f]+|\d+|/\S+|'[^']*'", "#", what)
        kind = re.sub(r"\\x#[0-9a-f]*", "#", kind)[:160]
        self.found[kind] = self.found.get(kind, 0) + 1
        if self.found[kind] > 1 or len(self.found) > _KINDS:
            return
        name = hashlib.sha256(kind.encode()).hexdigest()[:12]
        (self._keep / f"{name}.mcap").write_bytes(data)
        (self._keep / f"{name}.txt").write_text(f"{what}\n{told}")
        print(f"FOUND {name} after {self.read_files} files: {what}", flush=True)

    def mutate(self, data: bytes, most: int, seed: int) -> bytes:
        """The next file: bits, a way of tests.hostile.mutate, or a number in a record; mostly behind right CRCs."""
        import atheris

        from tests.hostile import records as mcap
        from tests.hostile.mutate import MUTATORS

        rng = random.Random(seed)
        changed = data
        for _ in range(rng.choice((1, 1, 2, 3))):
            try:
                match rng.randrange(4):
                    case 0:
                        changed = atheris.Mutate(changed, most)
                    case 1:
                        name = rng.choice(sorted(MUTATORS))
                        changed = MUTATORS[name](rng, [changed, rng.choice(self._good)]).data
                    case _:
                        changed = _with_number(rng, changed)
            except Exception:  # the mutators take good files; what they cannot take is left
                continue
        if rng.random() < 0.8:
            with contextlib.suppress(Exception):  # a file that has no CRCs to be made right
                changed = mcap.with_right_crcs(changed)
        return changed[:most]

    def tell(self) -> None:
        """How far it came."""
        seconds = time.monotonic() - self._began
        print(f"{self.read_files} files in {seconds:.0f} s, {len(self.found)} kinds of findings", flush=True)
        for kind, count in sorted(self.found.items(), key=lambda item: -item[1]):
            print(f"  {count} x {kind}", flush=True)


def _with_number(rng: random.Random, data: bytes) -> bytes:
    # a number of a record that says where things are, or how many; in the summary as often as before it
    from tests.hostile import records as mcap

    places, at = [], len(mcap.MAGIC)
    while at + mcap.HEAD <= len(data):
        opcode, size = struct.unpack_from("<BQ", data, at)
        if at + mcap.HEAD + size > len(data):
            break
        places.append((opcode, at, size))
        at += mcap.HEAD + size
    opcode = rng.choice(sorted({opcode for opcode, _, _ in places}))
    _, at, size = rng.choice([place for place in places if place[0] == opcode])
    width = rng.choice((1, 2, 4, 8))
    where = at + rng.randrange(max(1, min(mcap.HEAD + size, 80)))
    old = int.from_bytes(data[where : where + width], "little")
    new = rng.choice((old + 1, old - 1, old ^ (1 << rng.randrange(8 * width)), 0, (1 << 8 * width) - 1, len(data)))
    return data[:where] + (new % (1 << 8 * width)).to_bytes(width, "little") + data[where + width :]


if __name__ == "__main__":
    sys.exit(main())
