#!/usr/bin/env bash
# Runs the README's commands in a new Debian 12 that has only the packages named in the README, as an ordinary user who may
# use sudo, on a clone of the last commit. At the end it lists failed and skipped tests.
# usage, as root: deploy/fresh.sh [--no-shm] [--keep FOLDER] [TARGET...]     TARGET: a target of make; default: demo test
#
# --no-shm leaves the new root without /dev/shm. --keep builds the root in FOLDER and keeps it there with everything that
# was installed; the next run with the same FOLDER uses this root and only fetches the new commit. Without --keep the root
# is deleted at the end. The new root uses this host's certificates and proxies, apt's sources, keys and options, and pip's
# settings with the folders that they name.
set -euo pipefail
cd "$(dirname "$0")/.."

readonly USER_ID=1000
readonly HOME_INSIDE=/home/someone
readonly PACKAGES=ca-certificates,git,make,python3,sudo

readonly SCRIPT_NAME=fresh
. deploy/debian-root.sh

# --- inside: process 1 in separate namespaces, so that all processes and mounts end with it --------------------------

run_inside() {
    local settings
    mapfile -d '' settings < <(env -0 | grep -z -i -E '^(PIP_[A-Z_]*|(https?|no|all)_proxy|SSL_CERT_[A-Z]*)=')
    env -i "${settings[@]}" HOME="$HOME_INSIDE" USER=someone LOGNAME=someone LANG=C.UTF-8 TERM=dumb \
        PATH=/usr/local/bin:/usr/bin:/bin PYTEST_ADDOPTS=-rfEs \
        setpriv --reuid="$USER_ID" --regid="$USER_ID" --init-groups \
        bash -c 'cd ~/farm && "$@"' - "$@"
}

if [[ ${1:-} == --inside ]]; then
    no_shm=$2 root=$3
    shift 3
    enter "$root" "$no_shm"
    failed=0
    for target in "$@"; do
        echo "fresh: make $target"
        start_s=$SECONDS
        code=0
        run_inside make --no-print-directory "$target" || code=$?
        echo "fresh: make $target ended with $code after $((SECONDS - start_s)) s"
        ((code == 0)) || failed=1
    done
    exit "$failed"
fi

# --- outside ----------------------------------------------------------------------------------------------------------

no_shm='' kept_root=''
while [[ ${1:-} == --* ]]; do
    case $1 in
        --no-shm) no_shm=1 ;;
        --keep) kept_root=${2:?--keep needs a folder} && shift ;;
        *) fail "There is no option $1." ;;
    esac
    shift
done
targets=("$@")
((${#targets[@]})) || targets=(demo test)

[[ $(id -u) == 0 ]] || fail "This needs root, for the new root and its mounts: sudo make fresh"
need_mmdebstrap
[[ -z $(git status --porcelain) ]] || say "Uncommitted changes are ignored: the test uses $(git rev-parse --short HEAD)."
commit=$(git rev-parse --short HEAD) # another commit may be checked out meanwhile

make_scratch fresh
root=${kept_root:+$(realpath -m "$kept_root")}
root=${root:-$scratch/root}
home=$root$HOME_INSIDE
log=$scratch/log

# Checks out the current commit in the root; files that an earlier run installed in a kept root stay.
fetch_commit() {
    local git=(git -c safe.directory='*' -C "$home/farm")
    [[ -d $home/farm ]] || git clone --quiet --no-hardlinks --no-checkout . "$home/farm"
    "${git[@]}" fetch --quiet "$PWD" HEAD
    "${git[@]}" checkout --quiet --force --detach FETCH_HEAD
    "${git[@]}" clean -qfdx --exclude=/.venv --exclude=/.cura
    chown -R "$USER_ID:$USER_ID" "$home"
}

if [[ ! -x $root/bin/bash ]]; then
    build_root "$root" "$PACKAGES"
    useradd --root "$root" --uid "$USER_ID" --create-home --shell /bin/bash someone
    echo 'someone ALL=(ALL) NOPASSWD: ALL' > "$root/etc/sudoers.d/someone"
fi
copy_settings "$root" "$home"
fetch_commit

code=0
unshare --mount --pid --fork --kill-child --propagation private \
    "$PWD/deploy/fresh.sh" --inside "$no_shm" "$root" "${targets[@]}" 2>&1 | tee "$log" || code=$?

say "In a new Debian 12${no_shm:+ without /dev/shm}, at $commit:"
grep -aE '^(FAILED|ERROR|SKIPPED) |^[0-9]+ (passed|failed|skipped)|^fresh: make .* ended' "$log" >&2 || true
exit "$code"
