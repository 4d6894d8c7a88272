#!/usr/bin/env bash
# A sweep on a real Slurm of one node: by 1 job and by 8, of which one is preempted and one is killed.
# Usage, as root: run.sh DIR
set -euo pipefail

[ $# = 1 ] || { echo "usage: $0 DIR" >&2; exit 2; }
here=$(cd "$(dirname "$0")" && pwd)
generate=$here/../../.venv/bin/nlos-generate
python=$here/../../.venv/bin/python
"$here/start.sh" "$1/slurm" 8
export SLURM_CONF=$1/slurm/slurm.conf
trap '"$here/stop.sh" "$1/slurm"' EXIT
# Eight jobs share this machine's cores, so each takes one worker of one thread.
common=(--poses 12 --resolution 16 --samples 256 --engine patch --workers 1 --cluster slurm --job timeout_min=60
    --job cpus_per_task=1 --job slurm_partition=main)

"$generate" scene room --target sphere -o "$1/room.blend"
echo "== one job"
"$generate" sweep "$1/room.blend" -o "$1/one" "${common[@]}" --jobs 1

echo "== eight jobs"
"$generate" sweep "$1/room.blend" -o "$1/eight" "${common[@]}" --jobs 8 >"$1/eight.out" 2>&1 &
sweep=$!
until [ "$(squeue -h -t running -o %i | wc -l)" = 8 ] && [ "$(find "$1/eight" -name '[0-9]*.exr' | wc -l)" -gt 8 ]; do
    sleep 0.5
    kill -0 "$sweep"
done
victim=$(squeue -h -r -t running -o %i | sort | head -1)
echo "killed: job $victim, with $(find "$1/eight" -name '[0-9]*.exr' | wc -l) pictures done"
scancel --signal=KILL --full "$victim"
sleep 2
echo "preempted, by an urgent job that asks for 7 of the 8 CPUs:"
sbatch --quiet --partition=urgent --cpus-per-task=7 --output=/dev/null --wrap "sleep 10"
sleep 4
squeue -r -o "%.12i %.9P %.12T %.10M %.8r"
code=0
wait "$sweep" || code=$?
cat "$1/eight.out"
echo "exit code $code"
scontrol -o show job | grep -o "Restarts=[1-9]*" | sort | uniq -c || true

echo "== the same command again"
"$generate" sweep "$1/room.blend" -o "$1/eight" "${common[@]}" --jobs 8
"$generate" verify "$1/eight"
"$python" - "$1/one" "$1/eight" <<'CODE'
import sys
from pathlib import Path
from generator.sets.dataset import Dataset

one, eight = ([pose.pixel_hash for pose in Dataset.open(Path(path)).poses] for path in sys.argv[1:])
print(f"{len(one)} pictures by one job and by eight: {sum(a != b for a, b in zip(one, eight))} differ")
sys.exit(one != eight)
CODE
