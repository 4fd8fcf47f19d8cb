"""An mjx.Model whose fields differ from environment to environment, for vmap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.mujoco.varied import varied_fields

_STATISTICS = ("meaninertia", "meanmass", "meansize")  # the first scales the solver's tolerance


def model_fields(model: Any, models: Sequence[Any]) -> dict[str, NDArray[Any]]:
    """Fields of mjx.Model that differ between the mujoco.MjModels of environments, [env, ...], by their path in it.

    What else differs MJX does not have, or reads for height fields alone (`geom_rbound_hfield`).
    """
    from mujoco import mjx

    known = {field.name for field in fields(mjx.Model)}
    found = {name: array for name, array in varied_fields(model, models).items() if name in known}
    for name in _STATISTICS:
        values = np.array([getattr(one.stat, name) for one in models])
        if (values != getattr(model.stat, name)).any():
            found[f"stat.{name}"] = values
    return found


def batched(model: Any, varied: Mapping[str, NDArray[Any]]) -> tuple[Any, Any]:
    """The mjx.Model with these fields, and which of its arrays jax.vmap is to take apart."""
    import jax
    import jax.numpy as jnp

    whole = model.tree_replace({name: jnp.asarray(array, jnp.float32) for name, array in varied.items()})
    axes = jax.tree.map(lambda array: None, model).tree_replace(dict.fromkeys(varied, 0))
    return whole, axes
