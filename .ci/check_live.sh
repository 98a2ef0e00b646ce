#!/usr/bin/env bash
# check_live.sh: a flight with --live, watched by Foxglove's own client from npm, which must see what the log has.
#
# Needs node, npm and ahrs-sim[live] in .venv (AHRS_SIM: another ahrs-sim). The client is installed into a scratch folder;
# set CHECK_LIVE_SCRATCH to a folder to keep it for the next time.
set -euo pipefail
HERE=$(cd "$(dirname "$0")" && pwd)
AHRS_SIM=${AHRS_SIM:-$HERE/../.venv/bin/ahrs-sim}
PORT=${PORT:-8765}

OUT=$(mktemp -d)
trap 'rm -rf "$OUT"' EXIT
SCRATCH=${CHECK_LIVE_SCRATCH:-$OUT}
mkdir -p "$SCRATCH"
if [ ! -d "$SCRATCH/node_modules/@foxglove/ws-protocol" ]; then
    npm install --silent --no-save --no-audit --no-fund --no-package-lock --prefix "$SCRATCH" \
        @foxglove/ws-protocol @foxglove/rosmsg @foxglove/rosmsg2-serialization ws
fi
cp "$HERE/check_live.mjs" "$SCRATCH/"
node "$SCRATCH/check_live.mjs" "ws://localhost:$PORT" > "$OUT/seen.json" &
VIEWER=$!
"$AHRS_SIM" fly circuit --duration 30 --live="$PORT" --rate 5 -o "$OUT/live.mcap" --quiet
wait $VIEWER
"$AHRS_SIM" info "$OUT/live.mcap" --json > "$OUT/log.json"
# Whoever comes when the flight begins misses its first moments, hence 80 %; tests/test_live.py compares message by message.
node -e '
const [seen, log] = process.argv.slice(1).map((name) => JSON.parse(require("fs").readFileSync(name)));
let messages = 0, topics = 0;
for (const { topic, messages: count } of log.topics) {
  if (!(topic in seen)) throw new Error(`${topic}: not offered`);
  if (count > 20 && seen[topic] < 0.8 * count) throw new Error(`${topic}: ${seen[topic]} of ${count} messages`);
  messages += seen[topic];
  topics++;
}
console.log(`${messages} messages of ${topics} topics seen live and decoded`);
' "$OUT/seen.json" "$OUT/log.json"
