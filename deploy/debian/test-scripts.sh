#!/usr/bin/env bash
# Runs the package's scripts with dpkg in a temporary copy of this host's files, with a systemctl that records its calls:
# installation, upgrades, refused and real removals, purge. Takes a few seconds; the program itself is a stub.
# usage, as root on Debian: deploy/debian/test-scripts.sh     exit status 77: this cannot run here
set -euo pipefail
cd "$(dirname "$0")/../.."

say() { echo "test-scripts: $*" >&2; }

skip() { say "skipped: $*"; exit 77; }

# --- inside: process 1 in separate namespaces, in the copy -----------------------------------------------------------

write_stub() { # usage: write_stub PATH LINES
    mkdir -p "$(dirname "$1")"
    printf '#!/bin/sh\n%s\n' "$2" > "$1"
    chmod 755 "$1"
}

# The daemon counts as active while the file /active exists.
write_host_stubs() {
    mkdir -p /run/systemd/system
    # shellcheck disable=SC2016 # expanded by the stub
    write_stub /usr/local/sbin/systemctl 'case "$*" in
*is-active*) test -e /active; exit ;;
*farm-agent*) echo "an agent is touched: $*" >> /calls ;;
"start farm-daemon.service") touch /active ;;
"stop farm-daemon.service" | *--now*) rm -f /active ;;
esac
echo "systemctl $*" >> /calls'
    # shellcheck disable=SC2016
    write_stub /usr/local/sbin/udevadm 'echo "udevadm $*" >> /calls'
}

make_package() { # usage: make_package VERSION
    local root=/tmp/package venv=/tmp/package/opt/farm/.venv
    rm -rf $root
    # shellcheck disable=SC2016
    write_stub $venv/bin/farm 'echo "farm $*" >> /calls; exit "$(cat /down-code)"'
    # shellcheck disable=SC2016
    write_stub $venv/bin/python 'test "$1" = -m || echo current'
    mkdir -p $venv/lib/python3.11/site-packages/decompose/__pycache__/stale
    install -Dm644 -t $root/etc/farm deploy/debian/fleet.yaml
    install -Dm755 -t $root/DEBIAN deploy/debian/{preinst,postinst,prerm,postrm}
    echo /etc/farm/fleet.yaml > $root/DEBIAN/conffiles
    printf '%s\n' "Package: farm" "Version: $1" "Architecture: all" "Maintainer: nobody <nobody@localhost>" \
        "Description: scripts of the package" > $root/DEBIAN/control
    dpkg-deb --root-owner-group -Znone --build $root "/tmp/$1.deb" > /dev/null
}

check() {
    local what=$1
    shift
    "$@" || { say "FAILED: $what"; exit 1; }
    say "ok: $what"
}

refused() { ! "$@"; }

# usage: check_calls WHAT COMMAND ...     compares the calls of a command with standard input
check_calls() {
    local what=$1
    shift
    : > /calls
    "$@" > /tmp/out 2>&1 || true
    diff - /calls >&2 || { cat /tmp/out >&2; say "FAILED: $what"; exit 1; }
    say "ok: $what"
}

is_installed() { [[ $(dpkg-query -W -f '${db:Status-Status}' farm) == installed ]]; }

check_upgrades() {
    check_calls "an installation starts nothing" dpkg -i /tmp/1.deb <<'END'
systemctl daemon-reload
systemctl try-restart farm-estop.service
udevadm control --reload
END
    check "it is installed" is_installed
    check "the settings may hold passwords" test "$(stat -c '%a %U %G' /etc/farm/fleet.yaml)" = "640 root farm"
    check "the data are the farm's" test "$(stat -c '%a %U %G' /var/lib/farm)" = "700 farm farm"
    check "machine code of other versions is gone" test -z "$(find /opt/farm -name stale)"
    echo "# mine" >> /etc/farm/fleet.yaml
    chmod 600 /etc/farm/fleet.yaml
    check_calls "an upgrade leaves a stopped daemon stopped" dpkg -i /tmp/2.deb <<'END'
systemctl daemon-reload
systemctl try-restart farm-estop.service
udevadm control --reload
END
    touch /active
    check_calls "an upgrade stops the daemon alone, and starts it again" dpkg -i /tmp/3.deb <<'END'
systemctl stop farm-daemon.service
systemctl daemon-reload
systemctl start farm-daemon.service
systemctl try-restart farm-estop.service
udevadm control --reload
END
    check "changed settings are kept" grep -q "# mine" /etc/farm/fleet.yaml
    check "their mode, too" test "$(stat -c %a /etc/farm/fleet.yaml)" = 600
    mkdir /opt/farm/.git
    check_calls "a refused upgrade starts the daemon again" dpkg -i /tmp/4.deb <<'END'
systemctl stop farm-daemon.service
systemctl daemon-reload
systemctl start farm-daemon.service
END
    rmdir /opt/farm/.git
    check "the earlier version is still installed" test "$(dpkg-query -W -f '${Version}' farm)" = 3
}

check_removal() {
    local agent
    echo 5 > /down-code
    check_calls "a removal while something prints stops nothing" dpkg -r farm <<'END'
farm down
systemctl daemon-reload
END
    check "it is refused" is_installed
    echo 0 > /down-code
    bash -c 'exec -a /opt/farm/.venv/bin/python sh -c cat -m drivers.agent --folder /elsewhere' < <(sleep 600) &
    agent=$!
    check_calls "a removal beside an agent of another host stops nothing" dpkg -r farm <<'END'
farm down
systemctl daemon-reload
END
    check "it is refused, too" is_installed
    kill "$agent"
    wait "$agent" || true
    check_calls "a removal disables the units" dpkg -r farm <<'END'
farm down
systemctl --quiet disable --now farm-estop.socket farm-estop.service farm-daemon.service
systemctl daemon-reload
udevadm control --reload
END
    check "the program is gone" test ! -e /opt/farm
    check "settings and data are kept" test -s /etc/farm/fleet.yaml -a -d /var/lib/farm
    check_calls "a purge reloads" dpkg -P farm <<'END'
systemctl daemon-reload
udevadm control --reload
END
    check "settings and data are gone" test ! -e /etc/farm -a ! -e /var/lib/farm
    check "user and group are gone" refused getent passwd farm
    check "dpkg no longer knows the package" refused dpkg-query -W farm
}

if [[ ${1:-} == --inside ]]; then
    mount -t tmpfs none "$2"
    mkdir "$2"/{changes,work,root}
    mount -t overlay none -o "lowerdir=/,upperdir=$2/changes,workdir=$2/work" "$2/root" || skip "no overlay can be mounted"
    mount -t proc none "$2/root/proc"
    mount --rbind /dev "$2/root/dev"
    mount -t tmpfs -o mode=1777 none "$2/root/tmp"
    mount -t tmpfs none "$2/root/run"
    touch "$2/root/copy-of-the-host"
    mkdir -p "$2/root/tmp/checkout/deploy"
    cp -r deploy/debian "$2/root/tmp/checkout/deploy/"
    exec chroot "$2/root" /usr/bin/env -i PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
        DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 /tmp/checkout/deploy/debian/test-scripts.sh --in-copy
fi
if [[ ${1:-} == --in-copy ]]; then
    # The following commands remove an installed farm, which must never be the host's.
    [[ -e /copy-of-the-host ]] || { say "--in-copy runs in the copy only"; exit 2; }
    rm -rf /opt/farm /etc/farm /var/lib/farm
    if getent passwd farm > /dev/null; then userdel farm; fi
    echo 0 > /down-code
    write_host_stubs
    for version in 1 2 3 4; do make_package $version; done
    check_upgrades
    check_removal
    exit
fi

# --- outside ----------------------------------------------------------------------------------------------------------

[[ $(id -u) == 0 ]] || skip "this needs root, for mounts and for dpkg"
for program in adduser dpkg dpkg-deb unshare; do
    command -v "$program" > /dev/null || skip "there is no $program"
done
! dpkg-query -W farm > /dev/null 2>&1 || skip "the package is installed on this host"
unshare --mount --pid --fork true 2> /dev/null || skip "no namespaces can be made"
scratch=$(mktemp -d)
trap 'rmdir "$scratch"' EXIT
unshare --mount --pid --fork --kill-child --propagation private "$PWD/deploy/debian/test-scripts.sh" --inside "$scratch"
say "The scripts do what they should."
