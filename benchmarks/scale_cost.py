"""What many recordings cost, from what one costs: sums, without any measurement."""

from __future__ import annotations

from dataclasses import dataclass

_GB = 1e9
_HOUR = 3600.0


@dataclass(frozen=True)
class Rates:
    """What was measured.

    recorded_bytes       of a run as recorded
    archived_bytes       of the same, packed by gsb-share
    pack_s               packing a run, both copies verified [CPU s]
    verify_s_per_gb      checking every byte of runs as recorded [CPU s / 1e9 bytes]
    verify_archived_s    checking every byte of a packed run [CPU s]
    read_s               reading what metrics need of a run, without checking digests [CPU s]
    read_archived_s      the same of a packed run [CPU s]
    summary_bytes        memory that a run takes once its file is closed, its part of the results included
    env_pairs_s          W1 between all pairs of environments of a run [CPU s]
    run_pair_s           W1 between two runs [CPU s]
    floor_s              permutation floors of a group [CPU s]
    certified_s          W1 between two sets of `certified_points` points [CPU s]
    certified_points     points of each
    pair_of_groups_s     asking whether the runs of two groups are the same by bits [CPU s]
    table_bytes          Parquet of an evaluation of one group
    next_group_bytes     Parquet of each further group
    """

    recorded_bytes: float
    archived_bytes: float
    pack_s: float
    verify_s_per_gb: float
    verify_archived_s: float
    read_s: float
    read_archived_s: float
    summary_bytes: float
    env_pairs_s: float
    run_pair_s: float
    floor_s: float
    certified_s: float
    certified_points: int
    pair_of_groups_s: float
    table_bytes: float
    next_group_bytes: float

    def group_s(self, runs: int) -> float:
        """Evaluating one group of runs as recorded, every byte verified [CPU s]."""
        reading = self.verify_s_per_gb * self.recorded_bytes / _GB + self.read_s
        return runs * (reading + self.env_pairs_s) + pairs(runs) * self.run_pair_s + self.floor_s


@dataclass(frozen=True)
class Prices:
    """Assumed prices [$].

    core_hour  of one core for an hour
    gb_month   of 1e9 bytes kept for a month
    gb_egress  of 1e9 bytes sent out of where they are kept
    """

    core_hour: float = 0.04
    gb_month: float = 0.023
    gb_egress: float = 0.09


@dataclass(frozen=True)
class Plan:
    """What is to be evaluated.

    recordings  all of them
    runs        of a group
    cores       that work at the same time
    shard       groups of one gsb-eval
    """

    recordings: int
    runs: int
    cores: int
    shard: int

    @property
    def groups(self) -> int:
        """Groups of equal configuration; the last may be smaller."""
        return -(-self.recordings // self.runs)


def pairs(count: int) -> int:
    """Unordered pairs of different things."""
    return count * (count - 1) // 2


def extrapolate(rates: Rates, plan: Plan, prices: Prices, certified_pairs: int) -> list[tuple[str, str, str]]:
    """Rows of a table: what, how much of runs as recorded, how much of packed runs.

    certified_pairs  pairs of runs that are solved of a group, where runs are too large for an exact distance
    """
    n, groups = plan.recordings, plan.groups
    sizes = (rates.recorded_bytes * n / _GB, rates.archived_bytes * n / _GB)
    verifying = (rates.verify_s_per_gb * sizes[0], rates.verify_archived_s * n)
    reading = (rates.read_s * n, rates.read_archived_s * n)
    in_runs, between = rates.env_pairs_s * n, pairs(plan.runs) * rates.run_pair_s * groups
    floors = rates.floor_s * groups
    totals = tuple(v + r + in_runs + between + floors for v, r in zip(verifying, reading, strict=True))
    walls = tuple(total / plan.cores for total in totals)
    certified = certified_pairs * rates.certified_s * groups
    shards = -(-groups // plan.shard)
    tables = shards * rates.table_bytes + (groups - shards) * rates.next_group_bytes

    def formatted(values: tuple[float, ...], form: str) -> tuple[str, str]:
        return form.format(values[0]), form.format(values[1])

    def hours(*seconds: float) -> tuple[str, str]:
        return formatted(tuple(s / _HOUR for s in seconds), "{:,.1f}")

    return [
        ("files [GB]", *formatted(sizes, "{:,.0f}")),
        ("verifying [core h]", *hours(*verifying)),
        ("reading [core h]", *hours(*reading)),
        ("W1, environments of a run [core h]", *hours(in_runs, in_runs)),
        (f"W1, {pairs(plan.runs)} pairs of runs a group [core h]", *hours(between, between)),
        ("floors [core h]", *hours(floors, floors)),
        ("all of it [core h]", *hours(*totals)),
        (f"by the clock on {plan.cores} cores [h]", *hours(*walls)),
        ("read meanwhile [GB/s]", *formatted(tuple(s / w for s, w in zip(sizes, walls, strict=True)), "{:,.2f}")),
        ("packing, once [core h]", "-", f"{rates.pack_s * n / _HOUR:,.1f}"),
        (
            f"instead, {certified_pairs} certified pairs a group [core h]",
            *hours(certified, certified),
        ),
        ("all groups compared by bits at once [core h]", *hours(*(pairs(groups) * rates.pair_of_groups_s,) * 2)),
        (
            f"  in shards of {plan.shard} groups [core h]",
            *hours(*(shards * pairs(plan.shard) * rates.pair_of_groups_s,) * 2),
        ),
        ("summaries at once [GB]", *formatted((rates.summary_bytes * n / _GB,) * 2, "{:,.1f}")),
        (
            f"  in shards of {plan.shard} groups [GB]",
            *formatted((rates.summary_bytes * plan.shard * plan.runs / _GB,) * 2, "{:,.2f}"),
        ),
        ("tables [GB]", *formatted((tables / _GB,) * 2, "{:,.2f}")),
        ("cores [$]", *formatted(tuple(t / _HOUR * prices.core_hour for t in totals), "{:,.0f}")),
        ("files kept, a month [$]", *formatted(tuple(s * prices.gb_month for s in sizes), "{:,.0f}")),
        ("files sent out once [$]", *formatted(tuple(s * prices.gb_egress for s in sizes), "{:,.0f}")),
    ]
