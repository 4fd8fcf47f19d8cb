"""What the help of gsb-record says beside its options."""

from __future__ import annotations

EPILOG = """\
exit codes:
  0  every run is complete; of a sweep, every run below its last point, and at least one run
  1  a run failed or is INVALID (its recording gives the reason), or a replay exceeded its limits and was stopped
  2  wrong usage
  3  a run's process died, or the disk was full: data was lost

sweeps:
  --sweep records each number of environments, smallest first, and ends after the first number at which every run fails
  or is INVALID. A sweep searches for this limit, so such a failure does not make the command fail. If the first run of
  a number runs out of memory or of a buffer, is refused or times out, the other runs of this number are skipped.
  To continue a sweep, repeat the command with the same --out: existing recordings are kept. Two commands cannot record
  the same sweep in one folder at once: the second ends with exit code 1 and names the process of the first.

sets of runs:
  To continue an interrupted set, repeat the command with the same --out: only the runs that are not there are made. If
  the folder holds all --runs, the command makes as many again. After a refusal, all runs are made anew.

replays:
  --replay FILE repeats the run of a recording on this machine, with the recorded configuration, which is printed first
  and checked like arguments. The scene must be the same. --option (and --impl, --device...) replaces recorded options,
  and the new recording stores that. --runs, --phases, --view-env, --timeout, --python and --out are not taken from the
  recording.
  --replay FILE --from STEP begins at a snapshot that --snapshot STEP saved, and captures the states from there on. The
  engine loads the snapshot unchecked: continue only recordings of people whose code you would run.
  A replay that uses more memory, threads or disk than its recording accounts for is stopped, and its files are deleted.
  gsb-audit FILE replays a recording and compares the results.

clusters:
  --ray ADDRESS makes one run at a time on each GPU of a Ray cluster (on each node, if runs step on the CPU), and copies
  the recordings to --out on this machine. Only machines of one kind are used: the most frequent kind, or the kind with
  the resource --ray-resource. Every node needs this version of the project and the engine; see docs/cluster.md.

environments:
  Engines whose packages conflict with others get a Python environment each. --setup NAME makes the environment, in
  $GSB_ENVIRONMENTS or the user's data folder, from pinned requirements with hashes; later runs of this simulator use
  it. --python PATH uses an environment of your own. torch is installed as pip is configured on this machine.

files:
  OUT/SIM-SCENE-nN-rR-TIME.mcap  run R, begun at TIME (UTC); SIM with its solver and level of determinism
  OUT/NAME.mcap.partial  a run that is being made, or what a crash left of it, for gsb-share recover

see also:
  gsb-eval, which computes what the runs show
  gsb-audit, which replays and compares
  docs/simulators.md
  docs/timing.md

examples:
  gsb-record --list mujoco
  gsb-record --sim mujoco
  gsb-record --sim mujoco --scene free-fall --n-env 64 --runs 3 --out falling/
  gsb-record --sim mujoco --option cone=pyramidal --option integrator=Euler
  gsb-record --sim mujoco --scene free-fall --sweep 1..131072:4 --runs 3 --phases timed --timeout 600
  gsb-record --setup genesis && gsb-record --sim genesis
  gsb-record --replay theirs.mcap --runs 3
  gsb-record --sim real --trials trials.csv --unit cm
"""

USAGE = """\
%(prog)s --sim NAME [options]
       %(prog)s --sim real --trials CSV --unit {m,cm} [options]
       %(prog)s --replay FILE [options]
       %(prog)s --setup NAME [--python PATH]
       %(prog)s --list [NAME] [--json]"""
