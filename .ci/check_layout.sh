#!/usr/bin/env bash
# check_layout.sh LOG LAYOUT.json [FOLDER]: a log with a layout in the prebuilt Foxglove Studio of npm; screenshots of every
# tab go into FOLDER.
#
# Needs node, npm and Chromium (CHROMIUM, default /usr/bin/chromium). The studio (180 MB) is installed into a scratch folder;
# set CHECK_LAYOUT_SCRATCH to a folder to keep it for the next time.
set -euo pipefail
HERE=$(cd "$(dirname "$0")" && pwd)
. "$HERE/scratch.sh"
[ $# -ge 2 ] || { echo "usage: $0 LOG LAYOUT.json [FOLDER]" >&2; exit 2; }

scratch "${CHECK_LAYOUT_SCRATCH:-}"
SHOTS=${3:-$SCRATCH/shots}
mkdir -p "$SHOTS"
if [ ! -d "$SCRATCH/node_modules/playwright-core" ]; then
    npm install --silent --no-save --no-audit --no-fund --no-package-lock --legacy-peer-deps --ignore-scripts \
        --prefix "$SCRATCH" @foxglove/studio-base@1.48 react@17 react-dom@17 playwright-core
fi
cp "$HERE/check_layout.mjs" "$SCRATCH/"
node "$SCRATCH/check_layout.mjs" "$(realpath "$1")" "$(realpath "$2")" "$(realpath "$SHOTS")"
