#!/usr/bin/env bash
# Sees to what pip cannot install: a Python with venv, EGL and GL, and a GL driver (Mesa's software
# driver where there is no other). Looks first and asks for nothing that is there already. As root
# it installs with apt-get; otherwise it prints the one line to run, and stops.
set -euo pipefail
cd "$(dirname "$0")/.."

python_packages() {
  # A Python that Debian or Ubuntu has and that we support: their default one when it is new enough.
  local name
  for name in python3 python3.13 python3.12 python3.11; do
    if apt-cache show "$name" 2>/dev/null |
      grep -qE '^Version: 3\.1[123]\.'; then
      echo "$name $name-venv"
      return
    fi
  done
  echo "python3 python3-venv"
}

missing() {
  local python
  if ! python=$(tools/find_python.sh); then
    python_packages
    python=$(command -v python3 || true)
  elif ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
    # Debian names the package after the interpreter that carries it.
    if [[ $python == /usr/bin/* ]]; then
      "$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'
    else
      echo "python3-venv"
    fi
  fi
  if [[ -n $python ]]; then
    # A driver that crashes here is left for `scanrender doctor` to describe.
    "$python" tools/missing_libraries.py 2>/dev/null || true
  else
    echo "libegl1 libgl1 libopengl0 libegl-mesa0 libgl1-mesa-dri"
  fi
}

if [[ $(uname -s) != Linux ]]; then
  echo "scanrender is developed and tested on Linux only; going on without a look at libraries" >&2
  exit 0
fi

packages=$(missing | xargs)
[[ -z $packages ]] && exit 0

if ! command -v apt-get >/dev/null; then
  echo "scanrender needs system libraries that are missing here." >&2
  echo "On Debian and Ubuntu they are called: $packages" >&2
  echo "Install what your system calls them, then run make again." >&2
  exit 1
fi
if [[ $(id -u) -ne 0 ]]; then
  echo "scanrender needs system packages that are missing here. Run this, then make again:" >&2
  echo "  sudo apt-get update && sudo apt-get install --no-install-recommends $packages" >&2
  exit 1
fi

echo "installing system packages: $packages" >&2
export DEBIAN_FRONTEND=noninteractive
apt-get update -qq
# The package lists may only now be there: ask again which Python this system has.
packages=$(missing | xargs)
# shellcheck disable=SC2086  # a list of words
apt-get install -y -qq --no-install-recommends $packages >/dev/null
packages=$(missing | xargs)
if [[ -n $packages ]]; then
  echo "still missing after the installation: $packages" >&2
  exit 1
fi
