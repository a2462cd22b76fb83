#!/usr/bin/env bash
# Installs the package in a new Debian 12, upgrades it while simulated printers print, then removes and purges it.
# usage, as root: deploy/debian/test.sh [DEB]     default: the newest package in build/dist; takes five to ten minutes
#
# systemd does not run in the new root: `farm up` starts the daemon, and this script stops and starts it in place of the
# package's scripts. `systemd-analyze verify` checks the units.
set -euo pipefail
cd "$(dirname "$0")/../.."

readonly SCRIPT_NAME=test-deb
. deploy/debian-root.sh

readonly SCALE=5 # of the printers' clock; the print of the box takes four minutes
# On a busy host a print may end before the upgrade does: a print that ended as `done` was not disturbed either.
readonly UNDISTURBED='all(p["print"] or (p["last"] and p["last"]["state"] == "done") for p in printers)'

# --- inside: process 1 in separate namespaces, so that all processes and mounts end with it --------------------------

run_as_farm() {
    setpriv --reuid=farm --regid=farm --init-groups env -i PATH=/usr/bin:/bin HOME=/var/lib/farm LANG=C.UTF-8 \
        FARM_STATE=/var/lib/farm FARM_SOCKET=/run/farm/farm.sock FARM_FLEET=/etc/farm/fleet.yaml "$@"
}

refused() { ! "$@"; }

# usage: ask EXPRESSION     of `printers` and `daemon` in farm status --json
ask() {
    run_as_farm farm status --json | python3 -c 'import json, sys
status = json.load(sys.stdin)
printers, daemon = status["printers"], status["daemon"]
print(eval(sys.argv[1]))' "$1"
}

# usage: wait_for SECONDS EXPRESSION
wait_for() {
    local deadline=$((SECONDS + $1))
    until [[ $(ask "$2") == True ]]; do
        ((SECONDS < deadline)) || { run_as_farm farm status; return 1; }
        sleep 1
    done
}

list_files() {
    find / -xdev \( -path /proc -o -path /sys -o -path /dev -o -path /tmp -o -path /var/cache -o -path /var/log \
        -o -path /var/lib/apt -o -path /var/lib/dpkg -o -path /var/lib/systemd -o -path /run/systemd \) -prune -o -print |
        grep -v -e __pycache__ -e '^/etc/[a-z]*-$' | sort
    cut -d: -f1 /etc/passwd /etc/group
}

list_farm_processes() { find /proc -maxdepth 2 -name cmdline -exec grep -l '[/]opt/farm/' {} + 2>/dev/null; }

install_package() { apt-get install -qq -y --no-install-recommends "$1"; }

check_installation() {
    check "farm runs as any user" setpriv --reuid=65534 --clear-groups farm --version
    check "there is a user farm in group dialout" grep -q '^dialout:.*farm' /etc/group
    check "nothing runs" refused list_farm_processes
    check "no unit is enabled" test -z "$(find /etc/systemd/system -name 'farm*')"
    check "systemd accepts the units" systemd-analyze verify --man=no farm-daemon.service farm-estop.socket \
        farm-estop.service farm-agent@um2-01.service
    run_as_farm farm doctor > /tmp/doctor || true
    check "only printers are missing" grep -q "^problem  fleet: /etc/farm/fleet.yaml has no printers" /tmp/doctor
    check "CuraEngine and its settings are found" refused grep "^problem  cura" /tmp/doctor
    check "the planning is compiled" grep "^ok       code: .*/opt/farm" /tmp/doctor
    check "each command has a man page" test -s /usr/share/man/man1/farm-submit.1.gz
    check "bash completion is installed" bash -c '. /usr/share/bash-completion/completions/farm && complete -p farm'
}

start_prints() {
    cat > /etc/farm/fleet.yaml <<END
fleet: {name: test, timezone: UTC, time_scale: $SCALE}
defaults: {model: ultimaker2_plus, material: generic_pla, nozzle_mm: 0.4}
printers:
  - {name: um2-01, port: "sim://ultimaker2_plus?seed=1"}
  - {name: um2-02, port: "sim://ultimaker2_plus?seed=2"}
END
    mkdir -p /run/farm && chown farm:farm /run/farm
    /opt/farm/.venv/bin/python -c 'import trimesh; trimesh.creation.box((30, 30, 6)).export("/tmp/box.stl")'
    chmod 644 /tmp/box.stl
    run_as_farm farm up
    run_as_farm farm submit /tmp/box.stl --copies 2
    check "both printers print" wait_for 240 'all(p["state"] == "printing" for p in printers)'
}

run_test() {
    local before pids agent dependencies
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq
    say "Installing the dependencies of the package ..."
    dependencies=$(dpkg-deb -f /tmp/1.deb Depends | tr ',' '\n' | sed 's/(.*//')
    # shellcheck disable=SC2086 # one word for each package
    apt-get install -qq -y --no-install-recommends $dependencies > /dev/null
    before=$(list_files)
    say "Installing the package ..."
    check "apt installs it" install_package /tmp/1.deb
    check_installation
    start_prints
    pids=$(ask '[p["agent_pid"] for p in printers]')

    check "a removal is refused while agents print" refused apt-get remove -qq -y farm
    check "the program is still there" farm --version
    check "apt upgrades it" install_package /tmp/2.deb
    check "the settings are kept" grep -q um2-02 /etc/farm/fleet.yaml
    check "both printers continue to print" test "$(ask "$UNDISTURBED")" = True
    kill -TERM "$(ask 'daemon["pid"]')" # as prerm and postinst do under systemd
    while run_as_farm farm status > /dev/null 2>&1; do sleep 0.2; done
    run_as_farm farm up
    check "a daemon of the new version finds them" wait_for 60 "$UNDISTURBED"
    check "the agents are the same" test "$(ask '[p["agent_pid"] for p in printers]')" = "$pids"
    check "the prints end without a fault" wait_for 600 'all(p["last"] and p["last"]["state"] == "done" for p in printers)'

    # A process with the command line of an agent whose daemon is on another host.
    bash -c 'exec -a /opt/farm/.venv/bin/python sh -c cat -m drivers.agent --folder /elsewhere' < <(sleep 600) &
    agent=$!
    check "a removal is refused while an agent of another host's daemon runs" refused apt-get remove -qq -y farm
    check "the program is still installed after it" farm --version
    kill "$agent"
    check "a farm without a print is removed" apt-get remove -qq -y farm
    check "no process is left" refused list_farm_processes
    check "its data are kept" test -s /var/lib/farm/farm.db
    check "it is purged" apt-get purge -qq -y farm
    check "nothing is left" diff <(echo "$before") <(list_files)
}

if [[ ${1:-} == --inside ]]; then
    enter "$2"
    run_test
    exit
fi

# --- outside ----------------------------------------------------------------------------------------------------------

[[ $(id -u) == 0 ]] || fail "This needs root, for the new root and its mounts: sudo make test-deb"
deb=$(find_package "${1:-}")
need_mmdebstrap
make_scratch deb
root=$scratch/root
build_root "$root" ca-certificates
copy_settings "$root" "$root/root"
cp "$deb" "$root/tmp/1.deb"
say "Making a package with a later version ..."
dpkg-deb -R "$deb" "$scratch/later"
sed -i 's/^Version: .*/&.later/' "$scratch/later/DEBIAN/control"
dpkg-deb --root-owner-group -Znone -b "$scratch/later" "$root/tmp/2.deb" > /dev/null
rm -rf "$scratch/later"
unshare --mount --pid --fork --kill-child --propagation private "$PWD/deploy/debian/test.sh" --inside "$root"
say "The package installs, upgrades while printers print, and is removed completely."
