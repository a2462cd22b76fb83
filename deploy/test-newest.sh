#!/usr/bin/env bash
# Runs the tests that start no farm of real processes and whose results may differ with a newer Python, with the newest
# installed Python for which all locked dependencies have wheels. If none is newer than 3.11, it prints a line and succeeds.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "newest: $*" >&2; }

# Prints the path of a Python of this version. A program of that name may be a shim without a Python behind it.
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

# Python versions differ in syntax, types, asyncio and the interfaces of libraries. Machine code, CuraEngine, exact geometry,
# other programs, packages and documents do not depend on the version, so their tests run only with the older Python, except
# for one whole decomposition with compiled machine code.
SERVER_TESTS=(tests/farm/web tests/farm/http tests/farm/control)
OTHER_TESTS=(tests/farm tests/drivers tests/slicing/{checks,own_gcode,settings} tests/decompose/{export,geometry}
    tests/decompose/{decompose/test_decompose_example,test_jit,test_options}.py)
COMPUTING_TESTS=(tests/farm/planning/{local,parts,test_job_planner.py,replanning/test_replan.py})

for version in 3.13 3.12; do
    python=$(find_python "$version") || continue
    venv=.venv/python$version
    install "$python" "$venv" || { say "Python $version: not every dependency can be installed."; continue; }
    say "$("$venv/bin/python" -VV)"
    # Short tracebacks: long ones read the arguments of frames, which crashes CPython 3.13.0.
    test() { "$venv/bin/python" -m pytest -m "not system" -p no:cacheprovider --tb=short "$@"; }
    test "${SERVER_TESTS[@]}" > "$venv/servers.log" 2>&1 & servers=$!
    failed=0
    test "${OTHER_TESTS[@]}" $(printf -- ' --ignore=%s' "${SERVER_TESTS[@]}" "${COMPUTING_TESTS[@]}") || failed=1
    wait "$servers" || failed=1
    cat "$venv/servers.log"
    exit "$failed"
done
say "There is no Python newer than 3.11 with all dependencies: no test was run."
