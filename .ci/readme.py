"""Run every command of the README's `sh` blocks, but for `make` (run before) and installation, in the checkout."""

import os
import re
import subprocess
import sys
from pathlib import Path

root = Path(__file__).parent.parent
blocks = re.findall(r"^```sh\n(.*?)^```", (root / "README.md").read_text(), re.MULTILINE | re.DOTALL)
lines = [line.split("  #")[0].strip() for block in blocks for line in block.splitlines()]
commands = [x for x in lines if x and not x.startswith(("#", "make ", "pip ", "git ", "cd "))]
if not commands:
    sys.exit("README: no commands found")
environment = os.environ | {"PATH": f"{root / '.venv/bin'}:{os.environ['PATH']}"}
for command in commands:
    sys.stdout.write(f"$ {command}\n")
    sys.stdout.flush()
    done = subprocess.run(["bash", "-c", command], cwd=root, env=environment, check=False)
    if done.returncode:
        sys.exit(f"README: '{command}' ended with {done.returncode}")
