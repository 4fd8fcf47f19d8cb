"""Warp kernels that adapters add to an engine's step: actions, snapshots and counts, all on the device.

Imported when a device is wanted, not before. Annotations are Warp's own, so they are evaluated.
"""

import warp as wp

from gpusimbench.schemas.mixing import GOLDEN32

_GOLDEN = wp.constant(wp.uint32(GOLDEN32))
_FACTOR_1 = wp.constant(wp.uint32(0x85EBCA6B))
_FACTOR_2 = wp.constant(wp.uint32(0xC2B2AE35))


@wp.func
def mix32(word: wp.uint32) -> wp.uint32:
    """As schemas.mixing."""
    word = word ^ (word >> wp.uint32(16))
    word = word * _FACTOR_1
    word = word ^ (word >> wp.uint32(13))
    word = word * _FACTOR_2
    return word ^ (word >> wp.uint32(16))


@wp.kernel(enable_backward=False)
def draw_targets(
    seed_word: wp.uint32,
    step: wp.array(dtype=wp.int32),
    stream: wp.array(dtype=wp.uint32),
    begun: wp.array(dtype=wp.uint32),
    first: wp.array(dtype=wp.int32),
    count: wp.array(dtype=wp.uint32),
    grid: wp.array(dtype=float),
    ctrl: wp.array2d(dtype=float),
):
    """The targets of schemas.action_generator.JointTargets at step step[0], into ctrl [env, joint], by the two arrays
    of the environments' Streams."""
    env, joint = wp.tid()
    word = mix32(seed_word + (stream[env] + wp.uint32(1)) * _GOLDEN)
    now = wp.uint32(step[0])
    if now >= begun[env]:
        now = now - begun[env]
    word = mix32(word + (now + wp.uint32(1)) * _GOLDEN)
    word = mix32(word + wp.uint32(joint + 1) * _GOLDEN)
    index = ((word >> wp.uint32(16)) * count[joint]) >> wp.uint32(16)
    ctrl[env, joint] = float(first[joint] + wp.int32(index)) * grid[joint]


@wp.kernel(enable_backward=False)
def give_row(
    step: wp.array(dtype=wp.int32),
    stream: wp.array(dtype=wp.uint32),
    begun: wp.array(dtype=wp.uint32),
    rows: wp.array3d(dtype=float),
    ctrl: wp.array2d(dtype=float),
):
    """Row step[0] of rows [row, env or 1, action], which begin anew after the last, into ctrl [env, action], by the two
    arrays of the environments' Streams."""
    env, action = wp.tid()
    now = wp.uint32(step[0])
    if now >= begun[env]:
        now = now - begun[env]
    ctrl[env, action] = rows[wp.int32(now) % rows.shape[0], wp.int32(stream[env]) % rows.shape[1], action]


@wp.kernel(enable_backward=False)
def advance(counter: wp.array(dtype=wp.int32)):
    """counter[0] += 1"""
    counter[0] = counter[0] + 1


@wp.kernel(enable_backward=False)
def snapshot(row: wp.array(dtype=wp.int32), values: wp.array2d(dtype=float), ring: wp.array3d(dtype=float)):
    """values [env, i] into ring[row[0], env, i]."""
    env, i = wp.tid()
    ring[row[0], env, i] = values[env, i]


@wp.kernel(enable_backward=False)
def snapshot_counts(
    row: wp.array(dtype=wp.int32),
    nefc: wp.array(dtype=int),
    niter: wp.array(dtype=int),
    overflow: wp.array(dtype=int),
    ring: wp.array3d(dtype=int),
):
    """Of each env into ring[row[0], .., env]: no contacts yet, rows, iterations, overflow bits, none misplaced yet; the
    bits are cleared."""
    env = wp.tid()
    ring[row[0], 0, env] = 0
    ring[row[0], 1, env] = nefc[env]
    ring[row[0], 2, env] = niter[env]
    ring[row[0], 3, env] = overflow[env]
    ring[row[0], 4, env] = 0
    overflow[env] = 0


@wp.kernel(enable_backward=False)
def count_contacts(
    row: wp.array(dtype=wp.int32),
    nacon: wp.array(dtype=int),
    worldid: wp.array(dtype=int),
    ring: wp.array3d(dtype=int),
):
    """Adds each contact of the pool to ring[row[0], 0, its env]."""
    contact = wp.tid()
    if contact < wp.min(nacon[0], worldid.shape[0]):
        wp.atomic_add(ring, row[0], 0, worldid[contact], 1)


@wp.kernel(enable_backward=False)
def count_misplaced(
    row: wp.array(dtype=wp.int32),
    nacon: wp.array(dtype=int),
    worldid: wp.array(dtype=int),
    geoms: wp.array(dtype=wp.vec2i),
    points: wp.array(dtype=wp.vec3),
    distances: wp.array(dtype=float),
    centres: wp.array2d(dtype=wp.vec3),
    radii: wp.array2d(dtype=float),
    counts: wp.array2d(dtype=int),
):
    """Adds each contact of the pool that mujoco.contacts calls misplaced to counts[row[0], its env].

    geoms    of each contact; -1: no geom, and no point is outside
    centres  [env, geom]
    radii    [env or 1, geom]
    """
    contact = wp.tid()
    if contact >= wp.min(nacon[0], worldid.shape[0]):
        return
    env = worldid[contact]
    for side in range(2):
        geom = geoms[contact][side]
        if geom >= 0:
            radius = radii[env % radii.shape[0], geom]
            away = wp.length(points[contact] - centres[env, geom])
            if radius > 0.0 and away > 2.0 * radius + wp.abs(distances[contact]):
                wp.atomic_add(counts, row[0], env, 1)
                return


@wp.func
def what_failed(value: float, bounded: wp.int32, within: float) -> int:
    """The kind of failure that a number of a state is, as of simulators.flight; -1: none."""
    if not wp.isfinite(value):
        return 0
    if bounded != 0 and wp.abs(value) > within:
        return 2
    return -1


@wp.kernel(enable_backward=False)
def hold(
    step: wp.array(dtype=wp.int32),
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    overflow: wp.array(dtype=int),
    bounded: wp.array(dtype=wp.int32),
    within: float,
    fatal: int,
    kinds: int,
    held_qpos: wp.array3d(dtype=float),
    held_qvel: wp.array3d(dtype=float),
    held_bits: wp.array2d(dtype=int),
    failures: wp.array(dtype=wp.int64),
):
    """The state of step step[0] into a ring of steps, and the first failure of each env, as simulators.flight has it.

    Threads are [env, number of qpos, then of qvel, then one for the overflow bits, which are cleared]. bounded says of
    each number of qpos whether it is a coordinate of a body; 0, 1 and 2 are the kinds of failures.
    """
    env, i = wp.tid()
    row = step[0] % held_bits.shape[0]
    n_qpos = qpos.shape[1]
    n_state = n_qpos + qvel.shape[1]
    now = wp.int64(step[0]) * wp.int64(kinds)
    if i == n_state:
        bits = overflow[env]
        held_bits[row, env] = bits
        overflow[env] = 0
        if (bits & fatal) != 0:
            wp.atomic_min(failures, env, now + wp.int64(1))
        return
    if i < n_qpos:
        held_qpos[row, env, i] = qpos[env, i]
        kind = what_failed(qpos[env, i], bounded[i], within)
        if kind >= 0:
            wp.atomic_min(failures, env, now + wp.int64(kind))
    else:
        held_qvel[row, env, i - n_qpos] = qvel[env, i - n_qpos]
        if not wp.isfinite(qvel[env, i - n_qpos]):
            wp.atomic_min(failures, env, now)


@wp.kernel(enable_backward=False)
def held_of_env(env: int, held: wp.array3d(dtype=float), rows: wp.array2d(dtype=float)):
    """held [row, env, i] of one env into rows [row, i]."""
    row, i = wp.tid()
    rows[row, i] = held[row, env, i]
