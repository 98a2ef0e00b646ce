#!/usr/bin/env bash
# check_page.sh PAGE.html EXPECTED.json FOLDER FILE...: the page of `ahrs-sim export-page` in a real browser, FILEs dropped
# on it; its table has the figures of EXPECTED (`ahrs-sim replay FILE --json`); screenshots go into FOLDER.
#
# Needs node, npm and Chromium (CHROMIUM, default /usr/bin/chromium). playwright-core is installed into a scratch folder;
# set CHECK_REPORT_SCRATCH to a folder to keep it for the next time.
set -euo pipefail
HERE=$(cd "$(dirname "$0")" && pwd)
. "$HERE/scratch.sh"
[ $# -ge 4 ] || { echo "usage: $0 PAGE.html EXPECTED.json FOLDER FILE..." >&2; exit 2; }

scratch "${CHECK_REPORT_SCRATCH:-}"
mkdir -p "$3"
browser
cp "$HERE/check_page.mjs" "$SCRATCH/"
node "$SCRATCH/check_page.mjs" "$@"
