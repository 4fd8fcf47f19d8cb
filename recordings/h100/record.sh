#!/usr/bin/env bash
# Records the set of this folder anew, on a machine with one GPU and nothing else at work on it.
#
#   recordings/h100/record.sh OUT            a second call continues where the first stopped
#   recordings/h100/record.sh OUT NAME...    these simulators alone
#
# RECORD is the command (gsb-record). UNTIL, in seconds since 1970, is when no further group of runs begins.
set -uo pipefail
OUT=$1
shift
RECORD=${RECORD:-gsb-record}
UNTIL=${UNTIL:-9999999999}
simulators=( # a name, and its options
  "warp --sim warp"
  "newton-mujoco --sim newton --solver mujoco"
  "newton-xpbd --sim newton --solver xpbd"
  "mjx-jax --sim mjx --impl jax"
  "mjx-warp --sim mjx --impl warp"
  "playground --sim playground"
  "brax --sim brax"
  # each of these is in an environment of its own: gsb-record --setup NAME
  "genesis --sim genesis"
  "physx --sim physx"
  "isaaclab-ovphysx --sim isaaclab --backend ovphysx"
  "isaaclab-newton --sim isaaclab --backend newton"
)
if [ $# -gt 0 ]; then
  chosen=()
  for name in "$@"; do
    for one in "${simulators[@]}"; do [ "${one%% *}" = "$name" ] && chosen+=("$one"); done
  done
  simulators=("${chosen[@]}")
fi
# ten runs of 16 environments: steps 100 to 200 are timed, every captured step is fingerprinted, three states are kept
protocol="--n-env 16 --runs 10 --timed-steps 100 --stride 250 --no-view --compression zstd"
# two runs with every state of the first half second
dense="--n-env 16 --runs 2 --phases capture --steps 50 --compression zstd"

group() { # KIND, number of runs, name of a simulator, options: records a group that is not there yet
  local kind=$1 runs=$2 simulator=$3
  local folder=$OUT/$kind/$simulator
  shift 3
  [ "$(date +%s)" -ge "$UNTIL" ] && return
  [ "$(find "$folder" -name '*.mcap' 2> /dev/null | wc -l)" -ge "$runs" ] && return
  rm -rf "$folder"
  $RECORD "$@" --timeout 240 --out "$folder" > "$OUT/$kind-$simulator.txt" 2>&1
  echo "$kind of $simulator ended with exit code $? at $(date +%T)"
}

mkdir -p "$OUT"
# shellcheck disable=SC2086
{
  # kernels first, all beside each other, so that no timed run shares the GPU with a compiler
  for one in "${simulators[@]}"; do group kernels 1 $one --n-env 16 --runs 1 --phases capture --steps 2 & done
  wait
  for one in "${simulators[@]}"; do group protocol 10 $one $protocol; done
  for one in "${simulators[@]}"; do group dense 2 $one $dense & done
  wait
}
