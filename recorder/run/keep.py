"""What --keep takes, and what does not go together with it."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.schemas.configuration import CAPTURE_MODES, RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.treatment import KINDS, MOST_METRES, Intervention, Keep


def parse(text: str) -> str:
    """What --keep was given, as the recording keeps it. UsageError where it is nothing that can be kept."""
    try:
        return str(Keep.parse(text))
    except ValueError:
        raise UsageError(
            "--keep is failing or failing,within:METRES, with a distance above 0 and at most "
            f"{MOST_METRES:g} m, not '{text}'"
        ) from None


def check(configuration: RunConfiguration, scene: Scene) -> None:
    """UsageError where a run that keeps failing environments alone cannot do what else is asked."""
    c = configuration
    if not c.keep:
        return
    whose = f"--keep {c.keep}"
    if "capture" not in c.phases:
        raise UsageError(f"{whose} is of captured states, and --phases has no capture")
    if c.stride != 1:
        raise UsageError(f"{whose} keeps every step before a failure; leave --stride out")
    if c.capture != CAPTURE_MODES[0]:
        raise UsageError(f"{whose} writes little, when an environment fails; leave --capture {c.capture} out")
    if c.view:
        raise UsageError(f"{whose} writes no states while nothing fails, so viewers have none; leave --view-env out")
    if c.snapshots or c.first_step:
        raise UsageError(f"{whose} goes together with neither --snapshot nor --from")
    intervention = Intervention.of(c.intervention)
    if intervention and not intervention.kind.poisons:
        alone = " or ".join(kind.form for kind in KINDS.values() if kind.poisons)
        raise UsageError(f"{whose} goes together with --intervene {alone} alone, not with {c.intervention}")
    if Keep.parse(c.keep).within is not None and not scene.groups():
        raise UsageError(
            f"{whose}: scene '{scene.name}' has no free bodies, whose positions could leave bounds; use --keep failing"
        )
