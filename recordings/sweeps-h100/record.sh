#!/usr/bin/env bash
# Records the set of this folder anew: sweeps over the number of environments, three runs a point.
#
#   recordings/sweeps-h100/record.sh OUT [NAME...]      NAME: sweeps from the list below, in this order (default: all)
#
# For several GPUs, start the script once on each, with the same OUT and another CUDA_VISIBLE_DEVICES: they share the
# points. A later call continues where the earlier calls stopped. RECORD is the command (gsb-record). UNTIL, in seconds
# since 1970, is when no further point begins. What an engine refuses or cannot do is recorded as such.
set -uo pipefail
OUT=$1
shift
RECORD=${RECORD:-gsb-record}
UNTIL=${UNTIL:-9999999999}
sweeps=( # name, numbers of environments, options
  "warp-franka|512 4096 32768 65536 131072|--sim warp --scene franka"
  "warp-free-fall|512 4096 16384 32768 65536|--sim warp --scene free-fall"
  "newton-xpbd-free-fall|512 4096 32768 65536 131072|--sim newton --solver xpbd --scene free-fall"
  "newton-mujoco-free-fall|512 4096 8192 16384 32768|--sim newton --solver mujoco --scene free-fall"
  "newton-mujoco-franka|512 4096 32768 65536|--sim newton --solver mujoco --scene franka"
  "mjx-franka|512 4096 8192 16384 32768|--sim mjx --impl jax --scene franka"
  "mjx-free-fall|16 64 256 1024 4096|--sim mjx --impl jax --scene free-fall"
  # each of these is in an environment of its own: gsb-record --setup NAME
  "physx-free-fall|512 4096 8192 16384 32768|--sim physx --scene free-fall"
  "physx-franka|512 4096 16384 32768 65536|--sim physx --scene franka"
  "isaaclab-ovphysx-free-fall|64 256 512 1024 2048 4096|--sim isaaclab --backend ovphysx --scene free-fall"
  "genesis-franka|512 4096 32768 65536 131072|--sim genesis --scene franka"
  "genesis-free-fall|512 4096 8192 16384 32768|--sim genesis --scene free-fall"
)
# the least that protocol-2 takes: steps 100 to 200, again and again until they took a second
timed="--phases timed --timed-steps 100 --runs 3 --compression zstd --timeout 240"

point() { # NAME, N, options: records a point that no other call of this script has begun
  local folder=$OUT/$1-n$2
  [ "$(date +%s)" -ge "$UNTIL" ] && return
  [ -e "$folder/ended" ] && return
  mkdir -p "$folder"
  exec 9> "$folder/claim"
  flock --nonblock 9 || return
  # shellcheck disable=SC2086
  $RECORD $3 --sweep "$2..$2" $timed --out "$folder" > "$folder/output.txt" 2>&1 9>&-
  echo "$1, $2 environments, ended with exit code $? at $(date +%T)" | tee "$folder/ended"
}

[ $# -gt 0 ] || set -- "${sweeps[@]%%|*}"
for name in "$@"; do
  for sweep in "${sweeps[@]}"; do
    IFS='|' read -r known numbers options <<< "$sweep"
    [ "$known" = "$name" ] || continue
    for n in $numbers; do point "$name" "$n" "$options"; done
  done
done
