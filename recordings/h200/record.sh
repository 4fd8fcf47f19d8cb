#!/usr/bin/env bash
# Records the set of this folder anew: each job below is one command of gsb-record.
#
#   recordings/h200/record.sh OUT [JOB...]      JOB: numbers from the list below (default: all)
#
# Jobs are shared out to all GPUs that nvidia-smi shows, or to those of GPUS ("0 1"), one job on a GPU at a time. A second
# call continues where the first stopped. RUNS (default 10), PART_RUNS (5), SWEEP (1..131072:8) and SWEEP_RUNS (1) shorten
# it; RECORD is the command (gsb-record). What an engine refuses or cannot do is recorded as such, so the script goes on.
set -uo pipefail
cd "$(dirname "$0")/../.."
OUT=$1; shift
RECORD=${RECORD:-gsb-record}
mkdir -p "$OUT"

# 16 identical environments; every step is fingerprinted, and the states of steps 0, 250 and 500 are kept
collision="--sweep 16..16 --runs ${RUNS:-10} --stride 250"
slow="--sweep 16..16 --runs ${SLOW_RUNS:-5} --stride 250 --warmup 20 --timed-steps 100"  # MJX takes its time for this scene
few="--sweep 16..16 --runs 3 --stride 250"
part="--sweep 16..16 --runs ${PART_RUNS:-5} --stride 250"
# throughput and memory up to the largest number of environments
sweep="--sweep ${SWEEP:-1..131072:8} --runs ${SWEEP_RUNS:-1} --phases timed --timed-steps 200"
jobs=(
  "--sim warp $collision"
  "--sim mjx --impl jax $slow"
  "--sim newton --solver mujoco $collision"
  "--sim newton --solver xpbd $collision"
  "--sim playground $collision"
  "--sim mjx --impl jax --determinism run-to-run $slow"
  "--sim warp --scene free-fall $sweep"
  "--sim warp --scene franka $sweep"
  "--sim warp --determinism contacts-constraint $collision"
  "--sim newton --solver xpbd --determinism run-to-run $collision"
  "--sim newton --solver mujoco --determinism run-to-run $collision"
  "--sim mjx --impl jax --scene franka $sweep"
  "--sim mjx --impl warp $collision"
  "--sim newton --solver xpbd --scene free-fall $sweep"
  "--sim warp --determinism atomics $few"
  "--sim warp --determinism run-to-run $few"
  "--sim warp --determinism warp-run-to-run $few"
  "--sim mjx --impl jax --determinism exclude-nondeterministic $slow"
  "--sim mjx --impl jax --determinism no-autotune $slow"
  "--sim newton --solver steel $few"
  "--sim newton --solver mujoco --scene free-fall $sweep"
  "--sim playground --impl jax $slow"
  "--sim brax --solver positional $few"
  "--sim brax --solver spring $few"
  "--sim playground --scene franka $sweep"
  "--sim mjx --impl jax --scene free-fall $sweep"
  # from here on each simulator is in an environment of its own: gsb-record --setup NAME
  "--sim genesis $collision"
  "--sim physx $collision"
  "--sim isaaclab --backend ovphysx $collision"
  "--sim isaaclab --backend newton $collision"
  "--sim physx --option spacing=0 $part"
  "--sim physx --determinism enhanced $part"
  "--sim genesis --option performance_mode=true $part"
  "--sim isaaclab --backend ovphysx --option spacing=0 $part"
  "--sim physx --scene free-fall $sweep"
  "--sim genesis --scene free-fall $sweep"
  "--sim genesis --scene franka $sweep"
  "--sim isaaclab --backend ovphysx --scene free-fall $sweep"
  "--sim isaaclab --backend newton --scene free-fall $sweep"
  "--sim physx --scene franka $sweep"
  "--sim calibration --option regime=identical $few"
  "--sim calibration --option regime=atomics $few"
)
if [ $# -gt 0 ]; then wanted=("$@"); else wanted=($(seq 1 ${#jobs[@]})); fi

queue=$(mktemp); printf '%s\n' "${wanted[@]}" > "$queue"
next() { # takes the first line off the queue
  exec 9>> "$queue.lock"; flock 9; head -n 1 "$queue"; sed -i 1d "$queue"; exec 9>&-
}
work() { # on one GPU
  local job
  while job=$(next) && [ -n "$job" ]; do
    echo "job $job on GPU $1: ${jobs[job - 1]}"
    # shellcheck disable=SC2086
    CUDA_VISIBLE_DEVICES=$1 $RECORD ${jobs[job - 1]} --compression zstd --timeout 240 --out "$OUT" > /dev/null
    echo "job $job ended with exit code $?"
  done
}
for gpu in ${GPUS:-$(seq 0 $(($(nvidia-smi -L | wc -l) - 1)))}; do work "$gpu" & done
wait
rm -f "$queue" "$queue.lock"
