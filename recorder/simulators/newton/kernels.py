"""What is gathered on the device around Newton's steps. Importing this module imports Warp.

Kernels that store take the row from an array on the device, so that one CUDA graph of a step serves every row.
Annotations are Warp's own, so they are evaluated.
"""

import warp as wp


@wp.kernel(enable_backward=False)
def gather_bits(found: wp.array(dtype=wp.int32), bits: wp.array(dtype=wp.int32)):
    """Keep the overflow bits that an engine shows for each world, [world]."""
    world = wp.tid()
    bits[world] = bits[world] | found[world]


@wp.kernel(enable_backward=False)
def gather_pool(count: wp.array(dtype=wp.int32), capacity: int, bit: int, bits: wp.array(dtype=wp.int32)):
    """Set a bit in all worlds, [world], where more was counted than their common buffer holds."""
    if count[0] > capacity:
        bits[wp.tid()] = bits[wp.tid()] | bit


@wp.kernel(enable_backward=False)
def gather_flags(flags: wp.array(dtype=wp.bool), bit: int, bits: wp.array(dtype=wp.int32)):
    """Set a bit in the worlds that an engine flags; one more flag, after those of the worlds, is for all, [world]."""
    world = wp.tid()
    if flags[world] or flags[flags.shape[0] - 1]:
        bits[world] = bits[world] | bit


@wp.kernel(enable_backward=False)
def gather_bodies(
    counts: wp.array(dtype=wp.int32),
    world_of: wp.array(dtype=wp.int32),
    capacity: int,
    bit: int,
    bits: wp.array(dtype=wp.int32),
):
    """Set a bit in the world of each body of which more was counted than its list holds, [body]."""
    body = wp.tid()
    if counts[body] > capacity:
        wp.atomic_or(bits, world_of[body], bit)


@wp.kernel(enable_backward=False)
def store_bodies(
    row: wp.array(dtype=wp.int32),
    poses: wp.array(dtype=wp.transform),
    speeds: wp.array(dtype=wp.spatial_vector),
    stored_poses: wp.array2d(dtype=wp.transform),
    stored_speeds: wp.array2d(dtype=wp.spatial_vector),
):
    """Store a state, [body]."""
    body = wp.tid()
    stored_poses[row[0], body] = poses[body]
    stored_speeds[row[0], body] = speeds[body]


@wp.kernel(enable_backward=False)
def store_bits(row: wp.array(dtype=wp.int32), bits: wp.array(dtype=wp.int32), stored: wp.array2d(dtype=wp.int32)):
    """Store the bits since the row before, and forget them, [world]."""
    world = wp.tid()
    stored[row[0], world] = bits[world]
    bits[world] = 0


@wp.kernel(enable_backward=False)
def store_counts(row: wp.array(dtype=wp.int32), counts: wp.array(dtype=wp.int32), stored: wp.array2d(dtype=wp.int32)):
    """Store what the engine counted in each world, [world]."""
    world = wp.tid()
    stored[row[0], world] = counts[world]


@wp.kernel(enable_backward=False)
def clear_counts(row: wp.array(dtype=wp.int32), stored: wp.array2d(dtype=wp.int32)):
    """Begin to count, [world]."""
    stored[row[0], wp.tid()] = 0


@wp.kernel(enable_backward=False)
def count_worlds(
    row: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    world_of: wp.array(dtype=wp.int32),
    stored: wp.array2d(dtype=wp.int32),
):
    """Count the contacts of each world in a buffer that names their worlds, [contact]."""
    contact = wp.tid()
    if contact < count[0]:
        wp.atomic_add(stored, row[0], world_of[contact], 1)


@wp.kernel(enable_backward=False)
def count_shapes(
    row: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    shape0: wp.array(dtype=wp.int32),
    shape1: wp.array(dtype=wp.int32),
    world_of: wp.array(dtype=wp.int32),
    stored: wp.array2d(dtype=wp.int32),
):
    """Count the contacts of each world in a buffer that names their shapes, [contact]."""
    contact = wp.tid()
    if contact < count[0]:
        world = wp.max(world_of[shape0[contact]], world_of[shape1[contact]])  # -1: a shape of all worlds
        if world >= 0:
            wp.atomic_add(stored, row[0], world, 1)


@wp.kernel(enable_backward=False)
def next_row(row: wp.array(dtype=wp.int32)):
    """Go on to the next row, one thread."""
    row[0] = row[0] + 1
