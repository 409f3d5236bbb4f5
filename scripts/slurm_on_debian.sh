#!/bin/sh
# SLURM on one machine with Debian 12, without systemd, to try docs/cluster.md. As root: sh scripts/slurm_on_debian.sh
# `sinfo` then shows one idle node. Its services listen on all network interfaces, ports 6817 and 6818.
set -e
apt-get update
apt-get install -y --no-install-recommends slurm-wlm munge
cat > /etc/slurm/slurm.conf <<CONF
ClusterName=trial
SlurmctldHost=$(hostname -s)
SlurmUser=slurm
StateSaveLocation=/var/lib/slurm/slurmctld
SlurmdSpoolDir=/var/lib/slurm/slurmd
ProctrackType=proctrack/linuxproc
TaskPlugin=task/affinity
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
ReturnToService=2
$(slurmd -C | head -1)
PartitionName=cpu Nodes=ALL Default=YES
CONF
service munge start
service slurmctld start
service slurmd start
