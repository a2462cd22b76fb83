#!/usr/bin/env bash
# Runs the README's commands in a new Debian 12 that has only what the README asks for, as an ordinary user who may use
# sudo, on a clone of the last commit. At the end it lists what failed and what was skipped.
# usage, as root: deploy/fresh.sh [--no-shm] [--keep FOLDER] [TARGET...]     TARGET: of make; demo and test by default
#
# --no-shm leaves the new root without /dev/shm. --keep builds the root in FOLDER and leaves it there with what was
# installed: the next run with the same FOLDER begins with that and only takes the new commit. apt's sources, keys and options, pip's settings with the folders
# that they name, certificates and proxies of this host hold in there, too. Without --keep the root goes away at the end.
set -euo pipefail
cd "$(dirname "$0")/.."

readonly SUITE=bookworm
readonly USER_ID=1000
readonly HOME_THERE=/home/someone
readonly PACKAGES=ca-certificates,git,make,python3,sudo

say() { echo "fresh: $*" >&2; }

fail() { say "$*"; exit 2; }

# --- inside: process 1 of namespaces of its own, so that no process and no mount outlasts it -------------------------

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
    [[ -n $no_shm ]] || { mkdir "$1/dev/shm" && mount -t tmpfs -o mode=1777 none "$1/dev/shm"; }
}

# Folders and files of this host that pip's settings name; an index by file:// has its files beside its folder `simple`.
pip_paths() {
    { python3 -m pip config list 2>/dev/null || true; env | grep '^PIP_' || true; } |
        grep -oE "(file://|[\"'= ])/[^\"' ]*" | sed -E 's,^[^/]*(//)?,,; s,/simple/?$,,' | sort -u
}

enter() {
    local path root=$1
    mount --bind "$root" "$root"
    mount -t proc none "$root/proc"
    mount --rbind /sys "$root/sys"
    mount_devices "$root"
    while read -r path; do
        rmdir "$root$path" 2>/dev/null || true  # the place of a mount, where an earlier run made it
        [[ -e $path && ! -s $root$path ]] || continue
        mkdir -p "$(dirname "$root$path")"
        if [[ -d $path ]]; then mkdir "$root$path"; else touch "$root$path"; fi
        mount --bind -o ro "$path" "$root$path"
    done < <(pip_paths)
    mkdir -p "$root/.host"
    cd "$root"
    pivot_root . .host
    umount -l /.host
    cd /
}

run_there() {
    local settings
    mapfile -d '' settings < <(env -0 | grep -z -i -E '^(PIP_[A-Z_]*|(https?|no|all)_proxy|SSL_CERT_[A-Z]*)=')
    env -i "${settings[@]}" HOME="$HOME_THERE" USER=someone LOGNAME=someone LANG=C.UTF-8 TERM=dumb \
        PATH=/usr/local/bin:/usr/bin:/bin PYTEST_ADDOPTS=-rfEs \
        setpriv --reuid="$USER_ID" --regid="$USER_ID" --init-groups \
        bash -c 'cd ~/farm && "$@"' - "$@"
}

if [[ ${1:-} == --inside ]]; then
    no_shm=$2 root=$3
    shift 3
    ip link set lo up 2>/dev/null || true
    enter "$root"
    failed=0
    for target in "$@"; do
        echo "fresh: make $target"
        begun=$SECONDS
        code=0
        run_there make --no-print-directory "$target" || code=$?
        echo "fresh: make $target ended with $code after $((SECONDS - begun)) s"
        ((code == 0)) || failed=1
    done
    exit "$failed"
fi

# --- outside ----------------------------------------------------------------------------------------------------------

no_shm='' kept=''
while [[ ${1:-} == --* ]]; do
    case $1 in
        --no-shm) no_shm=1 ;;
        --keep) kept=${2:?--keep needs a folder} && shift ;;
        *) fail "There is no option $1." ;;
    esac
    shift
done
targets=("$@")
((${#targets[@]})) || targets=(demo test)

[[ $(id -u) == 0 ]] || fail "This needs root, for the new root and its mounts: sudo make fresh"
if ! command -v mmdebstrap >/dev/null; then
    command -v apt-get >/dev/null || fail "There is no mmdebstrap and no apt here."
    say "Installing mmdebstrap ..."
    install=(env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends mmdebstrap)
    "${install[@]}" >/dev/null || { apt-get update -qq && "${install[@]}" >/dev/null; } || fail "apt has no mmdebstrap."
fi
[[ -z $(git status --porcelain) ]] || say "Changes that are not committed are ignored: it runs $(git rev-parse --short HEAD)."
commit=$(git rev-parse --short HEAD) # somebody may check out another one while it runs

scratch=$(mktemp -d /var/tmp/farm-fresh.XXXXXX)
trap 'rm -rf --one-file-system "$scratch"' EXIT
chmod 755 "$scratch"
root=${kept:+$(realpath -m "$kept")}
root=${root:-$scratch/root}
home=$root$HOME_THERE
log=$scratch/log

build_root() {
    local sources options
    # What this host says of the same Debian: its sources, and the options that apt needs to reach them.
    mapfile -t sources < <(grep -lsw "$SUITE" /etc/apt/sources.list /etc/apt/sources.list.d/*.{list,sources} || true)
    mapfile -t options < <(grep -ls Acquire /etc/apt/apt.conf /etc/apt/apt.conf.d/* || true)
    say "Building a Debian 12 ($SUITE) ..."
    mmdebstrap --quiet --mode=root --variant=minbase --include="$PACKAGES" "${options[@]/#/--aptopt=}" \
        "$SUITE" "$root" "${sources[@]}" || fail "mmdebstrap has built no root."
    useradd --root "$root" --uid "$USER_ID" --create-home --shell /bin/bash someone
    echo 'someone ALL=(ALL) NOPASSWD: ALL' > "$root/etc/sudoers.d/someone"
}

# How this host reaches Debian and Python's packages.
copy_settings() {
    cp -L /etc/resolv.conf /etc/hosts "$root/etc/"
    cp -L --remove-destination /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
    [[ ! -d /etc/apt/trusted.gpg.d ]] || cp -rL /etc/apt/trusted.gpg.d/. "$root/etc/apt/trusted.gpg.d/"
    [[ ! -f /etc/pip.conf ]] || cp -L /etc/pip.conf "$root/etc/"
    [[ ! -d /etc/xdg/pip ]] || { mkdir -p "$root/etc/xdg" && cp -rL /etc/xdg/pip "$root/etc/xdg/"; }
    [[ ! -d ~/.config/pip ]] || { mkdir -p "$home/.config" && cp -rL ~/.config/pip "$home/.config/"; }
}

# The commit that is checked out here; what a kept root has installed for an earlier one stays.
take_commit() {
    local git=(git -c safe.directory='*' -C "$home/farm")
    [[ -d $home/farm ]] || git clone --quiet --no-hardlinks --no-checkout . "$home/farm"
    "${git[@]}" fetch --quiet "$PWD" HEAD
    "${git[@]}" checkout --quiet --force --detach FETCH_HEAD
    "${git[@]}" clean -qfdx --exclude=/.venv --exclude=/.cura
    chown -R "$USER_ID:$USER_ID" "$home"
}

[[ -x $root/bin/bash ]] || build_root
copy_settings
take_commit

code=0
unshare --mount --pid --fork --kill-child --propagation private \
    "$PWD/deploy/fresh.sh" --inside "$no_shm" "$root" "${targets[@]}" 2>&1 | tee "$log" || code=$?

say "In a new Debian 12${no_shm:+ without /dev/shm}, at $commit:"
grep -aE '^(FAILED|ERROR|SKIPPED) |^[0-9]+ (passed|failed|skipped)|^fresh: make .* ended' "$log" >&2 || true
exit "$code"
