"""Isaac Sim, for those who have it installed: Isaac Lab's PhysX lives there otherwise."""

from __future__ import annotations

from importlib.util import find_spec

from gpusimbench.schemas.errors import UsageError


def start() -> None:
    """Start Isaac Sim without a window, once in a process; it ends with the process. UsageError where there is none."""
    if find_spec("isaacsim") is None:
        raise UsageError(
            "backend 'physx' of simulator 'isaaclab' needs Isaac Sim (isaacsim), which is not installed; "
            "backend 'ovphysx' is PhysX without it"
        )
    from isaaclab.utils.version import has_kit

    if not has_kit():
        from isaaclab.app import AppLauncher

        AppLauncher(headless=True)
