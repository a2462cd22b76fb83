#!/usr/bin/env bash
# Builds the container with buildah on a new Debian 12, without a registry, and prints a model on its simulated printers.
# usage, as root: deploy/container/test.sh [DEB]     default: the newest package in build/dist; takes ten minutes
#
# It needs neither a container engine nor its daemon: the image is built in chroots, and its command runs in the image's
# files, in separate namespaces, with the user, environment and folder that the image names.
set -euo pipefail
cd "$(dirname "$0")/../.."

readonly SCRIPT_NAME=test-container
. deploy/debian-root.sh

readonly BASE=docker.io/library/debian:12-slim # as in the container file

# --- inside: process 1 in separate namespaces, so that all processes and mounts end with it --------------------------

# Runs a command as the image does. usage: run_as_image COMMAND ...
run_as_image() {
    local settings
    mapfile -t settings < /tmp/environment
    env -i "${settings[@]}" setpriv --reuid="$(cat /tmp/user)" --regid="$(cat /tmp/user)" --init-groups \
        env --chdir="$(cat /tmp/folder)" "$@"
}

daemon_answers() { run_as_image farm status > /dev/null 2>&1; }

wait_for_daemon() {
    local deadline=$((SECONDS + 300))
    until daemon_answers; do
        ((SECONDS < deadline)) || return 1
        sleep 1
    done
}

run_image() {
    local command daemon
    mapfile -t command < /tmp/command
    run_as_image "${command[@]}" &
    check "the command of the image is a daemon that answers" wait_for_daemon
    check "its printers are simulated" bash -c '! grep -q "port: /" /etc/farm/fleet.yaml'
    run_as_image /opt/farm/.venv/bin/python -c 'import trimesh; trimesh.creation.box((20, 20, 4)).export("/tmp/box.stl")'
    check "a model is printed" run_as_image farm submit /tmp/box.stl --wait
    run_as_image farm status
    check "it was printed on a printer of the image" grep -q '"state": "done"' <(run_as_image farm history --json)
    daemon=$(run_as_image farm status --json | python3 -c 'import json, sys; print(json.load(sys.stdin)["daemon"]["pid"])')
    kill -TERM "$daemon"
    check "the daemon ends at SIGTERM" wait %1
}

if [[ ${1:-} == --inside ]]; then
    enter "$2"
    run_image
    exit
fi

# --- outside ----------------------------------------------------------------------------------------------------------

[[ $(id -u) == 0 ]] || fail "This needs root, for new roots and their mounts: sudo make test-container"
command -v buildah > /dev/null || fail "There is no buildah: apt-get install buildah"
deb=$(find_package "${1:-}")
need_mmdebstrap
make_scratch container
export BUILDAH_ISOLATION=chroot
buildah() { command buildah --root "$scratch/storage" --runroot "$scratch/run" --storage-driver vfs "$@"; }

build_root "$scratch/base" ca-certificates
copy_settings "$scratch/base" "$scratch/base/root"
say "Making $BASE from it ..."
container=$(buildah from scratch)
buildah add --quiet "$container" "$scratch/base" / > /dev/null
buildah config --cmd bash "$container"
buildah commit --quiet "$container" "$BASE" > /dev/null
buildah rm "$container" > /dev/null
rm -rf --one-file-system "$scratch/base"

mkdir -p "$scratch/context/build/dist" "$scratch/context/deploy"
cp "$deb" "$scratch/context/build/dist/"
cp -r deploy/container "$scratch/context/deploy/"
say "Building the image ..."
buildah bud --network host --pull-never -f "$scratch/context/deploy/container/Containerfile" -t farm "$scratch/context"
buildah rmi "$BASE" > /dev/null 2>&1 || true

container=$(buildah from --pull-never localhost/farm)
root=$(buildah mount "$container")
buildah inspect --type image localhost/farm | python3 -c 'import json, pathlib, sys
config, root = json.load(sys.stdin)["OCIv1"]["config"], pathlib.Path(sys.argv[1])
for name, lines in (
    ("environment", config["Env"]), ("user", [config["User"]]), ("folder", [config["WorkingDir"]]), ("command", config["Cmd"])
):
    (root / "tmp" / name).write_text("".join(f"{line}\n" for line in lines))' "$root"
unshare --mount --pid --fork --kill-child --propagation private "$PWD/deploy/container/test.sh" --inside "$root"
say "The image is built, and its farm prints."
