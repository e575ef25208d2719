# The environment in which the workspace's programs run; sourced by ./tissue and the Makefile (bash).
# It stands alone: a ROS installation sourced before is left out, because its Python packages
# belong to another interpreter.

tissue_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
tissue_venv=$tissue_root/.venv

# Each of colcon's install folders under $tissue_root/install, joined by colons with a suffix.
tissue_join() {
  local joined="" folder
  for folder in "$tissue_root"/install/*/$1; do
    [ -d "$folder" ] && joined=$joined${joined:+:}${folder%/}
  done
  printf '%s' "$joined"
}

export VIRTUAL_ENV=$tissue_venv
case ":$PATH:" in
  *":$tissue_venv/bin:"*) ;;
  *) export PATH=$tissue_venv/bin:$PATH ;;
esac
unset PYTHONHOME
export PYTHONNOUSERSITE=1
PYTHONPATH=$(tissue_join "lib/python3*/site-packages")
export PYTHONPATH
AMENT_PREFIX_PATH=$(tissue_join ""):$tissue_venv
export AMENT_PREFIX_PATH
# The ROS wheels would set the library path themselves, by starting every Python process a second
# time; the second variable tells them that it is done.
LD_LIBRARY_PATH=$tissue_root/install/tissue_interfaces/lib:$tissue_venv/lib
for tissue_folder in "$tissue_venv"/lib/python3*/site-packages/ros_*.libs; do
  LD_LIBRARY_PATH=$LD_LIBRARY_PATH:$tissue_folder
done
export LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE=1

# Nothing leaves this machine unless the user chose a discovery variable (tissue_sim/discovery.py).
if [ -z "${ROS_AUTOMATIC_DISCOVERY_RANGE:-}${ROS_STATIC_PEERS:-}${ROS_LOCALHOST_ONLY:-}${ROS_DISCOVERY_SERVER:-}${FASTRTPS_DEFAULT_PROFILES_FILE:-}${FASTDDS_DEFAULT_PROFILES_FILE:-}${CYCLONEDDS_URI:-}" ]; then
  export ROS_AUTOMATIC_DISCOVERY_RANGE=SYSTEM_DEFAULT
  export FASTRTPS_DEFAULT_PROFILES_FILE=$tissue_root/src/tissue_sim/tissue_sim/data/this_machine.xml
fi

# A cached kernel knows its own source file but not those of the functions it calls, so every set
# of sources has a cache of its own (scripts/build.py writes the name and removes old ones).
if [ -z "${NUMBA_CACHE_DIR:-}" ]; then
  tissue_cache=${XDG_CACHE_HOME:-${HOME:-/tmp}/.cache}/tissue_sim/numba
  NUMBA_CACHE_DIR=$tissue_cache/$(cat "$tissue_root/install/.numba_sources" 2>/dev/null || echo none)
  export NUMBA_CACHE_DIR
fi
