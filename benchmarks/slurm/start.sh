#!/usr/bin/env bash
# Start a one-node Slurm (munged, slurmctld, slurmd) on this Debian machine.
# Usage, as root: start.sh DIR [CPUS]
# DIR receives configuration, state and logs; CPUS (default: all) is what the node offers.
set -euo pipefail

[ $# = 1 ] || [ $# = 2 ] || { echo "usage: $0 DIR [CPUS]" >&2; exit 2; }
[ "$(id -u)" = 0 ] || { echo "$0: must run as root" >&2; exit 2; }
mkdir -p "$1"
dir=$(cd "$1" && pwd -P)
cpus=${2:-$(nproc)}
mem=$(awk '/^MemTotal/ { print int($2 / 1024) }' /proc/meminfo)
host=$(uname -n); host=${host%%.*}   # slurmd looks up its short host name
conf=$dir/slurm.conf
export SLURM_CONF=$conf

# A step's socket is DIR/spool/HOST_JOBID.STEPID, and a socket's path ends at 107 characters.
# Beyond that every launch fails ("slurmstepd failed to send return code") and is held.
if [ $((${#dir} + ${#host} + 29)) -gt 107 ]; then
    echo "$0: the path of $dir is too long for Slurm's sockets" >&2
    exit 2
fi
if [ -e "$conf" ] && timeout 10 scontrol ping >/dev/null 2>&1; then
    echo "$0: already running in $dir" >&2
    exit 1
fi

for tool in munged slurmctld slurmd sbatch; do
    command -v "$tool" >/dev/null && continue
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -q
    apt-get install -y -q --no-install-recommends munge slurmctld slurmd slurm-client
    break
done

# munged refuses a key or a socket below a folder that others may write to.
mkdir -p "$dir"/{munge,state,spool,log}
chmod 755 "$dir" "$dir"/{munge,state,spool,log}
if [ ! -s "$dir/munge/key" ]; then
    (umask 077; head -c 128 /dev/urandom >"$dir/munge/key")
fi

# cred_expire is also how long a requeued task waits before it starts again (default 120 s).
# Tasks of "main" are requeued when a job of "urgent" needs their CPUs.
cat >"$conf" <<CONF
ClusterName=local
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$dir/munge/socket,cred_expire=5
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool
SlurmctldPidFile=$dir/slurmctld.pid
SlurmdPidFile=$dir/slurmd.pid
SlurmctldLogFile=$dir/log/slurmctld.log
SlurmdLogFile=$dir/log/slurmd.log
MailProg=/bin/true
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
SchedulerParameters=batch_sched_delay=0,sched_interval=2,bf_interval=5
MinJobAge=3600
KillWait=5
ReturnToService=2
SlurmdParameters=config_overrides
NodeName=$host NodeAddr=127.0.0.1 CPUs=$cpus RealMemory=$mem State=UNKNOWN
PartitionName=main Nodes=$host Default=YES MaxTime=INFINITE PriorityTier=1
PartitionName=urgent Nodes=$host MaxTime=INFINITE PriorityTier=10
CONF

# A job's step never notices the end of its task if it inherits an ignored SIGCHLD.
run() { env --default-signal=CHLD "$@"; }
run munged --key-file="$dir/munge/key" --socket="$dir/munge/socket" --seed-file="$dir/munge/seed" \
    --pid-file="$dir/munged.pid" --log-file="$dir/log/munged.log"
run slurmctld -f "$conf"
run slurmd -f "$conf"

for _ in $(seq 60); do
    if [ "$(sinfo -h -p main -o %t 2>/dev/null)" = idle ]; then
        echo "Slurm is up. Point clients at it with:"
        echo "export SLURM_CONF=$conf"
        exit 0
    fi
    sleep 1
done
echo "$0: the node did not become idle; see $dir/log" >&2
exit 1
