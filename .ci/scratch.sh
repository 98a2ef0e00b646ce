# Sourced by the checks of this folder: what they install goes into a folder outside of the tree.

# scratch FOLDER: SCRATCH is FOLDER, which is kept; or, when it is empty, a new one that goes away at the end.
scratch() {
    if [ -n "$1" ]; then
        SCRATCH=$1
        mkdir -p "$SCRATCH"
    else
        SCRATCH=$(mktemp -d)
        trap 'rm -rf "$SCRATCH"' EXIT
    fi
}

# browser: playwright-core in SCRATCH, which drives the Chromium of the machine.
browser() {
    [ -d "$SCRATCH/node_modules/playwright-core" ] ||
        npm install --silent --no-save --no-audit --no-fund --no-package-lock --prefix "$SCRATCH" playwright-core
}
