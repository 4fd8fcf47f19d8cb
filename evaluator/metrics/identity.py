"""Bit-identity: which samples are the same bytes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def bitwise_classes(samples: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """Group samples by their bytes.

    Bytes, not values: NaNs are equal only with the same payload, and -0.0 differs from 0.0. This is
    the strongest statement of equality, stronger than a published distance of "0.00 cm".

    Args:
        samples: any numeric array [any unit], shape [n_sample, ...].

    Returns:
        class of every sample, numbered 0, 1, ... in order of first appearance, shape [n_sample].

    Raises:
        ValueError: samples are a scalar, or Python objects, which have no bytes to compare.
    """
    array = np.asarray(samples)
    if array.ndim == 0:
        raise ValueError("samples must have at least one axis, got a scalar")
    if array.dtype.hasobject:
        raise ValueError("samples are Python objects: there are no bytes to compare")
    classes: dict[bytes, int] = {}
    labels = [classes.setdefault(sample.tobytes(), len(classes)) for sample in array]
    return np.array(labels, dtype=np.int64)


def count_distinct(samples: npt.ArrayLike) -> int:
    """Number of bitwise different samples (see `bitwise_classes`), shape [n_sample, ...]."""
    return int(bitwise_classes(samples).max(initial=-1)) + 1
