"""Do what the tutorials say, as a newcomer would: their commands and files alone, in order, in an empty folder each.

A block of `sh` is run, a block that follows a line "`NAME`:" is written to that file.
`python .ci/newcomers.py [TUTORIAL...]`.
"""

import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"(?:^`(?P<file>[\w./-]+)`:\n\n)?^```(?P<kind>\w+)\n(?P<text>.*?)^```", re.MULTILINE | re.DOTALL)


def script(tutorial: Path) -> str:
    """The tutorial as one shell script."""
    lines = ["set -euo pipefail"]
    for block in BLOCK.finditer(tutorial.read_text(encoding="utf-8")):
        if block["file"]:
            lines.append(f"cat > {block['file']} <<'END-OF-FILE'\n{block['text']}END-OF-FILE")
        elif block["kind"] == "sh":
            for command in block["text"].splitlines():
                expected = command.removeprefix("! ")  # `! command` does not end a script, whatever it returns
                check = (
                    f"if {expected}; then echo 'it must have failed'; exit 1; fi" if expected != command else command
                )
                lines += [f"echo {shlex.quote(f'$ {command}')}", check]
    return "\n".join(lines)


def main() -> None:
    """Run the tutorials that are named, or all."""
    tutorials = [Path(name) for name in sys.argv[1:]] or sorted((ROOT / "docs").glob("tutorial-*.md"))
    environment = os.environ | {"PATH": f"{ROOT / '.venv/bin'}:{os.environ['PATH']}"}
    for tutorial in tutorials:
        begun = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(["bash", "-c", script(tutorial)], cwd=folder, env=environment, check=False)
        if done.returncode:
            sys.exit(f"{tutorial.name}: ended with {done.returncode}")
        sys.stdout.write(f"=== {tutorial.name}: {time.monotonic() - begun:.0f} s\n")


if __name__ == "__main__":
    main()
