#!/bin/bash
# Lint, format, types and tests against install/; pytest comes last and runs in any case.
# The status is pytest's, or 1 where the tests passed and something before them did not.
# Arguments go to pytest. Without any, tests within one process run on two cores; after them those of
# several processes, two files at a time, since they mostly wait for each other.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. scripts/env.sh
# ROS checks the types of message fields only when asked to.
export ROS_PYTHON_CHECK_FIELDS=1

lint=0
bash scripts/lint.sh || lint=1
if [ $# -gt 0 ]; then
  python -P -m pytest "$@"
  status=$?
else
  python -P -m pytest -n 2 --dist loadfile test/unit test/physics
  status=$?
  python -P -m pytest -n 2 --dist loadfile test/system || status=$?
fi
if [ $lint -ne 0 ]; then
  echo "Lint, format or types failed: see above the tests." >&2
fi
[ $status -ne 0 ] && exit $status
exit $lint
