#!/usr/bin/env bash
# Runs tests that start no farm of real processes, and that may differ with a newer Python, with the newest one here for
# which all locked dependencies have wheels. Where there is none newer than 3.11 it prints one line and ends without an error.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "newest: $*" >&2; }

# An existing program may be a shim that runs no Python.
find_python() {
    local path version=$1
    local pyenv=${PYENV_ROOT:-$HOME/.pyenv}/versions
    for path in "$(command -v "python$version" || true)" "$pyenv/$version".*/bin/python; do
        [[ -x $path && $("$path" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) == "$version" ]] &&
            echo "$path" && return 0
    done
    return 1
}

install() {
    local pip=("$2/bin/python" -m pip --disable-pip-version-check install --quiet)
    [[ ! -f $2/.installed || requirements-dev.lock -nt $2/.installed ]] || return 0
    rm -rf "$2"
    "$1" -m venv "$2" &&
        "${pip[@]}" --no-compile --require-hashes --only-binary :all: -r requirements-dev.lock &&
        "${pip[@]}" --no-deps --no-build-isolation -e . && touch "$2/.installed"
}

# What differs from one Python to the next: syntax, types, asyncio, the libraries' own interfaces. Machine code, CuraEngine and
# exact geometry compute the same under each, as do other programs, packages and documents: those are tested with the older
# one. One whole decomposition, with its machine code compiled, stays.
SERVERS=(tests/farm/web tests/farm/http tests/farm/control)
OTHERS=(tests/farm tests/drivers tests/slicing/{checks,own_gcode,settings} tests/decompose/{export,geometry}
    tests/decompose/test_{decompose_example,jit,options}.py)
COMPUTING=(tests/farm/planning/{local,parts,test_job_planner.py,replanning/test_replan.py})

for version in 3.13 3.12; do
    python=$(find_python "$version") || continue
    venv=.venv/python$version
    install "$python" "$venv" || { say "Python $version: not every dependency can be installed."; continue; }
    say "$("$venv/bin/python" -VV)"
    # A long traceback reads the arguments of frames, which crashes CPython 3.13.0.
    test() { "$venv/bin/python" -m pytest -m "not system" -p no:cacheprovider --tb=short "$@"; }
    test "${SERVERS[@]}" > "$venv/servers.log" 2>&1 & servers=$!
    failed=0
    test "${OTHERS[@]}" $(printf -- ' --ignore=%s' "${SERVERS[@]}" "${COMPUTING[@]}") || failed=1
    wait "$servers" || failed=1
    cat "$venv/servers.log"
    exit "$failed"
done
say "There is no Python newer than 3.11 that has all dependencies: no test is run."
