#!/bin/bash
# Sets up everything the workspace needs: checks the machine, makes .venv with the locked packages,
# builds the workspace into install/ and writes ./tissue. Does only what is missing, may be
# interrupted and repeated, and lets one set-up run at a time.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD
unset PYTHONPATH PYTHONHOME VIRTUAL_ENV PYTHONDONTWRITEBYTECODE LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
# In a shell with the workspace's environment python3 is .venv's own, which is removed to be made anew.
paths=:$PATH:
paths=${paths//":$root/.venv/bin:"/:}
paths=${paths#:} PATH=${paths%:}

say() { printf '[setup] %s\n' "$*"; }
fail() { printf '[setup] %s\n' "$@" >&2; exit 1; }

# Runs a stage with its output in build/log and one line on the terminal.
stage() {
  local title=$1 log=build/log/$2.txt started=$EPOCHREALTIME status=0
  shift 2
  mkdir -p build/log
  printf '[setup] %-42s' "$title"
  "$@" >"$log" 2>&1 || status=$?
  if [ $status -ne 0 ]; then
    printf 'failed\n'
    tail -n 30 "$log" >&2
    fail "failed: $title (everything it printed: $log)"
  fi
  awk -v a="$started" -v b="$EPOCHREALTIME" 'BEGIN { printf "%6.1f s\n", b - a }'
}

check_platform() {
  local libc
  libc=$(getconf GNU_LIBC_VERSION 2>/dev/null | awk '{print $2}') || true
  if [ "$(uname -sm)" != "Linux x86_64" ] || [ -z "$libc" ] \
      || [ "$(printf '%s\n2.28\n' "$libc" | sort -V | head -n 1)" != 2.28 ]; then
    fail "The ROS 2 wheels need Linux on x86_64 with glibc 2.28 or newer; this is" \
      "$(uname -sm), glibc ${libc:-not found}. Elsewhere, install ROS 2 Jazzy with apt and run" \
      "'colcon build' (README.md, section 'With ROS 2 from apt')."
  fi
}

# Prints "version;what it lacks" for an interpreter; nothing where it does not run.
probe_python() {
  "$1" -I -c '
import importlib.util, pathlib, sys, sysconfig
lacks = []
if not (pathlib.Path(sysconfig.get_path("include")) / "Python.h").is_file(): lacks.append("dev")
if not all(map(importlib.util.find_spec, ("venv", "ensurepip"))): lacks.append("venv")
print("%d.%d;%s" % (*sys.version_info[:2], " ".join(lacks)))' 2>/dev/null || true
}

# Sets python and version to the first complete interpreter, or says what to install.
choose_python() {
  local candidate answer lacks packages="" first=""
  for candidate in ${PYTHON:-python3 python3.12 python3.11 python3.13 \
      /usr/bin/python3 /usr/bin/python3.12 /usr/bin/python3.11 /usr/bin/python3.13}; do
    answer=$(probe_python "$candidate")
    version=${answer%%;*} lacks=${answer#*;}
    case $version in 3.11 | 3.12 | 3.13) ;; *) continue ;; esac
    if [ -z "$lacks" ]; then
      python=$(command -v "$candidate")
      break
    fi
    first=${first:-$version $lacks}
  done
  if [ -z "${python:-}" ]; then
    if [ -n "$first" ]; then
      say "Python ${first%% *} is here, but lacks: ${first#* } (dev: Python.h; venv: ensurepip)."
      for lacks in ${first#* }; do packages="$packages python${first%% *}-$lacks"; done
    else
      say "No Python 3.11, 3.12 or 3.13 found${PYTHON:+ at PYTHON=$PYTHON}."
      packages=" python3 python3-dev python3-venv"
      say "(Where the system's python3 is older or newer: python3.12 python3.12-dev python3.12-venv,"
      say "or name another one: make setup PYTHON=/path/to/python3.12)"
    fi
  fi
  missing+=$packages
}

check_compiler() {
  local tool
  for tool in "${CC:-cc}" "${CXX:-c++}" make; do
    if ! command -v "$tool" >/dev/null; then
      say "Not found: $tool"
      case $missing in *build-essential*) ;; *) missing+=" build-essential" ;; esac
    fi
  done
}

check_machine() {
  missing=""
  check_platform
  check_compiler
  choose_python
  if [ -n "$missing" ]; then
    fail "Please install what is missing, then run this again:" "  sudo apt-get install$missing"
  fi
}

make_venv() {
  rm -rf .venv && "$python" -m venv .venv && .venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes \
    --only-binary :all: --requirement requirements/bootstrap.lock
}

# uv takes a tenth of pip's time and checks the same hashes; where it cannot reach the index (pip
# may be configured for a proxy that uv knows nothing of), pip does the same work.
# Not `uv pip sync`: the ROS wheels carry egg-info of their contents, which it takes for packages
# that nobody asked for and removes.
# empy comes as source only; it is built with the locked setuptools, not with one fetched anew.
install_packages() {
  local lock=requirements/py${version/./}.lock
  local options=(--require-hashes --no-build-isolation --only-binary :all: --no-binary empy)
  local bundle certificates=()
  for bundle in /etc/ssl/certs/ca-certificates.crt /etc/pki/tls/certs/ca-bundle.crt; do
    [ -e $bundle ] && certificates=(--system-certs)
  done
  if [ -z "${UV_CACHE_DIR:-}" ] && ! mkdir -p "${XDG_CACHE_HOME:-${HOME:-/nonexistent}/.cache}/uv" 2>/dev/null; then
    export UV_CACHE_DIR=$root/build/uv-cache
  fi
  if [ -n "${PIP_INDEX_URL:-}" ]; then
    export UV_DEFAULT_INDEX=${UV_DEFAULT_INDEX:-$PIP_INDEX_URL}
  fi
  .venv/bin/uv pip install --quiet --python .venv/bin/python --compile-bytecode \
      "${certificates[@]}" "${options[@]}" --requirement "$lock" \
    || .venv/bin/python -m pip install --disable-pip-version-check "${options[@]}" --requirement "$lock"
}

# What .venv was made from: a change of any of it makes or mends it again.
venv_signature() {
  printf '%s\n' "$root" "$1"
  grep -hv '^ *#' requirements/bootstrap.lock "requirements/py${1/./}.lock" | sha256sum
}

# Both use the workspace's own cache (scripts/env.sh), in two processes at once.
compile_kernels() (
  set +u
  . scripts/env.sh
  python -P -m cut_service.warm_up &
  python -P -m tissue_sim.rehearsal && wait $!
)

exec 9>.setup.lock
if ! flock --nonblock 9; then
  say "waiting for another set-up of this folder to end"
  flock 9
fi

stamp=.venv/.tissue_stamp
version=$(head -n 2 $stamp 2>/dev/null | tail -n 1 || true)
if [ -n "${PYTHON:-}" ] && [ -n "$version" ]; then
  wanted=$(probe_python "$PYTHON")
  [ "${wanted%%;*}" = "$version" ] || version=""
fi
if [ -z "$version" ] || [ "$(cat $stamp)" != "$(venv_signature "$version")" ] || ! .venv/bin/python -c '' 2>/dev/null; then
  rm -f $stamp
  check_machine
  # CMake remembers the headers of the Python before, and install/ may hold another one's modules.
  rm -rf build install
  say "Python $version ($python), $(${CXX:-c++} --version | head -n 1)"
  stage "virtual environment" venv make_venv
  stage "packages (about 2.3 GB with compiled files)" packages install_packages
  venv_signature "$version" >$stamp.new && mv $stamp.new $stamp
fi

.venv/bin/python -I scripts/build.py

# Kernels are compiled once for each set of sources. Nodes would do it at their first start, while
# everybody waits for them. What is compiled belongs to this folder's copy of the sources, wherever
# the cache lies.
compiled=install/.kernels_compiled
cache=$(set +u; . scripts/env.sh; printf %s "$NUMBA_CACHE_DIR")
if [ "$(cat $compiled 2>/dev/null)" != "$cache" ] || [ ! -d "$cache" ]; then
  if mkdir -p "$cache" 2>/dev/null; then
    stage "kernels (once for these sources)" kernels compile_kernels
    printf %s "$cache" >$compiled
  else
    say "no kernels are compiled now: $cache cannot be written; every start will do it"
  fi
fi
