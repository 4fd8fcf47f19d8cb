"""The replay of a recording: its environments made again, and stepped with the recorded actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.replay.dataset import require_gymnasium
from gpusimbench.replay.origin import origin_of
from gpusimbench.replay.parts import given_at_first, infos_of, parts_of, seed_of
from gpusimbench.schemas.commands.progress import stage
from gpusimbench.schemas.errors import GsbError, UsageError
from gpusimbench.schemas.text import plural


def replayed(
    original: Recording, path: Path, *, env: str | None = None, changed: Mapping[str, Any] | None = None,
    make: str | None = None, success: str | None = None, say: Callable[[str], None],
) -> None:  # fmt: skip
    """Record a replay in a file.

    env      id of Gymnasium's registry; None: the recorded one
    changed  keywords of the environment, instead of the recorded ones
    make     MODULE:FUNCTION that makes the environments, instead of both
    success  info that says whether an episode succeeded
    say      gets a line on what is replayed in

    UsageError where the environment cannot be made, or does not give what is needed; GsbError where it fails.
    """
    require_gymnasium()
    from gpusimbench.recorder.vector.making import of_factory, registered
    from gpusimbench.recorder.vector.open_loop import replay

    parts, n_env = parts_of(original), original.configuration.n_env
    if make:
        say(f"replaying in what {make} makes")
        envs = of_factory(make, n_env)
    else:
        origin = origin_of(original, env, changed or {})
        words = ", ".join(f"{name}={value!r}" for name, value in origin.keywords.items())
        say(f"replaying in {plural(n_env, 'environment')} {origin.spec_id}({words})")
        envs = registered(origin.spec_id, origin.keywords, n_env, vectorization=origin.vectorization)
    how = {"seed": seed_of(original), "infos": infos_of(original), "dt": original.configuration.dt}
    how["images"] = original.configuration.options.get("images", "numbers")
    needed = success if success and given_at_first(original, success) else ""
    with stage("replaying episodes"):
        try:
            replay(envs, path, parts, needed=needed, **how)
        except UsageError:
            path.unlink(missing_ok=True)  # of a step that could not be used
            raise
        except GsbError:
            raise
        except Exception as error:  # of the environment, whatever its kind
            raise GsbError(f"the environment failed: {type(error).__name__}: {error}") from error
