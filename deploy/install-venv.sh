#!/usr/bin/env bash
# Creates a virtual environment with Python 3.11; in Debian the venv module is a separate package.
set -euo pipefail
venv=$1
python=${PYTHON:-python3.11}

say() { echo "install: $*" >&2; }

command -v "$python" >/dev/null || {
    say "There is no $python. On Debian 12: apt-get install python3; elsewhere: make install PYTHON=/path/to/python3.11"
    exit 1
}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    say "$python is older than 3.11; name a newer one: make install PYTHON=/path/to/python3.11"
    exit 1
}

# Debian's venv module lacks ensurepip.
if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
    command -v apt-get >/dev/null || { say "$python has no venv module: install it, then run this again."; exit 1; }
    sudo=()
    if [[ $(id -u) != 0 ]]; then
        command -v sudo >/dev/null || { say "As root: apt-get install python3-venv"; exit 1; }
        say "This needs root: apt-get install python3-venv (sudo may ask for your password)."
        sudo=(sudo)
    fi
    say "Installing python3-venv ..."
    install=("${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3-venv)
    "${install[@]}" >/dev/null 2>&1 || { "${sudo[@]}" apt-get update -qq && "${install[@]}" >/dev/null; }
fi

# An environment that another Python created, or that was moved here, is created again.
if [[ $("$venv/bin/python" -c 'import pip, sys; print(sys.version)' 2>/dev/null) != \
    "$("$python" -c 'import sys; print(sys.version)')" ]]; then
    rm -rf "$venv"
    "$python" -m venv "$venv"
fi
