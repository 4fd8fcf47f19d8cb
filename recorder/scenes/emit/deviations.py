"""What several engines do otherwise than a scene says, in the same way."""

from __future__ import annotations

from collections.abc import Iterable

from gpusimbench.recorder.scenes.base import Material, Robot, Scene
from gpusimbench.schemas.provenance import Deviation

LARGER = "the larger coefficient of the two"
MEAN = "the mean of the two coefficients"


def materials(scene: Scene) -> list[Material]:
    """The materials of the scene's bodies, each name once."""
    return list({body.material.name: body.material for body in scene.bodies}.values())


def materials_and_robot(scene: Scene) -> list[Material]:
    """The materials of the scene's bodies and its robot, each name once."""
    robot = [] if scene.robot is None else [scene.robot.material]
    return list({material.name: material for material in (*materials(scene), *robot)}.values())


def combination(what: str, rule: str, why: str) -> Deviation:
    """How the coefficients of two surfaces, of "friction" or "restitution", become that of the pair."""
    return Deviation(f"contact.{what}_combination", "not given", rule, why)


def one_friction(material: Material, why: str) -> Deviation:
    """The kinetic coefficient stands for the static one as well."""
    return Deviation(
        f"{material.name}.static_friction", str(material.static_friction), str(material.kinetic_friction), why
    )


def other_restitution(material: Material, used: str, why: str) -> Deviation:
    """What stands for the material's coefficient of restitution."""
    return Deviation(f"{material.name}.restitution", str(material.restitution), used, why)


def springs(materials: Iterable[Material], friction: str, used: str, why: str) -> list[Deviation]:
    """Where contacts are springs, two deviations of each material: `one_friction`, and `other_restitution`.

    friction, why  their reasons
    used           in the place of the coefficient of restitution
    """
    return [said for one in materials for said in (one_friction(one, friction), other_restitution(one, used, why))]


def rest_offset(offset: float) -> list[Deviation]:
    """A pair of shapes rests apart by what the option 'rest_offset' says of each [m]."""
    if not offset:
        return []
    return [Deviation("bodies.shape", "as given", f"a pair rests {2 * offset:g} m apart", "option 'rest_offset'")]


def unlimited_speed(robot: Robot, why: str) -> Deviation:
    """The published speed limits of the joints, which are not enforced."""
    return Deviation(
        "joint.max_velocity", " ".join(str(joint.max_velocity) for joint in robot.joints()), "not enforced", why
    )
