#!/usr/bin/env bash
# Builds build/dist/farm_VERSION_ARCHITECTURE.deb for Debian 12, on Debian 12; needs neither root nor debhelper.
# usage: deploy/debian/build.sh [VERSION]     default: the version in pyproject.toml with the number of commits
#
# /opt/farm/.venv contains the wheel of this checkout, the pinned dependencies, and Cura's settings from Debian's packages.
# It does not contain the path of the build folder.
set -euo pipefail
cd "$(dirname "$0")/../.."
umask 022

readonly BIN=$PWD/.venv/bin
readonly PYTHON=/usr/bin/python3.11
readonly VENV=/opt/farm/.venv

say() { echo "deb: $*" >&2; }

fail() { say "$*"; exit 2; }

for program in dpkg-deb ldd; do
    command -v "$program" >/dev/null || fail "There is no $program: apt-get install dpkg libc-bin"
done
[[ -x $PYTHON ]] || fail "The package is for Debian 12's Python, and there is no $PYTHON."

find_default_version() {
    local base
    base=$(sed -n 's/^version = "\(.*\)"$/\1/p' pyproject.toml)
    echo "$base+$(git rev-list --count HEAD).$(git rev-parse --short HEAD)"
}
version=${1:-$(find_default_version)}
architecture=$(dpkg --print-architecture)

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
root=$scratch/root
mkdir -p "$root$VENV" build/dist

# Makes the environment with Debian's Python, fills it with the checkout's pip, and sets it to its path after installation.
build_environment() {
    local pip=("$BIN/python" -m pip --disable-pip-version-check)
    rm -rf build/lib build/bdist.* # an earlier build may have left modules that no longer exist
    "${pip[@]}" wheel --quiet --no-deps --no-build-isolation -w "$scratch" .
    "$PYTHON" -m venv --without-pip "$root$VENV"
    local install=("${pip[@]}" --python "$root$VENV/bin/python" install --quiet --no-compile)
    "${install[@]}" --require-hashes -r requirements.lock
    "${install[@]}" --no-deps "$scratch"/farm-*.whl
    rm -f "$root$VENV"/lib/python3*/site-packages/farm-*.dist-info/direct_url.json # contains the path of the build
    "${pip[@]}" --python "$root$VENV/bin/python" uninstall --quiet --yes setuptools # needed only for builds
    find "$root$VENV/bin" -type f ! -name farm -delete
    find "$root$VENV" -name tests -type d -path '*/site-packages/*' -prune -exec rm -rf {} +
    sed -i "1s,.*,#!$VENV/bin/python," "$root$VENV/bin/farm"
    sed -i '/^command = /d' "$root$VENV/pyvenv.cfg"
    "$PYTHON" -m compileall -q -j0 -s "$root" -p / "$root$VENV/lib" >/dev/null || true # some libraries have files for other Pythons
}

# Lists Debian's packages with the libraries to which the wheels are linked, but which they do not contain.
list_libraries() {
    find "$root$VENV" -name '*.so*' -type f -exec ldd {} + 2>/dev/null |
        sed -n 's,.* => \(/[^ ]*\) (0x.*,\1,p' | grep -v "^$root" | sort -u |
        while read -r path; do
            dpkg-query --search "$path" "/usr$path" "$(realpath "$path")" 2>/dev/null || true
        done | sed 's/:.*//' | sort -u | paste -sd, | sed 's/,/, /g'
}

install_files() {
    local folder share=$root/usr/share
    install -Dm644 -t "$root/lib/systemd/system" deploy/systemd/*
    install -Dm644 -t "$root/lib/udev/rules.d" deploy/udev/60-farm.rules
    install -Dm644 -t "$share/polkit-1/rules.d" deploy/polkit/50-farm.rules
    install -Dm644 -t "$root/etc/needrestart/conf.d" deploy/needrestart/farm.conf
    install -Dm644 -t "$root/etc/farm" deploy/debian/fleet.yaml
    for folder in avahi caddy grafana prometheus; do
        [[ ! -d deploy/$folder ]] || install -Dm644 -t "$root/opt/farm/deploy/$folder" deploy/$folder/*
    done
    install -Dm644 -t "$share/doc/farm" deploy/debian/copyright README.md CHANGELOG.md
    cp -r docs/how-to docs/reference docs/tutorial docs/explanation "$share/doc/farm/"
    find "$share/doc/farm" -name '*.yaml' -delete
    "$BIN/python" deploy/debian/command_files.py "$root/usr/share" "$version"
    find "$share/man" -type f -exec gzip -9n {} +
    mkdir -p "$root/usr/bin"
    ln -s "$VENV/bin/farm" "$root/usr/bin/farm"
}

write_control() {
    local control=$root/DEBIAN
    mkdir "$control"
    install -m755 -t "$control" deploy/debian/{preinst,postinst,prerm,postrm}
    (cd "$root" && find etc -type f -printf '/%p\n' | sort) > "$control/conffiles"
    sed -e "s/@VERSION@/$version/" -e "s/@ARCHITECTURE@/$architecture/" -e "s/@LIBRARIES@/$(list_libraries)/" \
        -e "s/@SIZE@/$(du -sk --apparent-size "$root" | cut -f1)/" deploy/debian/control > "$control/control"
    (cd "$root" && find . -type f ! -path './DEBIAN/*' ! -path './etc/*' -printf '%P\0' | xargs -0 md5sum) \
        > "$control/md5sums"
}

say "Building the environment ..."
build_environment
say "Fetching Cura's settings ..."
env -u FARM_CURA_RESOURCES slicing/install-cura.sh .cura/resources
mkdir -p "$root$VENV/share/farm"
cp -r .cura/resources "$root$VENV/share/farm/cura"
install_files
write_control
say "Packing ..."
deb=build/dist/farm_${version}_$architecture.deb
dpkg-deb --root-owner-group -Zzstd -z9 --build "$root" "$deb" >/dev/null
say "$deb: $(du -h "$deb" | cut -f1), $(du -sh "$root" | cut -f1) installed"
