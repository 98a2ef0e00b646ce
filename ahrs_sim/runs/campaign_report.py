"""Report of a campaign, from its data set: distributions, paired differences, sensitivities, bands, worst runs."""

import io
import math
from collections import Counter
from typing import Any

import numpy as np

from ahrs_sim.errors import InputError, nearest
from ahrs_sim.evaluation import metrics, paired
from ahrs_sim.evaluation.phases import PHASES
from ahrs_sim.runs.campaign import Store

METRIC = "tilt_rmse_deg"
FIGURES = ("tilt_rmse_deg", "heading_rmse_deg", "total_rmse_deg", "tilt_max_deg")
WORST = 5
_ROWS = 15  # lines of a table over time


def make(
    store: Store, metric: str = METRIC, *, against: str | None = None, worst_of: str | None = None
) -> dict[str, Any]:
    """Make the report as plain data for JSON; None: not known.

    Args:
        store: of the campaign.
        metric: the column by which runs are called bad.
        against: the estimator from which differences of the others are taken; None: the one with the least `metric`.
        worst_of: the estimator by which runs are called bad; None: whichever has the largest `metric`.

    Raises:
        InputError: no campaign there, or none of its runs has `against`.
    """
    plan = store.plan()
    names = store.column_names()
    varied = [n for n in names if n.startswith("vary.")]
    wanted = dict.fromkeys(["run", "estimator", "error", *varied, *FIGURES, metric, "nees", "nis"])
    table = store.table(list(wanted)).to_pydict()
    columns = {name: np.array(values, dtype=_kind(name, values)) for name, values in table.items()}
    failed = np.array([e is not None for e in table.get("error", [])], bool)
    estimators = sorted({e for e in table.get("estimator", []) if e is not None})
    report: dict[str, Any] = {
        "campaign": plan.name,
        "runs": len(set(table["run"])),
        "of": plan.runs,
        "failed": int(failed.sum()),
        "errors": Counter(e for e in table.get("error", []) if e is not None).most_common(5),
        "band_s": plan.band_s,
        "metric": metric,
        "estimators": {},
    }
    for estimator in estimators:
        rows = columns["estimator"] == estimator
        own = {name: values[rows] for name, values in columns.items()}
        report["estimators"][estimator] = {
            "runs": int(rows.sum()),
            "distribution": {f: _distribution(own[f]) for f in dict.fromkeys([*FIGURES, metric]) if f in own},
            "consistency": {f: _distribution(own[f]) for f in ("nees", "nis") if f in own},
            "sensitivity": {v[5:]: _sensitivity(own[v], own) for v in varied if own[v].dtype.kind in "fb"},
            "bands": {m: _bands(store, estimator, f"bands.{m}") for m in ("tilt", "heading") if f"bands.{m}" in names},
        }
    if against is not None and estimators and against not in estimators:
        raise InputError(f"{store.place}: no estimator '{against}'{nearest(against, estimators)}")
    against = against or _least(report["estimators"], metric)
    if against is not None and len(estimators) > 1:
        report["paired"] = {"against": against, "estimators": _paired(columns, estimators, against, metric)}
    report["worst_of"] = worst_of
    report["worst"] = [
        {
            "run": run,
            "estimator": estimator,
            metric: value if math.isfinite(value) else None,
            "fly": f"ahrs-sim fly --from {store.place} --run {run}",
        }
        for run, estimator, value in worst(columns, metric, WORST, worst_of)
    ]
    return report


def _least(estimators: dict[str, Any], metric: str) -> str | None:
    """Find the estimator whose metric is the least on average."""
    means = {name: values["distribution"].get(metric, {}).get("mean") for name, values in estimators.items()}
    known = {name: mean for name, mean in means.items() if mean is not None}
    return min(known, key=lambda name: known[name]) if known else None


def _paired(columns: dict[str, np.ndarray], estimators: list[str], against: str, metric: str) -> dict[str, Any]:
    """Differences of every estimator from `against` in the same runs, by figure."""
    runs, place = np.unique(columns["run"], return_inverse=True)
    found: dict[str, Any] = {name: {} for name in estimators if name != against}
    for figure in dict.fromkeys([*FIGURES[:2], metric]):
        if figure not in columns:
            continue
        by_name = {name: np.full(len(runs), np.nan) for name in estimators}
        for name, values in by_name.items():
            own = columns["estimator"] == name
            values[place[own]] = columns[figure][own]
        for name in found:
            difference = paired.over_runs(by_name[name], by_name[against])
            found[name][figure] = difference and difference.plain()
    return found


def _kind(name: str, values: list[Any]) -> Any:
    if name == "run":
        return np.int64
    return object if any(isinstance(v, str) for v in values) or name in ("estimator", "error") else float


def _distribution(values: np.ndarray) -> dict[str, float | None]:
    """Compute mean, quantiles and maximum of the finite values; count the others."""
    finite = values[np.isfinite(values)]
    result: dict[str, float | None] = dict.fromkeys(("mean", "p5", "p50", "p95", "max"))
    if len(finite):
        quantiles = (float(q) for q in np.percentile(finite, (5, 50, 95)))
        result |= {"mean": float(finite.mean()), "max": float(finite.max())}
        result |= zip(("p5", "p50", "p95"), quantiles, strict=True)
    return {**result, "unknown": float(len(values) - len(finite))}


def _sensitivity(values: np.ndarray, own: dict[str, np.ndarray]) -> dict[str, dict[str, float | None]]:
    """Compute Spearman's rank correlation of a varied value with the errors, and its p-value."""
    from scipy.stats import spearmanr

    result: dict[str, dict[str, float | None]] = {}
    for figure in ("tilt_rmse_deg", "heading_rmse_deg"):
        if figure not in own:
            continue
        known = np.isfinite(values.astype(float)) & np.isfinite(own[figure])
        a, b = values[known].astype(float), own[figure][known]
        if len(a) > 2 and np.ptp(a) > 0 and np.ptp(b) > 0:
            found = spearmanr(a, b)
            result[figure] = {"rho": float(found.statistic), "p": float(found.pvalue)}
        else:
            result[figure] = {"rho": None, "p": None}
    return result


def _bands(store: Store, estimator: str, column: str) -> dict[str, list[float | None]]:
    """Median and 2.5 to 97.5 % of the error over the runs, for each span of time."""
    import pyarrow.compute as pc

    table = store.table(["estimator", column])
    lists = table.filter(pc.equal(table["estimator"], estimator))[column].to_pylist()
    lists = [x for x in lists if x]
    width = max(map(len, lists), default=0)
    errors = np.full((len(lists), width), np.nan)
    for row, values in zip(errors, lists, strict=True):
        row[: len(values)] = values
    known = np.isfinite(errors).any(axis=0)
    bands: dict[str, list[float | None]] = {}
    for name, quantile in (("low", 2.5), ("median", 50.0), ("high", 97.5)):
        line: list[float | None] = [None] * width
        for i in np.flatnonzero(known):
            line[i] = float(np.nanpercentile(errors[:, i], quantile))
        bands[name] = line
    return bands


def worst(
    columns: dict[str, np.ndarray], metric: str, count: int, of: str | None = None
) -> list[tuple[int, str | None, float]]:
    """Find the runs with the largest value of a metric, worst first.

    Args:
        columns: run, estimator and the metric.
        metric: a column.
        count: of runs.
        of: the estimator that counts; None: any.

    Returns:
        Run, estimator (None: the run failed) and value (then infinite) of each.
    """
    value: dict[int, tuple[float, str | None]] = {}
    figures = columns.get(metric, np.full(len(columns["run"]), np.nan))
    for run, estimator, figure in zip(columns["run"], columns["estimator"], figures, strict=True):
        bad = math.inf if estimator is None else float(figure)
        if math.isnan(bad) or (of is not None and estimator not in (None, of)):
            continue
        if int(run) not in value or bad > value[int(run)][0]:
            value[int(run)] = bad, estimator
    order = sorted(value.items(), key=lambda item: (-item[1][0], item[0]))
    return [(run, estimator, bad) for run, (bad, estimator) in order[:count]]


def worst_runs(store: Store, metric: str, count: int, of: str | None = None) -> list[int]:
    """Find the numbers of the worst runs of a campaign; see `worst`.

    Raises:
        InputError: the metric is no column of it.
    """
    names = store.column_names()
    if metric not in names and "availability" in names:  # else every run has failed
        raise InputError(f"--metric {metric}: not in {store.place}{nearest(metric, names)}")
    table = store.table(["run", "estimator", metric]).to_pydict()
    columns = {name: np.array(values, dtype=_kind(name, values)) for name, values in table.items()}
    return [run for run, _, _ in worst(columns, metric, count, of)]


def check_metric(metric: str) -> None:
    """Check that a flight has a figure of this name, before anything is flown.

    Raises:
        InputError: it has not.
    """
    of_angles = [f"{m}_{s}_deg" for m in metrics.MEASURES for s in metrics.STATISTICS]
    phase, dot, figure = metric.rpartition(".")
    if figure in of_angles and (not dot or phase in PHASES):
        return
    known = [*of_angles, "availability", "nees", "nis"]
    if metric not in known:
        raise InputError(f"--metric {metric}: no such figure{nearest(metric, known)} (or PHASE. before it)")


def text(report: dict[str, Any]) -> str:
    """Format the report for a reader."""
    out = io.StringIO()
    print(f"{report['campaign']}: {report['runs']} of {report['of']} runs, {report['failed']} failed", file=out)
    for error, count in report["errors"]:
        print(f"  {count} x {error}", file=out)
    estimators = report["estimators"]
    width = max(12, *(len(e) + 2 for e in estimators)) if estimators else 12
    for figure in dict.fromkeys(f for e in estimators.values() for f in e["distribution"]):
        heads = "".join(f"{h:>9s}" for h in ("mean", "p5", "p50", "p95", "max"))
        print(f"\n{figure} over runs\n{'':{width}s}{heads}", file=out)
        for name, values in estimators.items():
            print(f"{name:{width}s}{_cells(values['distribution'].get(figure, {}))}", file=out)
    if "paired" in report:
        _differences(report["paired"], width, out)
    if estimators:
        print("\nNEES and NIS per degree of freedom, mean of a run (1: consistent; above 1: overconfident)", file=out)
        print(f"{'':{width}s}{'NEES p50':>9s}{'p95':>9s}{'NIS p50':>9s}{'p95':>9s}", file=out)
    for name, values in estimators.items():
        pairs = [values["consistency"].get(f, {}).get(q) for f in ("nees", "nis") for q in ("p50", "p95")]
        print(f"{name:{width}s}" + "".join(_number(x) for x in pairs), file=out)
    _sensitivities(estimators, width, out)
    _over_time(report, width, out)
    if report["worst"]:
        print(f"\nworst runs by {report['metric']} of {report['worst_of'] or 'any estimator'}", file=out)
        for row in report["worst"]:
            value = row[report["metric"]]
            cell = "  failed" if value is None else f"{value:8.3f}"
            print(f"  {row['run']:6d} {cell}  {row['estimator'] or '':{width - 2}s} {row['fly']}", file=out)
    return out.getvalue().rstrip()


def _differences(found: dict[str, Any], width: int, out: io.StringIO) -> None:
    for figure in dict.fromkeys(f for values in found["estimators"].values() for f in values):
        print(f"\n{figure} less that of {found['against']} on the same seeds (negative: better)", file=out)
        print(f"{'':{width}s}{'mean':>9s}{'95 % from':>11s}{'to':>9s}{'smaller in':>15s}", file=out)
        for name, values in found["estimators"].items():
            if (d := values[figure]) is None:
                print(f"{name:{width}s}{'-':>9s}   in no run both have one", file=out)
                continue
            few = f"; {paired.FEWEST} runs are the least that can tell" if d["low"] is None else ""
            count = f"{d['smaller']} of {d['pairs']}"
            span = f"{_number(d['low'])[1:]:>11s}{_number(d['high'])}"
            print(f"{name:{width}s}{d['change']:+9.3f}{span}{count:>15s}  {d['result']}{few}", file=out)


def _sensitivities(estimators: dict[str, Any], width: int, out: io.StringIO) -> None:
    keys = dict.fromkeys(k for e in estimators.values() for k in e["sensitivity"])
    if not keys:
        return
    print("\nsensitivity: rank correlation of the error with what was varied, tilt and heading (*: p < 0.01)", file=out)
    longest = max(len(k) for k in keys) + 2
    print(f"{'':{longest}s}" + "".join(f"{name:>{width + 4}s}" for name in estimators), file=out)
    for key in keys:
        cells = []
        for values in estimators.values():
            found = values["sensitivity"].get(key, {})
            pair = [found.get(f, {"rho": None, "p": None}) for f in ("tilt_rmse_deg", "heading_rmse_deg")]
            cell = " ".join(
                "-" if x["rho"] is None else f"{x['rho']:+.2f}{'*' if x['p'] < 0.01 else ' '}" for x in pair
            )
            cells.append(f"{cell:>{width + 4}s}")
        print(f"{key:{longest}s}" + "".join(cells), file=out)


def _over_time(report: dict[str, Any], width: int, out: io.StringIO) -> None:
    estimators = report["estimators"]
    length = max((len(e["bands"].get("tilt", {}).get("median", [])) for e in estimators.values()), default=0)
    if not length:
        return
    print("\ntilt error over time, deg: median (97.5 %) over runs", file=out)
    print(f"{'from s':>8s}" + "".join(f"{name:>{width + 8}s}" for name in estimators), file=out)
    for i in range(0, length, max(1, math.ceil(length / _ROWS))):
        cells = []
        for values in estimators.values():
            bands = values["bands"]["tilt"]
            known = i < len(bands["median"]) and bands["median"][i] is not None
            cell = f"{_number(bands['median'][i])} ({_number(bands['high'][i]).strip()})" if known else "-"
            cells.append(f"{cell:>{width + 8}s}")
        print(f"{i * report['band_s']:8.0f}" + "".join(cells), file=out)


def drawn(report: dict[str, Any]) -> bytes | None:
    """Draw 95 % bands over time and distributions over runs as a PNG; None without matplotlib or anything to draw."""
    try:
        from matplotlib.figure import Figure
        from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
    except ImportError:
        return None
    estimators = report["estimators"]
    if not estimators:
        return None
    figure = Figure((12, 8), layout="constrained")
    axes = figure.subplots(2, 2, width_ratios=(2, 1))
    for row, measure in enumerate(("tilt", "heading")):
        over_time, over_runs = axes[row]
        for k, (name, values) in enumerate(estimators.items()):
            bands = {q: np.array(v, float) for q, v in values["bands"].get(measure, {}).items()}
            if bands:
                t = (np.arange(len(bands["median"])) + 0.5) * report["band_s"]
                over_time.plot(t, bands["median"], color=f"C{k}", label=name)
                over_time.fill_between(t, bands["low"], bands["high"], color=f"C{k}", alpha=0.15, linewidth=0)
            spread = values["distribution"].get(f"{measure}_rmse_deg", {})
            if spread.get("p50") is not None:
                over_runs.plot([spread["p5"], spread["p95"]], [k, k], color=f"C{k}", linewidth=6, alpha=0.3)
                over_runs.plot(spread["p50"], k, "|", color=f"C{k}", markersize=14, markeredgewidth=2)
                over_runs.plot(spread["max"], k, ".", color=f"C{k}")
        over_time.set(ylabel=f"{measure} error, deg", xlabel="s" if row else None)
        over_runs.set(yticks=range(len(estimators)), yticklabels=list(estimators))
        over_runs.set(xlabel=f"{measure} RMSE of a run, deg")
        over_runs.invert_yaxis()
        if any((np.asarray(line.get_ydata()) > 0).any() for line in over_time.lines):
            over_time.set_yscale("log")
        if any((np.asarray(line.get_xdata()) > 0).any() for line in over_runs.lines):  # else nothing has aligned
            over_runs.set_xscale("log")
            over_runs.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=6))
            over_runs.xaxis.set_major_formatter(FormatStrFormatter("%g"))
            over_runs.xaxis.set_minor_formatter(NullFormatter())
        for ax in (over_time, over_runs):
            ax.grid(alpha=0.3)
    axes[0, 0].set_title(f"{report['campaign']}: median and 95 % of {report['runs']} runs")
    axes[0, 1].set_title("p5 to p95, median, maximum")
    if axes[0, 0].get_legend_handles_labels()[0]:
        axes[0, 0].legend(loc="upper left", fontsize="small")
    picture = io.BytesIO()
    figure.savefig(picture, dpi=110, metadata={"Software": None})
    return picture.getvalue()


def _cells(values: dict[str, float | None]) -> str:
    return "".join(_number(values.get(k)) for k in ("mean", "p5", "p50", "p95", "max"))


def _number(value: float | None) -> str:
    if value is None:
        return f"{'-':>9s}"
    return f"{value:9.3f}" if abs(value) < 999 else f"{value:9.3g}"
