#!/usr/bin/env bash
# CuraEngine and Cura's settings of the same version, without Cura's desktop program: 4.13 (Debian 12) or 5 (Debian 13).
#
# The engine is Debian's package. The settings are taken out of Debian's packages `cura` and `fdm-materials` without
# installing them, into FOLDER. Both can be given instead: FARM_CURA_ENGINE (the program)
# and FARM_CURA_RESOURCES (the folder with definitions, extruders, variants, quality, materials).
# Usage: install-cura.sh FOLDER     `farm setup` and `make install` call it.
set -euo pipefail

RESOURCES=$1
FOLDERS=(definitions extruders variants quality materials)

say() { echo "install: $*" >&2; }

fail() {
    say "$1"
    cat >&2 <<END
install: These are needed; the variables tell where they are:
install:   CuraEngine 4.13 or 5                   export FARM_CURA_ENGINE=/path/to/CuraEngine
install:   Cura's resources of the same version   export FARM_CURA_RESOURCES=/path/to/resources
install:     (the folder that has ${FOLDERS[*]};
install:     'materials' is a package of its own, fdm-materials)
install: On Debian 12 and 13 'farm setup' and 'make install' get both by themselves.
END
    exit 1
}

is_supported() { [[ $1 == 4.13 || $1 == 5.* ]]; }

# The engine prints its version, such as 4.13.0, in the first lines of its help, and exits with code 1.
read_engine_version() { { "$1" help 2>&1 || true; } | head -n 3 | sed -n 's/.*version \([0-9]*\.[0-9]*\).*/\1/p'; }

# Print the Cura version of the settings in a folder, which have their own version numbers.
read_settings_version() {
    local folder number
    for folder in "${FOLDERS[@]}"; do
        [[ -d $1/$folder ]] || return 0
    done
    [[ -f $1/definitions/ultimaker2_plus.def.json && -f $1/materials/generic_pla.xml.fdm_material ]] || return 0
    number=$(sed -n 's/.*"setting_version": *\([0-9]*\).*/\1/p' "$1/definitions/fdmprinter.def.json" | head -n 1)
    case $number in
        19) echo 4.13 ;;
        20) echo 5.0 ;;
        2[1-9]) echo 5.x ;;  # the number does not tell which release of Cura 5
    esac
}

versions_match() { [[ $1 == "$2" || ($2 == 5.x && $1 == 5.* && $1 != 5.0) ]]; }

# Print Debian's version of a package, such as 4.13, without epoch and revision.
find_candidate() { apt-cache policy "$1" 2>/dev/null | sed -n 's/ *Candidate: \([0-9]*:\)\?\([0-9]*\.[0-9]*\).*/\2/p'; }

has_candidates() {
    local package version
    for package in "$@"; do
        version=$(find_candidate "$package")
        is_supported "$version" && versions_match "$version" "${expected:-$version}" || return 1
    done
}

run_as_root() {
    if [[ $(id -u) == 0 ]]; then "$@"; else sudo "$@"; fi
}

require_root() {
    [[ $(id -u) == 0 ]] && return 0
    command -v sudo >/dev/null || fail "There is no sudo; run as root: $*"
    say "This needs root: $* (sudo may ask for your password)."
}

refresh_lists() {
    require_root "apt-get update"
    run_as_root apt-get update -qq
}

install_engine() {
    require_root "apt-get install cura-engine"
    run_as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends cura-engine >/dev/null
}

engine=${FARM_CURA_ENGINE:-$(command -v CuraEngine || true)}
engine_version=
[[ -z $engine || ! -x $engine ]] || engine_version=$(read_engine_version "$engine")
if [[ -n ${FARM_CURA_ENGINE:-} ]]; then
    is_supported "$engine_version" || fail "FARM_CURA_ENGINE=$FARM_CURA_ENGINE is not CuraEngine 4.13 or 5."
fi
is_supported "$engine_version" || engine_version=

settings_version=$(read_settings_version "${FARM_CURA_RESOURCES:-$RESOURCES}")
if [[ -n ${FARM_CURA_RESOURCES:-} ]]; then
    is_supported "$settings_version" ||
        fail "FARM_CURA_RESOURCES=$FARM_CURA_RESOURCES is not Cura's resources folder (${FOLDERS[*]}) of 4.13 or 5."
    [[ -z $engine_version ]] || versions_match "$engine_version" "$settings_version" ||
        fail "CuraEngine is $engine_version, and FARM_CURA_RESOURCES=$FARM_CURA_RESOURCES is of Cura $settings_version."
fi
[[ -n $engine_version ]] && versions_match "$engine_version" "$settings_version" && exit 0

command -v apt-get >/dev/null || fail "There is no apt here."
expected=$engine_version
[[ -z ${FARM_CURA_RESOURCES:-} ]] || expected=${engine_version:-$settings_version}
wanted=()
[[ -n $engine_version ]] || wanted+=(cura-engine)
[[ -n ${FARM_CURA_RESOURCES:-} ]] || wanted+=(cura fdm-materials)
has_candidates "${wanted[@]}" || refresh_lists
has_candidates "${wanted[@]}" || fail "apt has no version ${expected:-4.13 or 5} of: ${wanted[*]}."

if [[ -z $engine_version ]]; then
    say "Installing cura-engine ..."
    install_engine || { refresh_lists && install_engine; } || fail "apt could not install cura-engine."
    engine=$(command -v CuraEngine) && engine_version=$(read_engine_version "$engine")
    is_supported "$engine_version" || fail "The CuraEngine on PATH is not version 4.13 or 5."
fi

if [[ -z ${FARM_CURA_RESOURCES:-} ]] && ! versions_match "$engine_version" "$settings_version"; then
    say "Extracting Cura's settings from Debian's packages 'cura' and 'fdm-materials', which are not installed ..."
    scratch=$(mktemp -d)
    trap 'rm -rf "$scratch"' EXIT
    # An outdated package list may name a file that no longer exists; it is then refreshed once.
    download() { (cd "$scratch" && apt-get -o APT::Sandbox::User="$(id -un)" download -qq cura fdm-materials); }
    download || { refresh_lists && download; } || fail "apt could not download cura and fdm-materials."
    for package in "$scratch"/*.deb; do dpkg-deb -x "$package" "$scratch/unpacked"; done
    mkdir -p "$scratch/resources"
    for folder in "${FOLDERS[@]}"; do
        cp -rL "$scratch/unpacked/usr/share/cura/resources/$folder" "$scratch/resources/"
    done
    versions_match "$engine_version" "$(read_settings_version "$scratch/resources")" ||
        fail "Debian's cura package does not have the settings of CuraEngine $engine_version."
    # The folder appears completely or not at all.
    mkdir -p "$(dirname "$RESOURCES")"
    rm -rf "$RESOURCES" "$RESOURCES.new"
    cp -r "$scratch/resources" "$RESOURCES.new"
    mv "$RESOURCES.new" "$RESOURCES"
fi
[[ -z ${FARM_CURA_RESOURCES:-} ]] || versions_match "$engine_version" "$settings_version" ||
    fail "CuraEngine is $engine_version, and FARM_CURA_RESOURCES=$FARM_CURA_RESOURCES is of Cura $settings_version."
say "CuraEngine $engine_version and Cura's settings are in place."
