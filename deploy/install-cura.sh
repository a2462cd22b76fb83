#!/usr/bin/env bash
# CuraEngine 4.13 and Cura's settings of the same version, without Cura's desktop program.
#
# The engine is Debian's package. The settings are taken out of Debian's `cura` package without installing it, into
# .cura/resources of this checkout. Both can be given instead: FARM_CURA_ENGINE (the program) and FARM_CURA_RESOURCES
# (the folder with definitions, extruders, variants, quality, materials).
set -euo pipefail
cd "$(dirname "$0")/.."

VERSION=4.13
RESOURCES=.cura/resources
FOLDERS=(definitions extruders variants quality materials)

say() { echo "install: $*" >&2; }

fail() {
    say "$1"
    cat >&2 <<END
install: What is needed, and how to point at it:
install:   CuraEngine $VERSION        export FARM_CURA_ENGINE=/path/to/CuraEngine
install:   Cura $VERSION's resources  export FARM_CURA_RESOURCES=/path/to/resources
install:     (the folder that has ${FOLDERS[*]};
install:     'materials' is a package of its own, fdm-materials $VERSION)
install: On Debian 12 'make install' gets both by itself.
END
    exit 1
}

has_settings() {
    local folder
    for folder in "${FOLDERS[@]}"; do
        [[ -d $1/$folder ]] || return 1
    done
    [[ -f $1/definitions/ultimaker2_plus.def.json && -f $1/materials/generic_pla.xml.fdm_material ]]
}

# The engine names its version in the first lines of its help; it exits 1 then.
right_engine() {
    [[ -x $1 ]] && { "$1" help 2>&1 || true; } | head -n 3 | grep -q "version $VERSION"
}

find_engine() {
    if [[ -n ${FARM_CURA_ENGINE:-} ]]; then
        right_engine "$FARM_CURA_ENGINE" || fail "FARM_CURA_ENGINE=$FARM_CURA_ENGINE is not CuraEngine $VERSION."
        return 0
    fi
    local engine
    engine=$(command -v CuraEngine) && right_engine "$engine"
}

find_settings() {
    if [[ -n ${FARM_CURA_RESOURCES:-} ]]; then
        has_settings "$FARM_CURA_RESOURCES" ||
            fail "FARM_CURA_RESOURCES=$FARM_CURA_RESOURCES is not Cura's resources folder (${FOLDERS[*]})."
        return 0
    fi
    has_settings "$RESOURCES"
}

candidate() { apt-cache policy "$1" 2>/dev/null | awk '/Candidate:/ { print $2 }'; }

has_candidates() {
    local package
    for package in "$@"; do
        [[ $(candidate "$package") == *"$VERSION"* ]] || return 1
    done
}

as_root() {
    if [[ $(id -u) == 0 ]]; then "$@"; else sudo "$@"; fi
}

need_root() {
    [[ $(id -u) == 0 ]] && return 0
    command -v sudo >/dev/null || fail "There is no sudo here; as root: $*"
    say "This needs root: $* (sudo may ask for your password)."
}

refresh_lists() {
    need_root "apt-get update"
    as_root apt-get update -qq
}

install_packages() {
    need_root "apt-get install $*"
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

missing_engine=no
missing_settings=no
find_engine || missing_engine=yes
find_settings || missing_settings=yes
[[ $missing_engine$missing_settings == nono ]] && exit 0

command -v apt-get >/dev/null || fail "There is no apt here."
wanted=()
[[ $missing_engine == yes ]] && wanted+=(cura-engine)
[[ $missing_settings == yes ]] && wanted+=(cura fdm-materials)
has_candidates "${wanted[@]}" || refresh_lists
has_candidates "${wanted[@]}" || fail "apt has no version $VERSION of: ${wanted[*]}."

packages=()
[[ $missing_engine == yes ]] && packages+=(cura-engine)
[[ $missing_settings == yes && ! -d /usr/share/cura/resources/materials ]] && packages+=(fdm-materials)
if ((${#packages[@]})); then
    say "Installing ${packages[*]} ..."
    install_packages "${packages[@]}" || { refresh_lists && install_packages "${packages[@]}"; } ||
        fail "apt could not install ${packages[*]}."
    [[ $missing_engine == no ]] || find_engine || fail "The CuraEngine on PATH is not version $VERSION."
fi

if [[ $missing_settings == yes ]]; then
    say "Taking Cura's settings out of Debian's package 'cura' (it is not installed) ..."
    scratch=$(mktemp -d)
    trap 'rm -rf "$scratch"' EXIT
    # A list that is old names a file that is gone; then it is refreshed once.
    download() { (cd "$scratch" && apt-get -o APT::Sandbox::User="$(id -un)" download -qq cura); }
    download || { refresh_lists && download; } || fail "apt could not download cura."
    dpkg-deb -x "$scratch"/cura_*.deb "$scratch/cura"
    mkdir -p "$scratch/resources"
    for folder in definitions extruders variants quality intent; do
        cp -r "$scratch/cura/usr/share/cura/resources/$folder" "$scratch/resources/"
    done
    cp -rL /usr/share/cura/resources/materials "$scratch/resources/materials"
    has_settings "$scratch/resources" || fail "Debian's cura package has not the files that were expected."
    # The folder appears whole or not at all.
    mkdir -p "$(dirname "$RESOURCES")"
    rm -rf "$RESOURCES" "$RESOURCES.new"
    cp -r "$scratch/resources" "$RESOURCES.new"
    mv "$RESOURCES.new" "$RESOURCES"
fi
say "CuraEngine and Cura's settings are in place."
