"""The calibration simulator's step. Importing this module imports Taichi.

Annotations are Taichi's own, so they are evaluated. Every sum has a fixed order: an environment is one thread's work,
and `a = a + b` is written out where `a += b` would be an atomic addition.
"""

import taichi as ti
import taichi.math as tm

from gpusimbench.recorder.simulators.calibration.model import DAMPING, GRIP, RATE

Vectors = ti.types.ndarray(dtype=tm.vec3, ndim=2)  # [env, body]
Rows = ti.types.ndarray(dtype=tm.vec3, ndim=3)  # [row, env, body]
Traits = ti.types.ndarray(dtype=tm.vec4, ndim=1)  # [body]: radius, mass, inverse inertia, friction
Faces = ti.types.ndarray(dtype=tm.vec3, ndim=2)  # [face, 5]: centre, three axes, extent
Places = ti.types.ndarray(dtype=tm.vec3, ndim=1)  # [env]
Integers = ti.types.ndarray(dtype=ti.i32, ndim=2)
Counts = ti.types.ndarray(dtype=ti.i32, ndim=1)  # [env]
Shifts = ti.types.ndarray(dtype=ti.f32, ndim=1)  # [env]


@ti.func
def normal_force(depth: ti.f32, closing: ti.f32, mass: ti.f32) -> ti.f32:
    """The force of a damped spring that never pulls [N]."""
    return ti.max(0.0, mass * RATE * (RATE * depth + 2.0 * DAMPING * closing))


@ti.func
def between(a: tm.vec3, b: tm.vec3, va: tm.vec3, vb: tm.vec3, ta: tm.vec4, tb: tm.vec4) -> tm.vec3:
    """Force on sphere a from sphere b [N], without friction; zero where they do not touch."""
    force = tm.vec3(0.0)
    apart = a - b
    square = tm.dot(apart, apart)
    reach = ta[0] + tb[0]
    if square > 0.0 and square < reach * reach:
        distance = ti.sqrt(square)
        normal = apart / distance
        mass = ta[1] * tb[1] / (ta[1] + tb[1])
        force = normal * normal_force(reach - distance, -tm.dot(va - vb, normal), mass)
    return force


@ti.func
def advance(
    env: ti.i32, body: ti.i32, dt: ti.f32, gravity: tm.vec3, force: tm.vec3, place: tm.vec3,
    x: ti.template(), v: ti.template(), spin: ti.template(), traits: ti.template(), faces: ti.template(),
) -> ti.i32:  # fmt: skip
    """Semi-implicit Euler of one body under a force, gravity and what fixed faces do; returns how many it touches."""
    radius, mass, inverse_inertia, friction = traits[body]
    position, velocity, omega = x[env, body], v[env, body], spin[env, body]
    torque = tm.vec3(0.0)
    total = force
    touched = 0
    for k in range(faces.shape[0]):
        normal, extent = faces[k, 3], faces[k, 4]
        offset = position - faces[k, 0]
        height = tm.dot(offset, normal)
        within = ti.abs(tm.dot(offset, faces[k, 1])) <= extent[0] and ti.abs(tm.dot(offset, faces[k, 2])) <= extent[1]
        if within and -extent[2] < height and height < radius:
            arm = -radius * normal
            slip = velocity + tm.cross(omega, arm)
            closing = -tm.dot(slip, normal)
            slip = slip + closing * normal
            push = normal_force(radius - height, closing, mass)
            speed = ti.sqrt(tm.dot(slip, slip))
            drag = mass * GRIP
            if drag * speed > friction * push:
                drag = friction * push / speed
            total = total + (push * normal - drag * slip)
            torque = torque - tm.cross(arm, drag * slip)
            touched += 1
    velocity = velocity + dt * (gravity + total / mass)
    x[env, body] = ((position + place) + dt * velocity) - place
    v[env, body] = velocity
    spin[env, body] = omega + dt * inverse_inertia * torque
    return touched


@ti.kernel
def step(
    substeps: ti.i32, dt: ti.f32, gravity: tm.vec3, contacts: ti.i32, x: Vectors, v: Vectors, spin: Vectors,
    force: Vectors, traits: Traits, faces: Faces, order: Integers, places: Places, touching: Counts,
):  # fmt: skip
    """One step of `substeps` parts, an environment a thread; forces are added up in the environment's order."""
    for env in range(x.shape[0]):
        for _ in range(substeps):
            count = 0
            for body in range(x.shape[1]):
                force[env, body] = tm.vec3(0.0)
            if contacts != 0:
                for p in range(x.shape[1]):
                    for q in range(p):
                        a, b = order[env, p], order[env, q]
                        f = between(x[env, a], x[env, b], v[env, a], v[env, b], traits[a], traits[b])
                        if f.x != 0.0 or f.y != 0.0 or f.z != 0.0:
                            force[env, a] = force[env, a] + f
                            force[env, b] = force[env, b] - f
                            count += 1
            for body in range(x.shape[1]):
                count += advance(env, body, dt, gravity, force[env, body], places[env], x, v, spin, traits, faces)
            touching[env] = count


@ti.func
def before(a: tm.vec3, b: tm.vec3) -> ti.i32:
    """Whether a comes before b along x; along y where they are level, and then along z."""
    return a.x < b.x or (a.x == b.x and (a.y < b.y or (a.y == b.y and a.z < b.z)))


@ti.kernel
def line_up(x: Vectors, order: Integers):
    """Sort the bodies of each environment by where they are, by insertion: they move little in a step."""
    for env in range(x.shape[0]):
        for p in range(1, x.shape[1]):
            body = order[env, p]
            at = p
            while at > 0:
                other = order[env, at - 1]
                if not before(x[env, body], x[env, other]):
                    break
                order[env, at] = other
                at = at - 1
            order[env, at] = body


@ti.kernel
def clear(force: Vectors, touching: Counts):
    """Before `race`."""
    for env, body in force:
        force[env, body] = tm.vec3(0.0)
        if body == 0:
            touching[env] = 0


@ti.kernel
def race(x: Vectors, v: Vectors, force: Vectors, traits: Traits, touching: Counts):
    """Forces between bodies, a pair a thread, added by atomic operations in the order in which threads arrive."""
    for env, p, q in ti.ndrange(x.shape[0], x.shape[1], x.shape[1]):
        if q < p:
            f = between(x[env, p], x[env, q], v[env, p], v[env, q], traits[p], traits[q])
            if f.x != 0.0 or f.y != 0.0 or f.z != 0.0:
                ti.atomic_add(force[env, p], f)
                ti.atomic_sub(force[env, q], f)
                ti.atomic_add(touching[env], 1)


@ti.kernel
def advance_all(
    dt: ti.f32, gravity: tm.vec3, x: Vectors, v: Vectors, spin: Vectors, force: Vectors, traits: Traits, faces: Faces,
    places: Places, touching: Counts,
):  # fmt: skip
    """After `race`."""
    for env, body in x:
        touched = advance(env, body, dt, gravity, force[env, body], places[env], x, v, spin, traits, faces)
        ti.atomic_add(touching[env], touched)


@ti.kernel
def shift(x: Vectors, metres: Shifts, ulps: Counts):
    """Move all bodies of each environment along x, and the last one by units in the last place of its x."""
    for env in range(x.shape[0]):
        for body in range(x.shape[1]):
            x[env, body].x = x[env, body].x + metres[env]
        last = x.shape[1] - 1
        x[env, last].x = ti.bit_cast(ti.bit_cast(x[env, last].x, ti.i32) + ulps[env], ti.f32)


@ti.kernel
def store(
    row: ti.i32, x: Vectors, v: Vectors, spin: Vectors, touching: Counts, xs: Rows, vs: Rows, spins: Rows,
    counts: Integers,
):  # fmt: skip
    """Keep the present state and counts as a row."""
    for env, body in x:
        xs[row, env, body] = x[env, body]
        vs[row, env, body] = v[env, body]
        spins[row, env, body] = spin[env, body]
        if body == 0:
            counts[row, env] = touching[env]
