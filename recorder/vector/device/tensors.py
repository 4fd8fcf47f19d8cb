"""Vector environments of torch's tensors (ManiSkill, Isaac Lab, mjlab), recorded as they are stepped."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from gpusimbench.recorder.vector.device.history import INFO, Which
from gpusimbench.recorder.vector.device.log import About, DeviceLog, HostLog
from gpusimbench.recorder.vector.device.torch_rows import TorchRows
from gpusimbench.recorder.vector.ending import Ending
from gpusimbench.recorder.vector.fields import FINAL_INFO, GIVEN, Images
from gpusimbench.recorder.vector.modes import FINAL, Mode, final_name, five, mode_of
from gpusimbench.recorder.vector.origin import seed_of
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import leaves
from gpusimbench.schemas.vector import FINAL_GIVEN


@dataclass(frozen=True)
class _Package:
    """A package of tasks.

    distribution  that pip installs it as
    hides         its environments are reset within step, and tell the last observations of episodes only if asked to
    """

    distribution: str
    hides: bool = False


_PACKAGES = {
    "mani_skill": _Package("mani-skill"),
    "isaaclab": _Package("isaaclab", hides=True),
    "mjlab": _Package("mjlab", hides=True),
}
"""By the name that is imported."""

Row = dict[str, Any]


def has_tensors(envs: Any) -> bool:
    """Whether environments step on a device of torch: they say which, and torch is loaded."""
    torch = sys.modules.get("torch")
    device = told_by(envs, "device")
    if torch is None or device is None or told_by(envs, "num_envs") is None:
        return False
    return isinstance(device, torch.device) or (isinstance(device, str) and bool(_package(envs)))


def told_by(envs: Any, name: str) -> Any:
    """An attribute of environments, or of those in their wrappers; None where there is none."""
    found = getattr(envs, name, None)
    return getattr(getattr(envs, "unwrapped", None), name, None) if found is None else found


def recorded_tensors(
    envs: Any, path: str | Path, *, steps: int | None, dt: float, infos: tuple[str, ...], images: Images
) -> Any:
    """The environments, recorded; what Gymnasium takes for a vector or an environment is taken for it still."""
    base: type = _Plain
    if gymnasium := sys.modules.get("gymnasium"):
        bases = (gymnasium.vector.VectorEnv, gymnasium.vector.VectorWrapper), (gymnasium.Env, gymnasium.Wrapper)
        base = next((wrapper for kind, wrapper in bases if isinstance(envs, kind)), base)
    recorded = type("RecordedTensors", (RecordedTensors, base), {})(envs)
    recorded._record(path, steps=steps, dt=dt, infos=infos, images=images)
    return recorded


class _Plain:
    """The wrapper of environments that are none of Gymnasium's."""

    def __init__(self, env: Any) -> None:
        self.env = env


class RecordedTensors(Ending):
    """See gpusimbench.wrap, which makes it. All else than reset, step and close is the environments' own.

    What a step returned becomes a row on the device at once; no step waits for the device.
    """

    env: Any
    _log: DeviceLog

    def _record(
        self, path: str | Path, *, steps: int | None, dt: float, infos: tuple[str, ...], images: Images
    ) -> None:
        self._images = images
        self._path, self._steps, self._dt, self._told = path, steps, dt, infos
        self._n_env = int(told_by(self.env, "num_envs"))
        hiding = (package := _package(self.env)) in _PACKAGES and _PACKAGES[package].hides
        tells = bool(getattr(told_by(self.env, "cfg"), "compute_final_obs", False))  # of Isaac Lab
        self._mode = Mode.SAME_STEP if hiding else mode_of(self.env)
        if False in (told_by(self.env, "auto_reset"), getattr(told_by(self.env, "cfg"), "auto_reset", None)):
            self._mode = Mode.DISABLED  # whatever the metadata of ManiSkill say
        self._hidden = hiding and not tells and self._mode is Mode.SAME_STEP
        if self._mode is Mode.NONE:
            raise UsageError("the environment does not say when it is reset: its metadata need an autoreset_mode")
        self._log = DeviceLog(TorchRows(), steps)
        self._start: Row | None = None  # observations of the reset, and its seed
        self._seed: Any = None

    def __getattr__(self, name: str) -> Any:
        if name in ("env", "_log"):  # in a copy that is not made yet
            raise AttributeError(name)
        return getattr(self.env, name)

    def reset(self, *arguments: Any, **keywords: Any) -> Any:
        """See the environment."""
        returned = self.env.reset(*arguments, **keywords)
        if not self._log.ended:
            try:
                self._reset(returned[0], **keywords)
            except BaseException as error:
                self._log.end(error)
                raise
        return returned

    def step(self, action: Any) -> Any:
        """See the environment. The first step begins the recording, since it tells what actions are."""
        self._log.past_the_end()
        if self._log.ended:
            return self.env.step(action)
        try:
            given = self._action_row(action)  # before the environment may change them
            self._log.make_room()
            if not self._log.begun and self._start is None:
                raise UsageError(
                    "a vector environment is reset before it is stepped, and after a first step that failed"
                )
            returned = self.env.step(action)
            row = {**given, **self._row(*five(returned))}
            if not self._log.begun:
                self._begin(row)
            self._log.keep(row)
        except BaseException as error:
            self._log.end(error)
            self._start = None  # environments may have moved
            raise
        return returned

    def _hash(self, name: str, arrays: Any) -> None:
        self._log.fingerprint(name, arrays, reset=self._start is not None)

    def _end(self, error: BaseException | None) -> None:
        self._log.end(error)

    def _close(self, **keywords: Any) -> None:
        self.env.close(**keywords)

    def _reset(self, observation: Any, seed: Any = None, options: Any = None, env_ids: Any = None, **_: Any) -> None:
        seen = _copied(observation, "observation")
        if not self._log.begun:
            self._start, self._seed = seen, seed
            return
        mask, some = (options or {}).get("reset_mask"), (options or {}).get("env_idx", env_ids)
        if mask is None and some is not None:
            mask = np.zeros(self._n_env, dtype=np.bool_)
            mask[_host(some)] = True
        self._log.replace(seen, Which.ALL if mask is None else _host(mask).astype(np.bool_))

    def _action_row(self, action: Any) -> Row:
        given = _copied(action, "action")
        alone = getattr(told_by(self.env, "single_action_space"), "shape", None)
        if self._n_env == 1 and alone is not None:  # ManiSkill takes the action of one environment without its axis
            given = {name: array[None] if tuple(array.shape) == alone else array for name, array in given.items()}
        return given

    def _begin(self, row: Row) -> None:
        import torch

        assert self._start is not None
        first = {name: torch.zeros_like(tensor) for name, tensor in row.items()} | self._start
        if FINAL_GIVEN in row:
            first |= {final_name(name): seen for name, seen in self._start.items()}
            first[FINAL_GIVEN] = ~first[FINAL_GIVEN]
        self._log.begin(first, HostLog(self._path, steps=self._steps, dt=self._dt, about=self._about()))

    def _row(self, observation: Any, reward: Any, terminated: Any, truncated: Any, info: Any) -> Row:
        row = {name: _tensor(array, name) for name, array in leaves(observation, "observation")}
        flags = {"terminated": _tensor(terminated, "terminated"), "truncated": _tensor(truncated, "truncated")}
        if not isinstance(info, Mapping):
            info = {}
        of_info = _infos(self._told, info, row)
        if self._mode is Mode.SAME_STEP and not self._hidden:
            row |= _final(row, flags["terminated"] | flags["truncated"], info)
        return {**row, "reward": _tensor(reward, "reward"), **flags, **of_info}

    def _about(self) -> About:
        package = _package(self.env)
        try:
            number = version(_PACKAGES[package].distribution if package else "gymnasium")
        except PackageNotFoundError:
            number = "unknown"
        seed, options = seed_of(self._seed)
        if self._told:
            options["infos"] = ", ".join(self._told)
        spec = getattr(self.env, "spec", None)
        return About(
            simulator=package or "gymnasium",
            version=number,
            scene=getattr(spec, "id", "") or type(getattr(self.env, "unwrapped", self.env)).__name__,
            device=_device(told_by(self.env, "device")),
            mode=self._mode,
            hidden=self._hidden,
            options=options,
            seed=seed,
            images=self._images,
        )


def _final(seen: Row, done: Any, info: Mapping[str, Any]) -> Row:
    # what a step led to; on the host it is seen whether it is known where an episode ended
    import torch

    told = info.get("final_obs", info.get(FINAL))
    if told is None:
        return {**{final_name(name): array for name, array in seen.items()}, FINAL_GIVEN: ~done}
    last = dict(leaves(told, "observation"))
    found = {
        final_name(name): torch.where(done.reshape(-1, *(1,) * (array.ndim - 1)), last[name], array)
        for name, array in seen.items()
    }
    return {**found, FINAL_GIVEN: torch.ones_like(done)}


def _infos(names: tuple[str, ...], info: Mapping[str, Any], row: Row) -> Row:
    # of the step: what is said of an episode's last step is beside what is said of the reset that followed
    import torch

    found: Row = {}
    n_env = len(next(iter(row.values())))
    device = next(iter(row.values())).device
    for name in names:
        node: Any = info.get(FINAL_INFO, info)
        for key in name.split("/"):
            node = node.get(key) if isinstance(node, Mapping) else None
        given = node is not None
        values = _tensor(node if given else 0.0, f"info {name}").to(device, torch.float64).reshape(-1)
        if given and len(values) != n_env:
            raise UsageError(f"info {name} is no number for each of {n_env} environments")
        found[f"{INFO}{name}"] = values.expand(n_env)
        found[f"{INFO}{name}{GIVEN}"] = torch.full((n_env,), given, device=device)
    return found


def _tensor(value: Any, name: str) -> Any:
    import torch

    try:
        return torch.as_tensor(value)
    except (TypeError, ValueError, RuntimeError):
        raise UsageError(f"{name} is {type(value).__name__}, and no array of numbers") from None


def _copied(tree: Any, name: str) -> Row:
    return {found: _tensor(array, found).detach().clone() for found, array in leaves(tree, name)}


def _host(array: Any) -> Any:
    return array.cpu().numpy() if hasattr(array, "cpu") else np.asarray(array)


def _device(device: Any) -> str:
    import torch

    found = torch.device(device)
    return torch.cuda.get_device_name(found) if found.type == "cuda" else str(found.type)


def _package(envs: Any) -> str:
    whole = getattr(envs, "unwrapped", envs)
    roots = (base.__module__.partition(".")[0] for base in type(whole).__mro__)
    return next((root for root in roots if root in _PACKAGES), "")
