"""What a bisection records of each release, by gsb-record."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.compute.recorder import as_path
from gpusimbench.schemas.configuration import RunConfiguration


@dataclass(frozen=True)
class Plan:
    """The runs of every release.

    options  NAME=VALUE, with those by which every release of the engine steps in the same way
    steps    that are captured
    runs     of each release
    timed    whether there is a timed phase
    """

    simulator: str
    scene: str
    options: tuple[str, ...]
    n_env: int
    steps: int
    seed: int
    runs: int
    timed: bool

    def arguments(self, python: Path, runs: int, out: Path) -> list[str]:
        """Of gsb-record, for so many runs by that Python."""
        given = ["--sim", self.simulator, "--scene", self.scene, "--python", as_path(python)]
        given += [f"--option={option}" for option in self.options]
        given += ["--n-env", str(self.n_env), "--runs", str(runs), "--seed", str(self.seed)]
        given += ["--steps", str(self.steps)]
        given += ["--phases", "timed,capture" if self.timed else "capture"]
        return [*given, "--no-view", "--compression", "zstd", "--out", as_path(out)]

    def has(self, c: RunConfiguration) -> bool:
        """Whether a run is what this plan asks for."""
        found = (c.simulator, c.scene, c.n_env, c.seed, c.steps, "timed" in c.phases, c.option_words)
        return found == (
            self.simulator, self.scene, self.n_env, self.seed, self.steps, self.timed, sorted(self.options)
        )  # fmt: skip


def with_options(asked: tuple[str, ...], common: dict[str, str]) -> tuple[str, ...]:
    """The options that were asked for, after those that make releases step alike; the former decide."""
    given = {name for name, _, _ in (option.partition("=") for option in asked)}
    return (*(f"{name}={value}" for name, value in common.items() if name not in given), *asked)
