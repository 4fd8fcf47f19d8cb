"""What is gathered on the device from PhysX's reads. Importing this module imports Warp.

Annotations are Warp's own, so they are evaluated.
"""

import warp as wp


@wp.kernel(enable_backward=False)
def store_bodies(
    row: int,
    source: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.float32),
    orientations: wp.array2d(dtype=wp.float32),
    linear: wp.array2d(dtype=wp.float32),
    angular: wp.array2d(dtype=wp.float32),
    stored: wp.array3d(dtype=wp.float32),
):
    """Store a state in the scene's order, [body] of all environments; quaternions come as xyzw and are kept as wxyz."""
    body = wp.tid()
    at = source[body]
    for k in range(3):
        stored[row, body, k] = positions[at, k]
        stored[row, body, 4 + k] = orientations[at, k]
        stored[row, body, 7 + k] = linear[at, k]
        stored[row, body, 10 + k] = angular[at, k]
    stored[row, body, 3] = orientations[at, 3]
