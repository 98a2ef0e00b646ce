#!/usr/bin/env bash
# check_report.sh REPORT.html [FOLDER]: a report in a real browser; screenshots go into FOLDER.
#
# Needs node, npm and Chromium (CHROMIUM, default /usr/bin/chromium). playwright-core is installed into a scratch folder;
# set CHECK_REPORT_SCRATCH to a folder to keep it for the next time.
set -euo pipefail
HERE=$(cd "$(dirname "$0")" && pwd)
. "$HERE/scratch.sh"
[ $# -ge 1 ] || { echo "usage: $0 REPORT.html [FOLDER]" >&2; exit 2; }

scratch "${CHECK_REPORT_SCRATCH:-}"
SHOTS=${2:-$SCRATCH/shots}
mkdir -p "$SHOTS"
browser
cp "$HERE/check_report.mjs" "$SCRATCH/"
node "$SCRATCH/check_report.mjs" "$(realpath "$1")" "$(realpath "$SHOTS")"
