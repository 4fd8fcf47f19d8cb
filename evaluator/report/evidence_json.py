"""Price list, capability, divergence and what is compared, as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from gpusimbench.evaluator.json_values import entry, picked
from gpusimbench.evaluator.metrics.divergence import FIT_LIMIT_M, first_reaching
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.report.timed import timed_record
from gpusimbench.evaluator.results.determinism_cost import Cost, Family, Price
from gpusimbench.evaluator.results.faults import Faults, faults
from gpusimbench.evaluator.results.fidelity import CheckVerdict
from gpusimbench.evaluator.results.metric import Estimate
from gpusimbench.evaluator.results.paper_tables import AtMax, Capability
from gpusimbench.evaluator.results.ranking import Contender
from gpusimbench.evaluator.results.result import GroupResult, RunSpread


def family_record(family: Family) -> dict[str, Any]:
    """A configuration under all its levels of determinism."""
    first = family.base or family.prices[0].result
    return {
        **picked(first.group.key, "simulator scene n_env device"),
        "options": first.group.recordings[0].configuration.options,
        "default": _level(family.base) if family.base else None,
        "levels": [_price(price) for price in family.prices],
    }


def capability_record(row: Capability) -> dict[str, Any]:
    """A simulator at its N_env^max, by scene."""
    return {
        "label": row.label,
        **picked(row.key, "simulator version device determinism"),
        "elsewhere": list(row.elsewhere),
        "scenes": {scene: _at_max(at) for scene, at in row.at.items()},
    }


def divergence_records(result: GroupResult) -> list[dict[str, Any]]:
    """How the environments of each complete run moved apart."""
    return [_spread(one) for one in result.spreads]


def contender_record(contender: Contender) -> dict[str, Any]:
    """What radar, dot plots and guidelines are made of; a value that is missing has its reason."""
    checked = contender.group.fidelity if contender.group else None
    return {
        "name": contender.figures.name,
        "group": contender.group.label if contender.group else None,
        "sweep": contender.sweep.label if contender.sweep else None,
        "sweep_with_robot": contender.robot.label if contender.robot else None,
        "n_env_max": contender.figures.n_max,
        "values": {
            axis.value: entry("value", found) if isinstance(found, Missing) else estimate_record(found)
            for axis, found in contender.metrics.items()
        },
        "checks_broken": len(checked.of(CheckVerdict.BROKEN)) if checked and checked.rows else None,
        "checks_held": checked.held if checked and checked.rows else None,
        "checks_by": checked.revision.value if checked and checked.rows else None,
        "timed": timed_record(contender.speed.timed) if contender.speed else None,
        "barred": contender.figures.barred,
        "barred_with_robot": contender.figures.barred_articulated,
    }


def faults_record(found: Faults) -> dict[str, str]:
    """What speaks against a group, each empty where nothing was found."""
    return vars(found)


def _level(result: GroupResult) -> dict[str, Any]:
    return {
        "group": result.label,
        "determinism": result.group.key.determinism,
        "outcomes": result.group.outcomes,
        "distinct_envs": known(result.metrics["distinct_envs"].value),
        "distinct_runs": known(result.metrics["distinct_runs"].value),
        "faults": faults_record(faults(result)),
        "timed": timed_record(result.timed),
    }


def _price(price: Price) -> dict[str, Any]:
    costs = {"throughput_of_default": _cost(price.speed), "memory_of_default": _cost(price.memory)}
    return {**_level(price.result), "in_force": list(price.differs), **costs}


def _cost(cost: Cost) -> dict[str, Any]:
    return {
        **picked(cost, "ratio ci95"),
        "cannot_be_told_apart_from_1": cost.undecided,
    }


def _at_max(at: AtMax) -> dict[str, Any]:
    return {
        "n_env_max": at.n_max,
        "fps": estimate_record(at.fps) if at.fps else None,
        "memory": estimate_record(at.memory) if at.memory else None,
        "limit": at.limit.name.lower(),
        "ends": at.ends,
        "contacts_per_env": at.contacts,
        "timed": timed_record(at.timed) if at.timed else None,
        "faults": faults_record(at.faults),
    }


def estimate_record(estimate: Estimate) -> dict[str, Any]:
    """The figures of an estimate, or why there are none."""
    return {"metric": estimate.name, **picked(estimate, "value unit sd ci95 n")}


def _spread(one: RunSpread) -> dict[str, Any]:
    found = one.spread
    if isinstance(found, Missing):
        return {"run": one.run, "missing": found.reason}
    times, largest = np.array(found.times), np.array([np.nan if v is None else v for v in found.largest])
    apart = np.flatnonzero(largest > 0)
    return {
        "run": one.run,
        "missing": "",
        "recorded_steps": len(found.steps),
        "first_apart_s": float(times[apart[0]]) if len(apart) else None,
        "reaches_limit_s": first_reaching(times, largest, FIT_LIMIT_M),
        f"limit_{found.unit}": FIT_LIMIT_M,
        f"largest_at_end_{found.unit}": found.largest[-1],
        f"rms_at_end_{found.unit}": found.rms[-1],
        **picked(found, "fit"),
    }
