"""What Genesis tells of its steps: counts, and the error codes at which it stops."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.simulators.evidence import CONSTRAINT_ROWS, CONTACTS
from gpusimbench.recorder.simulators.genesis.environments import GenesisSizes
from gpusimbench.schemas.provenance import Buffer, Counter, OverflowBit

BROAD_PAIRS = Counter("broad_phase_pairs", "pairs of shapes that the broad phase let through")

COUNTERS = (CONTACTS, CONSTRAINT_ROWS, BROAD_PAIRS)

_DROPPED = "OVERFLOW_"  # beginning of the names of codes that mean lost contacts; the others mean numbers gone bad


class Watch:
    """The error codes of the steps since they were last told, kept on the device, and the counts of the last step.

    Genesis looks at its codes at every tenth substep and raises for the whole batch if it finds any. Here they are
    taken out of its hands, kept, and stepping goes on, so that a recording shows what happened.
    """

    def __init__(self, solver: Any) -> None:
        import torch
        from genesis.utils.array_class import ErrorCode
        from genesis.utils.misc import qd_to_torch

        self._solver = solver
        self._codes = {int(code): code.name for code in ErrorCode if code}
        self._as_tensor = qd_to_torch
        self._kept = torch.zeros_like(self._raised())  # taken from the engine, and not told as bits yet
        self._unsaid = torch.zeros_like(self._kept)  # not said as a gate yet

    @property
    def overflow_bits(self) -> tuple[OverflowBit, ...]:
        """Genesis' error codes. Those of numbers gone bad are not fatal here, since their sentence is a gate."""
        return tuple(
            OverflowBit(code.bit_length() - 1, name, fatal=name.startswith(_DROPPED))
            for code, name in self._codes.items()
        )

    def tell(self, codes: Any) -> None:
        """Enqueue: copy the codes since the last call into an integer tensor [env] on the device."""
        self._keep()
        codes.copy_(self._kept)
        self._kept.zero_()

    def counts(self) -> tuple[Any, ...]:
        """Counts of the last step in the order of COUNTERS: integer tensors [env] on the device."""
        collider, constraints = self._solver.collider.collider_state, self._solver.constraint_solver.constraint_state
        return tuple(
            self._as_tensor(counted)
            for counted in (collider.n_contacts, constraints.n_constraints, collider.n_broad_pairs)
        )

    def take(self) -> bool:
        """Keep the codes that are raised and take them from the engine; False where there are none."""
        if not bool(self._raised().any()):
            return False
        self._keep()
        return True

    def _keep(self) -> None:
        raised = self._raised()
        self._kept |= raised
        self._unsaid |= raised
        self._solver.data_manager.errno.fill(0)

    def gates(self) -> list[str]:
        """The engine's words for the codes that were raised since the last call."""
        self._keep()
        if not bool(self._unsaid.any()):
            return []
        errno = self._solver.data_manager.errno
        errno.from_numpy(self._unsaid.cpu().numpy())  # the engine finds words for its own codes alone
        said = self._sentences()
        errno.fill(0)
        self._unsaid.zero_()
        return said

    def _raised(self) -> Any:
        return self._as_tensor(self._solver.data_manager.errno)

    def _sentences(self) -> list[str]:
        from genesis import GenesisException

        envs = self._solver.get_error_envs_mask()
        try:
            self._solver.check_errno()
        except GenesisException as error:
            return [f"Genesis, of {int(envs.sum())} of {len(envs)} envs: {error}"]
        return []


def buffers(solver: Any, sizes: GenesisSizes) -> tuple[Buffer, ...]:
    """The capacities that the built solver has."""
    info = solver.collider.collider_info
    return (
        Buffer(
            "max_candidate_contacts", int(info.max_candidate_contacts[None]), "env", "",
            f"what max_collision_pairs {int(info.max_collision_pairs[None])} can have, {sizes.pairs_by}",
        ),
        Buffer("max_contacts", int(info.max_contacts[None]), "env", CONTACTS.name, sizes.contacts_by),
        Buffer(
            "max_collision_pairs_broad", int(info.max_collision_pairs_broad[None]), "env", BROAD_PAIRS.name,
            "broad_phase_multiplier times max_collision_pairs, at most all pairs that there are",
        ),
    )  # fmt: skip
