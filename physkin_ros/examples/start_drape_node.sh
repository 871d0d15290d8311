#!/usr/bin/env bash
# Start the drape node without launch: start_drape_node.sh [CONFIG.yaml] [more arguments of physkin node]
# PHYSKIN_ENV: virtual environment with physkin and the ROS 2 wheels. PHYSKIN_WORKSPACE: folder that `colcon build` ran in;
# then PHYSKIN_ENV, if at all, is the environment that was active there. Neither: a sourced ROS 2, or the PATH.
set -euo pipefail

if [[ -n "${PHYSKIN_WORKSPACE:-}" ]]; then
  set +u
  source "$PHYSKIN_WORKSPACE/install/setup.bash" # sources the ROS 2 it was built with, too
  set -u
elif [[ -z "${PHYSKIN_ENV:-}${AMENT_PREFIX_PATH:-}" && -f /opt/ros/jazzy/setup.bash ]]; then
  set +u
  source /opt/ros/jazzy/setup.bash
  set -u
fi
if [[ -n "${PHYSKIN_ENV:-}" ]]; then export PATH="$PHYSKIN_ENV/bin:$PATH"; fi

# A core of its own and one numerical thread: the evaluator is single-threaded, and more only get in each other's way.
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"
PIN=()
if [[ -n "${PHYSKIN_CORE:-}" ]]; then PIN=(taskset --cpu-list "$PHYSKIN_CORE"); fi

ARGUMENTS=()
if [[ $# -gt 0 && "$1" != -* ]]; then
  ARGUMENTS=(--config "$1")
  shift
fi
exec "${PIN[@]}" python3 -m physkin_ros "${ARGUMENTS[@]}" "$@"
