#!/usr/bin/env bash
# check_page.sh PAGE.html EXPECTED.json FOLDER FILE...: the page of `ahrs-sim export-page` in a real browser, FILEs dropped
# on it; its table has the figures of EXPECTED (`ahrs-sim replay FILE --json`); screenshots go into FOLDER.
#
# Needs node, npm and Chromium (CHROMIUM, default /usr/bin/chromium). playwright-core is installed into a scratch folder;
# set CHECK_REPORT_SCRATCH to a folder to keep it for the next time.
set -euo pipefail
HERE=$(cd "$(dirname "$0")" && pwd)
[ $# -ge 4 ] || { echo "usage: $0 PAGE.html EXPECTED.json FOLDER FILE..." >&2; exit 2; }

if [ -n "${CHECK_REPORT_SCRATCH:-}" ]; then
    SCRATCH=$CHECK_REPORT_SCRATCH
    mkdir -p "$SCRATCH"
else
    SCRATCH=$(mktemp -d)
    trap 'rm -rf "$SCRATCH"' EXIT
fi
mkdir -p "$3"
if [ ! -d "$SCRATCH/node_modules/playwright-core" ]; then
    npm install --silent --no-save --no-audit --no-fund --no-package-lock --prefix "$SCRATCH" playwright-core
fi
cp "$HERE/check_page.mjs" "$SCRATCH/"
node "$SCRATCH/check_page.mjs" "$@"
