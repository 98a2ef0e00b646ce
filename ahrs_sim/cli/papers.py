"""`ahrs-sim papers`: what the papers claim and what comes out here."""

import argparse
import json
from pathlib import Path

from ahrs_sim.cli.common import Commands, Progress


def add_parser(commands: Commands) -> argparse.ArgumentParser:
    """Add the command and its options."""
    command = commands.add_parser("papers", help="test the claims of five papers")
    command.add_argument("name", nargs="*", help="cubature, adaptive_ins, fuzzy, emitter, switched (default: all)")
    command.add_argument("--quick", action="store_true", help="make few runs, as a trial")
    command.add_argument("--json", action="store_true", help="print JSON")
    command.add_argument("--markdown", type=Path, metavar="FILE", help="write results into the page docs/papers.md")
    return command


def run(arguments: argparse.Namespace) -> None:
    """Run the experiments of the papers and print what comes out."""
    from ahrs_sim import papers
    from ahrs_sim.runs import pool as pools

    chosen = arguments.name or papers.names()
    for name in chosen:
        papers.title(name)  # a misspelt one is reported before anything runs
    done = []
    progress = Progress("papers", unit="done", hidden=arguments.json)
    for result in papers.run_all(chosen, arguments.quick, pools.workers_here()):
        done.append(result)
        progress(len(done), len(chosen))
        if not arguments.json:
            Progress.clear()
            print(result.text(), end="\n\n", flush=True)
    Progress.clear()
    if arguments.json:
        print(json.dumps([result.as_json() for result in done], indent=1))
    if arguments.markdown:
        page = arguments.markdown.read_text(encoding="utf-8") if arguments.markdown.exists() else ""
        arguments.markdown.write_text(papers.markdown(done, page), encoding="utf-8")
