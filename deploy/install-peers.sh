#!/usr/bin/env bash
# What some tests talk to: OctoPrint's virtual printer and Printrun in a virtual environment of their own, and, where
# this is root in a container, Debian's openssh-server, ser2net and a C compiler. Nobody's own computer is made to run a
# server for a test. What cannot be had is said, and the tests that need it are skipped.
# usage: install-peers.sh ENVIRONMENT
set -euo pipefail
cd "$(dirname "$0")/.."

ENVIRONMENT=$1
REQUIREMENTS=tests/interop/requirements.txt
PACKAGES=(openssh-server ser2net gcc libc6-dev)

say() { echo "install: $*" >&2; }

present() { dpkg-query -W -f '${db:Status-Status}\n' "$1" 2>/dev/null | grep -qx installed; }

install_packages() {
    # runlevel 1: no server is started
    env RUNLEVEL=1 DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null 2>&1
}

missing=()
if command -v apt-get >/dev/null; then
    for package in "${PACKAGES[@]}"; do present "$package" || missing+=("$package"); done
fi
if ((${#missing[@]})); then
    if [[ $(id -u) == 0 && ! -d ${SYSTEMD_RUNS:-/run/systemd/system} ]]; then
        say "Installing ${missing[*]} for the tests ..."
        install_packages || { apt-get update -qq >/dev/null 2>&1 && install_packages; } ||
            say "apt has not installed ${missing[*]}: the tests that need them are skipped."
    else
        say "Not there: ${missing[*]}. The tests that need them are skipped; apt-get install gets them."
    fi
fi

[[ -f $ENVIRONMENT/.installed && ! $REQUIREMENTS -nt $ENVIRONMENT/.installed ]] && exit 0
say "Installing OctoPrint and Printrun into $ENVIRONMENT, for the tests ..."
pip=("$ENVIRONMENT/bin/python" -m pip --disable-pip-version-check install --quiet)
if "${PYTHON:-python3.11}" -m venv "$ENVIRONMENT" && "${pip[@]}" -r "$REQUIREMENTS" &&
    "${pip[@]}" --no-deps Printrun==2.2.0; then  # its windows are not needed
    touch "$ENVIRONMENT/.installed"
else
    rm -rf "$ENVIRONMENT"
    say "They are not to be had here: the tests that need them are skipped."
fi
