#!/usr/bin/env bash
# Installs the peers of some tests, without root, compiler or server: OctoPrint, Printrun, OctoRest and Qt in a virtual
# environment of their own, and in its folders Debian's ssh, ser2net, tcc, promtool and prusa-slicer (330 MB), unpacked and
# not installed. It names what is not available; the tests that need it are skipped.
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
    # netifaces, which only a C compiler can install, is there as a wheel of another project.
    "$ENVIRONMENT/bin/python" > "$ENVIRONMENT/required" <<'END' || return 1
from importlib.metadata import requires
for line in requires("OctoPrint") or ():
    if "extra ==" not in line and not line.startswith("netifaces"):
        print(line)
END
    "${pip[@]}" -r "$ENVIRONMENT/required"
}

# Packages that this host lacks for the programs named, with all that they depend on but fonts.
needed() { apt-get -s install --no-install-recommends "$@" 2>/dev/null | awk '/^Inst / && $2 !~ /^fonts-/ { print $2 }'; }

# Debian's programs find their libraries and files beside them.
write_starter() {
    local name=$1 program option='' plugins='' here=$2
    program=$(find "$here/usr" -path "*bin/$name")
    [[ -n $program ]] || return 1
    # From OpenSSH 9.8 on sshd calls a program by the path where it would be installed.
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
    closure=$(needed "$@") && [[ -n $closure ]] || return 1
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

# Unpacks the programs named that this host lacks: all of them or none, as one package may not be available.
unpack_missing() {
    local name packages=() lacking=()
    missing=()
    for name in "$@"; do
        PATH=$ENVIRONMENT/bin:$PATH:${SBIN:-/usr/local/sbin:/usr/sbin} command -v "$name" >/dev/null && continue
        missing+=("$name")
        packages+=("${PACKAGES[$name]}")
    done
    ((${#missing[@]})) || return 0
    say "Unpacking Debian's ${missing[*]} into $ENVIRONMENT, for the tests ..."
    { command -v apt-get >/dev/null && unpack_programs "${packages[@]}"; } || true
    for name in "${missing[@]}"; do [[ -x $ENVIRONMENT/bin/$name ]] || lacking+=("$name"); done
    ((${#lacking[@]} == 0)) || say "Not available from apt: ${lacking[*]}. The tests that need them are skipped."
}

unpack_missing ssh ssh-keygen sshd ser2net tcc promtool
unpack_missing prusa-slicer
