"""What is gathered on the device around Newton's steps. Importing this module imports Warp.

Kernels that store take the row from an array on the device, so that one CUDA graph of a step serves every row.
Annotations are Warp's own, so they are evaluated.
"""

from typing import Any

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
def store(row: wp.array(dtype=wp.int32), values: wp.array(dtype=Any), stored: wp.array2d(dtype=Any)):
    """Store an array of a state, [number]."""
    i = wp.tid()
    stored[row[0], i] = values[i]


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


@wp.kernel(enable_backward=False)
def drive_joints(
    ctrl: wp.array2d(dtype=float),
    low: wp.array(dtype=float),
    high: wp.array(dtype=float),
    gain: wp.array(dtype=float),
    force_low: wp.array(dtype=float),
    force_high: wp.array(dtype=float),
    arms: wp.array2d(dtype=float),
    servo: wp.array2d(dtype=wp.int32),
    reference: wp.array(dtype=float),
    target_of: wp.array(dtype=wp.int32),
    joint_f: wp.array2d(dtype=float),
    target_q: wp.array2d(dtype=float),
    target_qd: wp.array2d(dtype=float),
):
    """Controls [world, actuator] as joint forces and targets, [world, velocity].

    low, high              to which controls are clamped
    gain                   force of a control of 1, zero for servos
    force_low, force_high  to which forces are clamped
    arms                   of an actuator on a velocity, [velocity, actuator]
    servo                  by velocity, the actuators that set its target position and its target velocity; -1: none
    reference              to be subtracted from target positions
    target_of              by velocity, its place in target_q
    """
    world, i = wp.tid()
    force = wp.float32(0.0)
    for a in range(ctrl.shape[1]):
        arm = arms[i, a]
        if arm != 0.0:
            given = wp.clamp(ctrl[world, a], low[a], high[a])
            force += arm * wp.clamp(gain[a] * given, force_low[a], force_high[a])
    joint_f[world, i] = force
    a = servo[i, 0]
    if a >= 0:
        target_q[world, target_of[i]] = wp.clamp(ctrl[world, a], low[a], high[a]) - reference[i]
    a = servo[i, 1]
    if a >= 0:
        target_qd[world, i] = wp.clamp(ctrl[world, a], low[a], high[a])
