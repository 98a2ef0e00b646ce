"""The command line: `ahrs-sim COMMAND ...`, what each command does. Every one imports only what it uses."""

import argparse
import contextlib
import json
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ahrs_sim.arguments import parser
from ahrs_sim.errors import AhrsSimError, FlightError, InputError
from estimators.errors import EstimationError

if TYPE_CHECKING:
    from ahrs_sim.log.live import Live


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 1 a flight or check failed, 2 bad input, 130 stopped."""
    arguments = parser().parse_args(argv)
    try:
        return int(_COMMANDS[arguments.command](arguments) or 0)
    except AhrsSimError as error:
        print(f"ahrs-sim: {error}", file=sys.stderr)
        return error.exit_code
    except EstimationError as error:
        print(f"ahrs-sim: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("ahrs-sim: stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:  # `ahrs-sim info LOG | head`
        sys.stderr.close()
        return 0


def _fly(arguments: argparse.Namespace) -> int:
    from ahrs_sim import scenario as scenarios

    if (arguments.campaign is None) != (arguments.number is None) or (arguments.campaign and arguments.scenario):
        raise InputError("fly: give a scenario, or --from DIR and --run N")
    if arguments.campaign is not None:
        from ahrs_sim.runs.campaign import scenario_of

        changed = (arguments.seed, arguments.duration, arguments.pilot)
        if arguments.estimator or any(value is not None for value in changed):
            raise InputError("fly: --from repeats a run as it was; leave --seed, --duration, --estimator, --pilot out")
        scenario = scenario_of(arguments.campaign, arguments.number)
    elif arguments.scenario is None:
        raise InputError("fly: no scenario given; see ahrs-sim list scenarios")
    else:
        scenario = scenarios.load(
            arguments.scenario,
            seed=arguments.seed,
            duration=arguments.duration,
            estimators=arguments.estimator,
            pilot=arguments.pilot,
        )
    output = arguments.output or Path("logs") / f"{scenario.name}-seed{scenario.seed}.mcap"
    if output.exists() and not arguments.force:
        raise InputError(f"{output}: exists; give another -o or --force")
    if arguments.output is None:
        output.parent.mkdir(exist_ok=True)

    from ahrs_sim.flight import BLOCK_S

    stop: list[int] = []
    live = _live(arguments, lambda: bool(stop))
    block_s = arguments.block or BLOCK_S
    flight = None
    if scenario.pilot_attitude == "truth":  # flies on while the estimators are being loaded
        from ahrs_sim.flight.ahead import FlightAhead

        flight = FlightAhead(scenario, max(1, round(block_s * scenario.rate)))
    from ahrs_sim import pipeline
    from ahrs_sim.review import compare

    if not arguments.quiet:
        for note in scenario.notes:
            print(f"ahrs-sim: {note}", file=sys.stderr)
    judge = compare.Judge([e.name for e in scenario.estimators])
    failure: FlightError | None = None
    previous = signal.signal(signal.SIGINT, lambda *_: stop.append(1))
    try:
        pipeline.fly(
            scenario,
            output,
            judge=judge,
            force=arguments.force,
            block_s=block_s,
            flight=flight.ready() if flight else None,
            live=live,
            progress=_Progress(f"flying {scenario.name}", hidden=arguments.quiet or arguments.json),
            stopped=lambda: bool(stop),
        )
    except FlightError as error:
        failure = error  # the accuracy up to there comes first
    finally:
        signal.signal(signal.SIGINT, previous)
        _Progress.clear()
        if live:
            live.close()
    if not arguments.quiet:
        result = {"log": str(output), **judge.result()}
        if arguments.json:
            print(json.dumps(result, indent=1))
        else:
            print(*([compare.table(result)] if scenario.estimators else []), output, sep="\n")
    if failure:
        raise failure
    return 130 if stop else 0


def _live(arguments: argparse.Namespace, stopped: Callable[[], bool] = lambda: False) -> "Live | None":
    """The server that `--live` asks for."""
    if arguments.live is None:
        return None
    from ahrs_sim.log.live import Live

    live = Live(arguments.live, arguments.rate, stopped)
    print(f"live at ws://localhost:{live.port} (Foxglove: Open connection, Foxglove WebSocket)", file=sys.stderr)
    return live


def _replay(arguments: argparse.Namespace) -> None:
    import tempfile

    from ahrs_sim import replay

    changed = arguments.map or arguments.calibrate or arguments.sync or arguments.align
    if not (arguments.output or changed or arguments.live is not None) and _judge(arguments):
        return
    live = _live(arguments)
    with live or contextlib.nullcontext(), tempfile.TemporaryDirectory(prefix="ahrs_sim-") as folder:
        output = arguments.output or Path(folder) / arguments.log.with_suffix(".mcap").name
        notes = replay.replay(
            arguments.log,
            output,
            estimators=arguments.estimator,
            map_file=arguments.map,
            calibrate=arguments.calibrate,
            sync=arguments.sync,
            only_estimates=arguments.output is None and live is None,
            force=arguments.force,
            live=live,
            progress=_Progress(f"replaying {arguments.log.name}", hidden=arguments.json),
        )
        _Progress.clear()
        if notes and not arguments.json:
            print("\n".join(notes), end="\n\n")
        result = replay.accuracy(output, start=arguments.start, end=arguments.end, align=arguments.align)
    if result is None:
        print("no truth and no reference attitude in it: nothing to compare with", file=sys.stderr)
        return
    from ahrs_sim.review import compare

    result["log"] = str(arguments.output or arguments.log)
    print(json.dumps(result, indent=1) if arguments.json else compare.table(result))
    if arguments.output and not arguments.json:
        print(arguments.output)


def _judge(arguments: argparse.Namespace) -> bool:
    """Print how good estimators are on a log of ours, of which nothing has to be kept; false: not a log of ours."""
    from ahrs_sim import replay

    result = replay.judge(
        arguments.log,
        estimators=arguments.estimator,
        start=arguments.start,
        end=arguments.end,
        progress=_Progress(f"replaying {arguments.log.name}", hidden=arguments.json),
    )
    if result is None:
        return False
    from ahrs_sim.review import compare

    _Progress.clear()
    print(json.dumps(result, indent=1) if arguments.json else compare.table(result))
    return True


def _compare(arguments: argparse.Namespace) -> None:
    from ahrs_sim.review import compare

    span = {"reference": arguments.reference, "start": arguments.start, "end": arguments.end}
    results = [compare.compare(log, **span, align=arguments.align, sync=arguments.sync) for log in arguments.log]
    texts = [compare.table(result) for result in results]
    if arguments.lag:
        from ahrs_sim.review import lag

        for i, path in enumerate(arguments.log):
            late = lag.of_log(path, **span)
            texts[i] += f"\n\n{lag.table(late)}"
            for name, values in late.items():
                results[i]["estimators"][name] |= values
    if arguments.json:
        print(json.dumps(results[0] if len(results) == 1 else results, indent=1))
    elif arguments.csv:
        first, *rest = (compare.csv(result) for result in results)
        print("\n".join([first, *(text.partition("\n")[2] for text in rest)]))
    else:
        titles = [f"{log}\n" if len(results) > 1 else "" for log in arguments.log]
        print("\n\n".join(title + text for title, text in zip(titles, texts, strict=True)))
    if arguments.report or arguments.png:
        _draw(arguments, span | {"align": arguments.align, "sync": arguments.sync})


def _draw(arguments: argparse.Namespace, span: dict[str, Any]) -> None:
    from ahrs_sim.review import report, traces

    flights = [traces.gather(log, **span) for log in arguments.log]
    if arguments.report:
        size = report.write(flights, arguments.report)
        print(f"{arguments.report}: {size / 1e6:.1f} MB", file=sys.stderr)
    if arguments.png:
        from ahrs_sim.review import figures

        for flight in flights:
            print(*figures.draw(flight, arguments.png), sep="\n", file=sys.stderr)


def _export(arguments: argparse.Namespace) -> None:
    from ahrs_sim.review.export import export

    if arguments.form == "layout":
        from ahrs_sim.log import layouts

        print(layouts.of_log(arguments.log, arguments.output or arguments.log.with_suffix(".layout.json")))
        return
    folder = arguments.output or arguments.log.with_suffix("")
    print(*export(arguments.log, arguments.form, folder, arguments.topic), sep="\n")


def _info(arguments: argparse.Namespace) -> None:
    from ahrs_sim.log import info

    print(json.dumps(info.summary(arguments.log), indent=1) if arguments.json else info.text(arguments.log))


def _recover(arguments: argparse.Namespace) -> None:
    from ahrs_sim.log.mcap.recover import recover

    result = recover(arguments.part, arguments.output, force=arguments.force)
    print(f"{arguments.output}: {result}")


def _allan(arguments: argparse.Namespace) -> None:
    from ahrs_sim.review import allan

    result = allan.of_log(arguments.log, topics=arguments.topic)
    print(json.dumps(allan.as_json(result), indent=1) if arguments.json else allan.text(result))
    if arguments.plot:
        allan.plot(result, arguments.plot)


def _check(arguments: argparse.Namespace) -> int:
    from ahrs_sim.runs import check

    if arguments.renew != bool(arguments.why):
        raise InputError("check: --renew and --why TEXT go together: a baseline changes for a reason")
    suite = check.load(arguments.suite)
    progress = _Progress(f"flying {suite.name}", unit="flights", hidden=arguments.json)
    found = check.fly(suite, workers=arguments.workers, progress=progress)
    _Progress.clear()
    if arguments.renew:
        check.renew(suite, found, arguments.why)
        print(f"{suite.baseline}: renewed")
        return 0
    result = check.judge(suite, found)
    if arguments.junit:
        arguments.junit.write_text(check.junit(result), encoding="utf-8")
    if arguments.json:
        print(json.dumps(check.as_json(result), indent=1))
    else:
        print(check.markdown(result) if arguments.markdown else check.table(result, everything=arguments.all))
    return 0 if result.passed else 1


def _campaign(arguments: argparse.Namespace) -> int:
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.runs import campaign, campaign_report, tuning
    from ahrs_sim.runs import pool as runs

    scenario = scenarios.load(
        arguments.scenario, seed=arguments.seed, duration=arguments.duration, estimators=arguments.estimator
    )
    plan = campaign.Plan.make(scenario, arguments.runs, arguments.vary)
    keep = _worst(arguments.keep_logs, arguments.runs)
    hidden = arguments.quiet or arguments.json
    if arguments.tune:
        knobs = [tuning.Knob.read(text, scenario) for text in arguments.tune]
        with runs.pool(arguments.workers, arguments.scheduler) as pool:
            progress = _Progress("tuning", unit="trials", hidden=hidden)
            tuned = tuning.tune(plan, knobs, arguments.metric, pool, progress=progress)
        _Progress.clear()
        print(json.dumps(vars(tuned), indent=1) if arguments.json else tuned.text())
        return 0
    if arguments.output is None:
        raise InputError("campaign: -o DIR is missing: where the results go")
    store = campaign.Store(arguments.output)
    if keep and store.remote:
        raise InputError("--keep-logs needs a local -o; fly single runs with ahrs-sim fly --from DIR --run N")
    with runs.pool(arguments.workers, arguments.scheduler) as pool:
        campaign.fly(plan, store, pool, _Progress(f"flying {plan.name}", unit="runs", hidden=hidden))
    if keep:
        worst = campaign_report.worst_runs(store, arguments.metric, keep)
        with runs.local_pool(arguments.workers) as pool:  # the workers of a cluster may not see this disk
            for _ in campaign.keep_logs(plan, worst, Path(arguments.output) / "logs", pool):
                pass  # runs that fail leave a log up to there
    _Progress.clear()
    report = campaign_report.make(store, arguments.metric)
    text = campaign_report.text(report)
    store.write("report.json", json.dumps(report, indent=1).encode())
    store.write("report.txt", f"{text}\n".encode())
    if picture := campaign_report.drawn(report):
        store.write("report.png", picture)
    if not arguments.quiet:
        print(json.dumps(report, indent=1) if arguments.json else text)
    return 0 if report["failed"] < report["runs"] else 1


def _worst(text: str | None, runs: int) -> int:
    """How many logs `--keep-logs` asks for."""
    if text is None:
        return 0
    if text == "all":
        return runs
    kind, _, count = text.partition(":")
    if kind != "worst" or not count.isdigit():
        raise InputError(f"--keep-logs {text}: write worst:N or all")
    return int(count)


def _budget(arguments: argparse.Namespace) -> None:
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.runs import budget

    scenario = scenarios.load(arguments.scenario, seed=arguments.seed, duration=arguments.duration)
    unit = "s" if arguments.seeds == 1 else "flights"
    made = budget.make(
        scenario,
        arguments.estimator,
        suite=arguments.suite,
        seeds=arguments.seeds,
        start=arguments.start,
        end=arguments.end,
        workers=arguments.workers,
        progress=_Progress(f"budget of {arguments.estimator}", unit=unit, hidden=arguments.json),
    )
    _Progress.clear()
    print(json.dumps(made.as_json(), indent=1) if arguments.json else made.text())
    if arguments.png:
        made.plot(arguments.png)


def _papers(arguments: argparse.Namespace) -> None:
    from ahrs_sim import papers
    from ahrs_sim.runs import pool as runs

    chosen = arguments.name or papers.names()
    for name in chosen:
        papers.title(name)  # a misspelt one is said before anything runs
    done = []
    progress = _Progress("papers", unit="done", hidden=arguments.json)
    for result in papers.run_all(chosen, arguments.quick, runs.workers_here()):
        done.append(result)
        progress(len(done), len(chosen))
        if not arguments.json:
            _Progress.clear()
            print(result.text(), end="\n\n", flush=True)
    _Progress.clear()
    if arguments.json:
        print(json.dumps([result.as_json() for result in done], indent=1))
    if arguments.markdown:
        arguments.markdown.write_text(papers.markdown(done), encoding="utf-8")


def _list(arguments: argparse.Namespace) -> None:
    rows = _LISTS[arguments.what]()
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    table = [[str(v) for v in row.values() if not isinstance(v, dict)] for row in rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for cells in table:
        print("  ".join(f"{cell:{width}s}" for cell, width in zip(cells, widths, strict=True)).rstrip())


_COMMANDS: dict[str, Callable[[argparse.Namespace], int | None]] = {
    "fly": _fly,
    "replay": _replay,
    "compare": _compare,
    "info": _info,
    "export": _export,
    "recover": _recover,
    "allan": _allan,
    "list": _list,
    "check": _check,
    "campaign": _campaign,
    "budget": _budget,
    "papers": _papers,
}


def _scenarios() -> list[dict[str, Any]]:
    from ahrs_sim import scenario as scenarios
    from ahrs_sim.scenario.shipped import scenario_dir

    loaded = [scenarios.load(str(path)) for path in sorted(scenario_dir().glob("*.toml"))]
    return [{"name": s.name, "title": s.data.get("title", "")} for s in loaded]


def _aircraft() -> list[dict[str, Any]]:
    from ahrs_sim.flight.fdm import aircraft
    from ahrs_sim.scenario.shipped import aircraft_dir

    ours = aircraft_dir()
    return [{"name": n, "from": "ahrs_sim" if ours in p.parents else "JSBSim"} for n, p in aircraft().items()]


def _grades() -> list[dict[str, Any]]:
    from ahrs_sim import sensors

    return sensors.grades()


def _estimators() -> list[dict[str, Any]]:
    import estimators

    return [
        {
            "name": m.name,
            "source": m.source if m.installed else f"{m.source}; '{m.package}' is not installed",
            "text": m.text,
            "settings": {k: v.default for k, v in m.settings.items()},
        }
        for m in estimators.describe()
    ]


def _layouts() -> list[dict[str, Any]]:
    from ahrs_sim.log import layouts

    return layouts.describe()


_LISTS = {
    "scenarios": _scenarios,
    "aircraft": _aircraft,
    "grades": _grades,
    "estimators": _estimators,
    "layouts": _layouts,
}


class _Progress:
    """A bar on the terminal for whatever takes longer than two seconds; nothing when stderr is not one."""

    def __init__(self, title: str, *, unit: str = "s", hidden: bool = False) -> None:
        import time

        self.title, self.unit = title, unit
        self.hidden = hidden or not sys.stderr.isatty()
        self.clock = time.monotonic
        self.begun = self.clock()
        self.drawn = self.begun + 1.8
        self.first: float | None = None  # how much had been done before, when a campaign goes on

    def __call__(self, t: float, end: float | None) -> None:
        now = self.clock()
        if self.first is None:
            self.first, self.begun = t, now
        if self.hidden or now - self.drawn < 0.2:
            return
        self.drawn = now
        done = min(1.0, t / end) if end else 0.0
        bar = f"[{'#' * round(30 * done):30s}] {100 * done:3.0f} %" if end else ""
        left = ""
        if end and t > self.first:
            left = f", {(now - self.begun) * (end - t) / (t - self.first):.0f} s left "
        print(f"\r{self.title} {bar} {t:6.0f} {self.unit}{left}", end="", file=sys.stderr, flush=True)

    @staticmethod
    def clear() -> None:
        if sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
