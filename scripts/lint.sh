#!/bin/bash
# Lint, format and types; all three run even if one finds something.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. scripts/env.sh
status=0
ruff check . || status=1
ruff format --check . || status=1
mypy || status=1
exit $status
