#!/usr/bin/env bash
# Prints the Python to build the environment with: the newest of 3.11 to 3.13 that runs here, one
# with a working `venv` before one without. Prints nothing and fails when there is none.
# PYTHON=/path/to/python3 chooses another.
#
# 3.13 is the newest because xatlas ships no wheels beyond it.
set -uo pipefail

supported='import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))'

for needed in 'import ensurepip, venv' 'pass'; do
  for name in ${PYTHON:-python3.13 python3.12 python3.11 python3}; do
    # A version manager's stand-in may exist and still not run, so each one is tried.
    if "$name" -c "$supported" 2>/dev/null && "$name" -c "$needed" 2>/dev/null; then
      command -v "$name"
      exit 0
    fi
  done
done
exit 1
