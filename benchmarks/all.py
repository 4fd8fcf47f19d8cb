"""Runs every benchmark and writes RESULTS.md (``make bench``)."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

HERE = Path(__file__).resolve().parent
SCRIPTS = (
    ("record_throughput",),
    ("evaluate_set",),
    ("start_up",),
    ("write_path", "--n-env", "256"),
    ("read_path",),
    ("action_storage",),
    ("capture_overhead",),
    ("lock_wait",),
    ("archive",),
    ("transport",),
    ("transport_large",),
    ("wrap_overhead",),
    ("wrap_overhead", "--kind", "brax", "--n-env", "256", "--steps", "1500", "--rounds", "5"),
    ("array_hashes",),
    ("engine_best", "--sim", "warp", "--n-env", "64", "--steps", "50"),
)


def main() -> None:
    """Run, print, keep."""
    parts = [f"# Results\n\nMade by `make bench` on {datetime.now(UTC):%Y-%m-%d}; medians, smallest and largest.\n"]
    for name, *arguments in SCRIPTS:
        command = [sys.executable, "-m", f"benchmarks.{name}", *arguments]
        done = subprocess.run(command, cwd=HERE.parent, check=True, capture_output=True, text=True)
        title = " ".join([f"{name}.py", *arguments])
        print(f"{title}\n{done.stdout}", flush=True)
        parts.append(f"## {title}\n\n```\n{done.stdout}```\n")
    (HERE / "RESULTS.md").write_text("\n".join(parts))


if __name__ == "__main__":
    main()
