#!/bin/bash
# Chooses package versions anew and writes one hashed lock per Python minor version.
# Other arguments go to uv: `scripts/lock.sh --upgrade-package numpy` renews one package alone.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
uv=.venv/bin/uv
[ -x $uv ] || uv=uv

compile() {
  "$uv" pip compile --quiet --generate-hashes --no-header --python-platform x86_64-manylinux_2_28 "$@"
}

for version in 3.11 3.12 3.13; do
  compile --python-version $version requirements.in requirements-dev.in \
    --output-file requirements/py${version/./}.lock "$@"
  # An optional extra, to the versions of everything else.
  compile --python-version $version requirements-bench.in \
    --constraint requirements/py${version/./}.lock \
    --output-file requirements/bench-py${version/./}.lock "$@"
done
# The set-up's first step, with pip: the same versions for every Python.
printf 'uv\nsetuptools\n' | compile --python-version 3.11 --constraint requirements/py311.lock \
  --no-annotate --output-file requirements/bootstrap.lock -
