#!/usr/bin/env bash
# End the Slurm that start.sh started, its jobs included.
# Usage, as root: stop.sh DIR
set -uo pipefail

[ $# = 1 ] || { echo "usage: $0 DIR" >&2; exit 2; }
dir=$(cd "$1" && pwd -P) || exit 2
export SLURM_CONF=$dir/slurm.conf

if timeout 10 scontrol ping >/dev/null 2>&1; then
    scancel --state=PENDING --me
    scancel --me
    for _ in $(seq 30); do
        [ -z "$(timeout 10 squeue -h)" ] && break
        sleep 1
    done
fi
for name in slurmd slurmctld munged; do
    pid=$(cat "$dir/$name.pid" 2>/dev/null) || continue
    [ "$(cat "/proc/$pid/comm" 2>/dev/null)" = "$name" ] || continue
    kill "$pid"
    for _ in $(seq 30); do
        grep -qs '^State:[[:space:]]*[^Z]' "/proc/$pid/status" || break
        sleep 1
    done
done
