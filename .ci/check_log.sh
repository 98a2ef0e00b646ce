#!/usr/bin/env bash
# check_log.sh LOG...: every message of each log decoded by three independent readers: Foxglove's, rosbags, Rerun.
#
# What they need is installed into a scratch folder; set CHECK_LOG_SCRATCH to a folder to keep it for the next time.
set -euo pipefail
HERE=$(cd "$(dirname "$0")" && pwd)
. "$HERE/scratch.sh"
[ $# -ge 1 ] || { echo "usage: $0 LOG..." >&2; exit 2; }

scratch "${CHECK_LOG_SCRATCH:-}"

if [ ! -x "$SCRATCH/venv/bin/rerun" ]; then
    python3 -m venv "$SCRATCH/venv"
    "$SCRATCH/venv/bin/pip" install --quiet --disable-pip-version-check rosbags rerun-sdk
fi
if [ ! -d "$SCRATCH/npm/node_modules/@mcap/support" ]; then
    mkdir -p "$SCRATCH/npm"
    npm install --silent --no-save --no-audit --no-fund --no-package-lock --prefix "$SCRATCH/npm" \
        @mcap/core @mcap/support @foxglove/rosmsg @foxglove/rosmsg2-serialization
fi
cp "$HERE/check_log.mjs" "$SCRATCH/npm/"

rerun() { # rerun ARGUMENTS...: fails on an error line too, and says nothing to anybody else
    HOME=$SCRATCH "$SCRATCH/venv/bin/rerun" "$@" >"$SCRATCH/rerun.txt" 2>&1 || { cat "$SCRATCH/rerun.txt"; return 1; }
    ! grep -w ERROR "$SCRATCH/rerun.txt"
}
rerun analytics disable || true

for LOG in "$@"; do
    echo "$LOG"
    FOXGLOVE=$(node "$SCRATCH/npm/check_log.mjs" "$LOG")
    echo "  foxglove: $FOXGLOVE messages decoded"
    ROSBAGS=$("$SCRATCH/venv/bin/python" "$HERE/check_log.py" "$LOG")
    echo "  rosbags:  $ROSBAGS messages decoded"
    [ "$FOXGLOVE" = "$ROSBAGS" ] && [ "$FOXGLOVE" -gt 0 ] || { echo "  the counts differ or are 0"; exit 1; }
    rerun mcap check --full "$LOG"
    CHANNELS=$(grep -cE '^ok ' "$SCRATCH/rerun.txt" || true)
    OTHERS=$(sed '1,/^──/d' "$SCRATCH/rerun.txt" | grep -vE '^(ok .*|)$' || true)
    [ -z "$OTHERS" ] && [ "$CHANNELS" -gt 0 ] || { cat "$SCRATCH/rerun.txt"; exit 1; }
    echo "  rerun mcap check:   $CHANNELS channels ok"
    rerun mcap convert "$LOG" -o "$SCRATCH/check.rrd"
    ROWS=$(sed -nE 's/.*Processed ([0-9]+) messages.*/\1/p' "$SCRATCH/rerun.txt")
    [ -s "$SCRATCH/check.rrd" ] || { echo "  nothing was converted"; exit 1; }
    echo "  rerun mcap convert: $ROWS chunks, $(stat -c %s "$SCRATCH/check.rrd") bytes, no error"
    rm -f "$SCRATCH/check.rrd"
done
