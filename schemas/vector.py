"""Names by which the recorder writes, and the evaluator reads, what recordings of vector environments have."""

from __future__ import annotations

import hashlib
import re

FINAL_GIVEN = "final_observation_given"
"""The array that is 0 where the last observation of an episode is not known: in recordings made of some data sets."""

IMAGE_HASH = "_hash"
"""Ends the names of arrays that have hashes of observed images, as schemas.images makes them."""

NOT_GIVEN = "not_given"
"""The option that names arrays for which zeros stand, since a data set lacks them: "reward"."""

DATA_SET = "dataset"
"""Simulator of a recording that was made of a data set of demonstrations; its version is that of the format."""

NO_SEED = "not given"
"""What RESET_SEEDS says of a first reset without a seed."""

RESET_SEEDS = "seeds"
"""The option that says what was given in place of the one seed of the first reset: seeds, one an environment."""

RESET_KEYS = "rng"
"""The option that describes JAX's keys of the first reset, as `keys_said` does."""

PHYSICS = "physics_"
"""Begins the names of the arrays of MuJoCo's qpos and qvel, of each row's observation."""

SEEDS = "episode_seeds.json"
"""The attachment with the seed of each episode's reset, [env][episode], null where none is known."""

MODELS = "episode_models.json.gz"
"""The attachment with the models of episodes, gzip of JSON: "models", texts of MJCF, and "episodes", the number of its
model for each [env][episode], null where the task decides."""

_HASH = re.compile(r"(.*) keys, hash ([0-9a-f]{8})[0-9a-f]{8}")
_LONGEST = 24  # text of seeds that names of groups show as it is


def keys_said(described: str, fingerprint: int, seed: int | None) -> str:
    """What RESET_KEYS says of keys: the seed of a single key that tells it; of others dtype, shape and hash.

    described    dtype and shape, such as "uint32 4x2"
    fingerprint  64-bit hash of the keys
    """
    return f"{described} keys, hash {fingerprint:016x}" if seed is None else f"seed {seed}"


def shown_seeds(option: str, value: str) -> str:
    """The value of RESET_KEYS or RESET_SEEDS as names of groups have it: a few characters, others for other values.

    Keys are the first 8 digits of their hash; consecutive seeds are the first and the last; other long lists are the
    number of seeds and the first 8 digits of the SHA-256 of the text.
    """
    if option == RESET_KEYS and (hashed := _HASH.fullmatch(value)):
        return hashed[2]
    numbers = [int(text) for text in value.split(", ")] if re.fullmatch(r"\d{1,18}(, \d{1,18})*", value) else []
    if len(numbers) > 2 and numbers == list(range(numbers[0], numbers[0] + len(numbers))):
        return f"{numbers[0]}..{numbers[-1]}"
    if len(value) <= _LONGEST:
        return value
    return f"{value.count(',') + 1} with hash {hashlib.sha256(value.encode()).hexdigest()[:8]}"
