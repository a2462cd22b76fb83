# Functions for scripts that test an installation in a root folder with a new Debian 12. Source this file; SCRIPT_NAME is the
# script's name in messages. The new root uses this host's certificates and proxies, apt's sources, keys and options, and
# pip's settings with the folders that they name.

readonly SUITE=bookworm

say() { echo "$SCRIPT_NAME: $*" >&2; }

fail() { say "$*"; exit 2; }

# usage: check WHAT COMMAND ...
check() {
    local what=$1
    shift
    "$@" || { say "FAILED: $what"; exit 1; }
    say "ok: $what"
}

# Prints the path of the named package, or of the newest. usage: find_package [DEB]
find_package() {
    local deb=${1:-}
    [[ -n $deb ]] || deb=$(find build/dist -name 'farm_*.deb' -printf '%T@ %p\n' | sort -n | tail -n 1 | cut -d' ' -f2)
    [[ -f $deb ]] || fail "There is no package: make deb"
    echo "$deb"
}

# Makes the folder `$scratch` on a disk, which is deleted when the script ends. usage: make_scratch NAME
make_scratch() {
    scratch=$(mktemp -d "/var/tmp/farm-$1.XXXXXX")
    trap 'rm -rf --one-file-system "$scratch"' EXIT
    chmod 755 "$scratch"
}

# usage: mount_devices ROOT NO_SHM
mount_devices() {
    local device
    mount -t tmpfs -o mode=755 none "$1/dev"
    for device in null zero full random urandom tty; do
        touch "$1/dev/$device" && mount --bind "/dev/$device" "$1/dev/$device"
    done
    mkdir "$1/dev/pts"
    mount -t devpts -o newinstance,ptmxmode=0666,mode=620,gid=5 none "$1/dev/pts"
    ln -s pts/ptmx "$1/dev/ptmx"
    ln -s /proc/self/fd "$1/dev/fd"
    [[ -n $2 ]] || { mkdir "$1/dev/shm" && mount -t tmpfs -o mode=1777 none "$1/dev/shm"; }
}

# Lists folders and files of this host that pip's settings name; an index at file:// has its files beside its folder `simple`.
list_pip_paths() {
    { python3 -m pip config list 2>/dev/null || true; env | grep '^PIP_' || true; } |
        grep -oE "(file://|[\"'= ])/[^\"' ]*" | sed -E 's,^[^/]*(//)?,,; s,/simple/?$,,' | sort -u
}

# Enters the root; to be called by process 1 in separate namespaces. usage: enter ROOT [NO_SHM]
enter() {
    local path root=$1 no_shm=${2:-}
    unset TMPDIR # a folder of this host
    ip link set lo up 2>/dev/null || true
    mount --bind "$root" "$root"
    mount -t proc none "$root/proc"
    mount --rbind /sys "$root/sys"
    mount_devices "$root" "$no_shm"
    while read -r path; do
        rmdir "$root$path" 2>/dev/null || true  # mount point of an earlier run
        [[ -e $path && ! -s $root$path ]] || continue
        mkdir -p "$(dirname "$root$path")"
        if [[ -d $path ]]; then mkdir "$root$path"; else touch "$root$path"; fi
        mount --bind -o ro "$path" "$root$path"
    done < <(list_pip_paths)
    mkdir -p "$root/.host"
    cd "$root"
    pivot_root . .host
    umount -l /.host
    cd /
}

need_mmdebstrap() {
    if ! command -v mmdebstrap >/dev/null; then
        command -v apt-get >/dev/null || fail "There is no mmdebstrap and no apt here."
        say "Installing mmdebstrap ..."
        install=(env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends mmdebstrap)
        "${install[@]}" >/dev/null || { apt-get update -qq && "${install[@]}" >/dev/null; } || fail "apt has no mmdebstrap."
    fi
}

# usage: build_root ROOT PACKAGES
build_root() {
    local sources options root=$1 packages=$2
    # Use this host's sources of the same Debian, and the options with which apt reaches them.
    mapfile -t sources < <(grep -lsw "$SUITE" /etc/apt/sources.list /etc/apt/sources.list.d/*.{list,sources} || true)
    mapfile -t options < <(grep -ls Acquire /etc/apt/apt.conf /etc/apt/apt.conf.d/* || true)
    say "Building a Debian 12 ($SUITE) ..."
    mmdebstrap --quiet --mode=root --variant=minbase --include="$packages" "${options[@]/#/--aptopt=}" \
        "$SUITE" "$root" "${sources[@]}" || fail "mmdebstrap has built no root."
}

# Copies the settings with which this host reaches Debian's and Python's packages.
# usage: copy_settings ROOT HOME
copy_settings() {
    local root=$1 home=$2
    cp -L /etc/resolv.conf /etc/hosts "$root/etc/"
    cp -L --remove-destination /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
    [[ ! -d /etc/apt/trusted.gpg.d ]] || cp -rL /etc/apt/trusted.gpg.d/. "$root/etc/apt/trusted.gpg.d/"
    [[ ! -f /etc/pip.conf ]] || cp -L /etc/pip.conf "$root/etc/"
    [[ ! -d /etc/xdg/pip ]] || { mkdir -p "$root/etc/xdg" && cp -rL /etc/xdg/pip "$root/etc/xdg/"; }
    [[ ! -d ~/.config/pip ]] || { mkdir -p "$home/.config" && cp -rL ~/.config/pip "$home/.config/"; }
}
