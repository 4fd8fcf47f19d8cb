"""Names by which the recorder writes, and the evaluator reads, what recordings of vector environments have."""

from __future__ import annotations

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
"""The option that describes JAX's keys of the first reset by their number and hash: no seed can be read from them."""

PHYSICS = "physics_"
"""Begins the names of the arrays of MuJoCo's qpos and qvel, of each row's observation."""

SEEDS = "episode_seeds.json"
"""The attachment with the seed of each episode's reset, [env][episode], null where none is known."""
