#!/usr/bin/env bash
# Installs third-party programs for some tests, without root, compiler or server: OctoPrint, Printrun, OctoRest and Qt in a
# separate virtual environment, and in its folders Debian's ssh, ser2net, tcc, promtool and prusa-slicer (330 MB), which are
# only unpacked. It names programs that are not available; the tests that need them are skipped.
# usage: install-peers.sh ENVIRONMENT
set -euo pipefail
cd "$(dirname "$0")/.."

ENVIRONMENT=$1
REQUIREMENTS=tests/interop/requirements.txt
declare -A PACKAGES=([ssh]=openssh-client [ssh-keygen]=openssh-client [sshd]=openssh-server [ser2net]=ser2net [tcc]=tcc
    [promtool]=prometheus [prusa-slicer]=prusa-slicer)

say() { echo "install: $*" >&2; }

install_environment() {
    local pip=("$ENVIRONMENT/bin/python" -m pip --disable-pip-version-check install --quiet --no-warn-conflicts)
    "${PYTHON:-python3.11}" -m venv "$ENVIRONMENT" && "${pip[@]}" --no-deps -r "$REQUIREMENTS" || return 1
    # netifaces would need a C compiler; the requirements contain a wheel of another project instead.
    "$ENVIRONMENT/bin/python" > "$ENVIRONMENT/required" <<'END' || return 1
from importlib.metadata import requires
for line in requires("OctoPrint") or ():
    if "extra ==" not in line and not line.startswith("netifaces"):
        print(line)
END
    "${pip[@]}" -r "$ENVIRONMENT/required"
}

# Lists the packages that this host lacks for the given programs, with all their dependencies except fonts.
list_missing_packages() {
    apt-get -s install --no-install-recommends "$@" 2>/dev/null | awk '/^Inst / && $2 !~ /^fonts-/ { print $2 }'
}

# Writes a start script with which an unpacked program finds its libraries and files.
write_starter() {
    local name=$1 program option='' plugins='' here=$2
    program=$(find "$here/usr" -path "*bin/$name")
    [[ -n $program ]] || return 1
    # Since OpenSSH 9.8, sshd calls a program by its installed path, so an unpacked sshd does not work.
    [[ $name != sshd || ! -e $here/usr/lib/openssh/sshd-session ]] || return 1
    [[ $name != tcc ]] || option="-B$(dirname "$(find "$here/usr/lib" -name libtcc1.a)")"
    [[ $name != ser2net ]] || plugins=$(find "$here/usr" -name libgensio_net.so -printf '%h')
    printf '#!/bin/sh\nexport LD_LIBRARY_PATH="%s"\nexport GENSIO_LIBRARY_PATH="%s"\nexec "%s" %s "$@"\n' \
        "$(find "$here" -name '*.so.*' -printf '%h\n' | sort -u | paste -sd :)" "$plugins" "$program" "$option" \
        > "$ENVIRONMENT/bin/$name"
    chmod +x "$ENVIRONMENT/bin/$name"
}

unpack_programs() {
    local name package closure here=$ENVIRONMENT/debian
    closure=$(list_missing_packages "$@") && [[ -n $closure ]] || return 1
    mkdir -p "$here" "$ENVIRONMENT/bin"
    (cd "$here" && xargs apt-get -o APT::Sandbox::User="$(id -un)" download -qq) <<< "$closure" >/dev/null 2>&1 ||
        return 1
    for package in "$here"/*.deb; do dpkg-deb -x "$package" "$here" && rm "$package"; done
    for name in "${missing[@]}"; do write_starter "$name" "$here" || true; done
}

if [[ ! -f $ENVIRONMENT/.installed || $REQUIREMENTS -nt $ENVIRONMENT/.installed ]]; then
    say "Installing OctoPrint, Printrun, OctoRest and Qt into $ENVIRONMENT, for the tests ..."
    if install_environment; then
        touch "$ENVIRONMENT/.installed"
    else
        rm -rf "$ENVIRONMENT"
        say "They are not available here: the tests that need them are skipped."
    fi
fi

# Unpacks those of the given programs that this host lacks: all or none, as a package may not be available.
unpack_missing() {
    local name packages=() unavailable=()
    missing=()
    for name in "$@"; do
        PATH=$ENVIRONMENT/bin:$PATH:${SBIN:-/usr/local/sbin:/usr/sbin} command -v "$name" >/dev/null && continue
        missing+=("$name")
        packages+=("${PACKAGES[$name]}")
    done
    ((${#missing[@]})) || return 0
    say "Unpacking Debian's ${missing[*]} into $ENVIRONMENT, for the tests ..."
    { command -v apt-get >/dev/null && unpack_programs "${packages[@]}"; } || true
    for name in "${missing[@]}"; do [[ -x $ENVIRONMENT/bin/$name ]] || unavailable+=("$name"); done
    ((${#unavailable[@]} == 0)) || say "Not available from apt: ${unavailable[*]}. The tests that need them are skipped."
}

unpack_missing ssh ssh-keygen sshd ser2net tcc promtool
unpack_missing prusa-slicer
