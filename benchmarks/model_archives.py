"""What a recording has of a model's files: the archive as it is, and as frames of Zstandard at several levels.

usage: python -m benchmarks.model_archives [--repeats 3] FILE...

Each model is recorded once on MuJoCo C, 16 environments and 100 steps. What the recording would have with the archive
as it is differs by the attachment alone. Seconds are a processor's, the least of the repeats; the highest level runs
once. Zstandard's frames are read back and compared.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import zstandard

from benchmarks.arguments import parser
from benchmarks.machine import machine
from gpusimbench.schemas.model_files import attachment, pack

_LEVELS = 3, 9, 19


def _recorded(model: Path) -> int:
    # bytes of a recording
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "gpusimbench.recorder.cli",
             "--sim", "mujoco", "--model", model, "--n-env", "16", "--runs", "1", "--steps", "100", "--phases",
             "capture", "--no-view", "--out", folder], check=True, capture_output=True,
        )  # fmt: skip
        (path,) = Path(folder).glob("*.mcap")
        return path.stat().st_size


def _compressed(archive: bytes, level: int, repeats: int) -> tuple[int, float]:
    # bytes, and seconds
    seconds = []
    for _ in range(repeats if level < max(_LEVELS) else 1):
        began = time.process_time()
        frame = zstandard.ZstdCompressor(level=level).compress(archive)
        seconds.append(time.process_time() - began)
    if zstandard.ZstdDecompressor().decompress(frame) != archive:
        raise SystemExit(f"level {level}: what was decompressed is not what was compressed")
    return len(frame), min(seconds)


def main() -> None:
    """Measure and print."""
    p = parser(__doc__, repeats=3)
    p.add_argument("files", nargs="+", type=Path, metavar="FILE")
    a = p.parse_args()
    print(f"machine: {machine()}")
    print(f"zstd {'.'.join(map(str, zstandard.ZSTD_VERSION))}")
    print("| model | archive | recording with it | recording | " + " | ".join(f"level {n}" for n in _LEVELS) + " |")
    for path in a.files:
        archive = pack(path)
        size = _recorded(path)
        sizes = [len(archive), size + len(archive) - len(attachment(archive)[2]), size]
        levels = [_compressed(archive, level, a.repeats) for level in _LEVELS]
        cells = [f"{n / 1e6:.2f} MB" for n in sizes] + [f"{n / 1e6:.2f} MB, {s:.2f} s" for n, s in levels]
        print(f"| {path.parent.name}/{path.stem} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
