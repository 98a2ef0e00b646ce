// The page: files in, a table and plots out. Nothing leaves it.

const $ = (id) => document.getElementById(id), root = document.documentElement;
const css = (name) => getComputedStyle(root).getPropertyValue(name).trim();
const element = (tag, properties = {}, ...children) => {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
};
const DEG = 180 / Math.PI, digits = (x) => (x === null || x === undefined || !Number.isFinite(x) ? "–" : x >= 99.95 ? x.toFixed(0) : x >= 9.995 ? x.toFixed(1) : x.toFixed(2));
let results = [], recording = null, view = null, plots = [], running = false;

async function say(what, share) {
  $("status").textContent = what;
  $("progress").hidden = share === undefined;
  if (share !== undefined) $("progress").value = share;
  await new Promise((resolve) => setTimeout(resolve)); // lets the page draw
}

async function run(files) {
  if (running || !files.length) return;
  running = true;
  $("trouble").hidden = true;
  delete root.dataset.ready;
  try {
    await say(`reading ${files[0].name}`, 0);
    recording = await read([...files], say);
    const plan = planned(recording), rows = {};
    for (const suite of new Set(plan.map((e) => e.suite))) { await say(`merging the sensors of ${suite}`, 0); rows[suite] = assemble(recording.suites[suite]); }
    const total = plan.reduce((sum, e) => sum + rows[e.suite].length / data.sample.size, 0);
    let done = 0, said = 0;
    results = [];
    for (const e of plan) {
      const estimates = await estimate(e, rows[e.suite], recording.site, recording.sensors[e.suite], async (count) => {
        done += count;
        if (done - said > 4000) { said = done; await say(`${e.label}`, done / total); }
      });
      const { errors, angles } = compared(estimates, recording.reference);
      results.push({ ...e, ...estimates, errors, angles, figures: errors ? summary(errors) : {}, shown: true, index: results.length, color: () => data.colors[data.estimators.indexOf(data.estimators.find((x) => x.name === e.name)) % data.colors.length][root.dataset.theme === "dark" ? 1 : 0] });
      delete results.at(-1).q_nb;
    }
    show();
    await say(`${recording.name}: ${recording.form}, ${(results[0].t.at(-1) - results[0].t[0]).toFixed(1)} s, ${results.length} estimators in this browser`);
    root.dataset.ready = "yes";
  } catch (error) {
    $("trouble").textContent = error instanceof RangeError ? `${files[0].name}: damaged, or not complete (${error.message})` : error.message;
    $("trouble").hidden = false;
    await say("");
    root.dataset.ready = "no";
  } finally {
    running = false;
  }
}

function show() {
  $("result").hidden = $("plots").hidden = false;
  view = whole();
  $("notes").replaceChildren(...recording.notes.map((line) => element("li", { textContent: line })));
  $("versus").textContent = recording.reference
    ? `Errors: root mean square in deg against ${recording.reference.label === "truth" ? "the truth" : `the recording's ${recording.reference.label}`}, over the whole recording.`
    : "There is no reference attitude in this recording, so there are no errors.";
  table();
  draw();
}

const whole = () => [Math.min(...results.map((r) => r.t[0])), Math.max(...results.map((r) => r.t.at(-1)))];

function table() {
  const columns = ["tilt", "roll", "pitch", "heading", "total"], ordered = [...results].sort((p, q) => (p.figures.tilt_rmse_deg ?? Infinity) - (q.figures.tilt_rmse_deg ?? Infinity) || p.index - q.index);
  const best = Object.fromEntries(columns.map((c) => [c, Math.min(...results.map((r) => r.figures[`${c}_rmse_deg`] ?? Infinity))]));
  $("table").replaceChildren(
    element("thead", {}, element("tr", {}, ...["estimator", ...columns, "available", "µs a row"].map((text) => element("th", { textContent: text, scope: "col", title: { available: "share of the rows with an attitude", "µs a row": "time that the estimator takes for a row, in this browser" }[text] ?? "" })))),
    element("tbody", {}, ...ordered.map((r) => {
      const dot = element("span", { className: "dot" }), box = element("input", { type: "checkbox", checked: r.shown });
      dot.style.background = r.color();
      box.onchange = () => { r.shown = box.checked; draw(); };
      const known = Array.from(r.angles[0]).filter(Number.isFinite).length / Math.max(r.n, 1);
      const why = r.failed ? `stopped: ${r.failed}` : known === 0 ? "no attitude: never aligned; it needs its sensors, and a minute at rest or motion" : "";
      return element("tr", { className: "first" }, element("td", {}, element("label", { title: `${r.text}${why ? `; ${why}` : ""}` }, box, " ", dot, r.label)),
        ...columns.map((c) => element("td", { className: r.figures[`${c}_rmse_deg`] === best[c] ? "best" : "", title: r.figures[`${c}_rmse_deg`] ? `${r.figures[`${c}_rmse_deg`].toFixed(7)} deg` : "", textContent: digits(r.figures[`${c}_rmse_deg`]) })),
        element("td", { textContent: why || `${(100 * known).toFixed(1)} %` }), element("td", { textContent: r.microseconds.toFixed(0) }));
    })));
}

// ------------------------------------------------------------------------------------------ plots

// Values of a span at times of a grid: of each bucket the one farthest from zero, so that no peak is lost.
function sampled(t, values, grid, { circular, compass }) {
  const out = new Array(grid.length).fill(null), step = grid[1] - grid[0];
  let low = 0, high = t.length;
  while (low < high) { const middle = (low + high) >> 1; if (t[middle] < grid[0]) low = middle + 1; else high = middle; }
  let before = null;
  for (let g = 0, i = low; g < grid.length; g++) {
    let found = null;
    for (; i < t.length && t[i] < grid[g] + step; i++) {
      const y = values[i] * DEG;
      if (Number.isFinite(y) && (found === null || (!compass && Math.abs(y) > Math.abs(found)))) found = y;
    }
    if (found !== null && compass) found = (found + 360) % 360;
    out[g] = found;
    if (circular && found !== null && before !== null && Math.abs(found - before) > 180) out[g - 1] = out[g] = null; // a jump by a turn
    before = found;
  }
  return out;
}

// A scale on which one bad estimator does not flatten the others.
function limits(lines, positive) {
  const sizes = lines.map((l) => l.filter((x) => x !== null).map(Math.abs).sort((p, q) => p - q)).filter((l) => l.length);
  if (!sizes.length) return { range: [-1, 1], beyond: 0 };
  const level = sizes.map((l) => l[Math.floor(0.95 * (l.length - 1))]), middle = [...level].sort((p, q) => p - q)[Math.floor((level.length - 1) / 2)];
  const top = 1.15 * Math.max(0.01, ...sizes.filter((_, i) => level[i] <= 8 * Math.max(middle, 0.02)).map((l) => l[Math.floor(0.999 * (l.length - 1))]));
  return { range: [positive ? 0 : -top, top], beyond: level.filter((l) => l > 8 * Math.max(middle, 0.02)).length };
}

// Gaps a pixel wider on both sides: a line across one is steep, and its ends would show.
const wider = (u, series, from, to, gaps) => gaps.map(([a, b]) => [a - devicePixelRatio, b + devicePixelRatio]);

function plot(parent, title, { lines, positive, attitude }) {
  const width = Math.max(220, parent.clientWidth), shown = lines.filter((l) => l.values), count = Math.max(200, Math.round(width - 60)); // one a pixel: closer, and gaps would be filled
  const grid = Float64Array.from({ length: count }, (_, i) => view[0] + (view[1] - view[0]) * i / (count - 1));
  const made = shown.map((l) => sampled(l.t, l.values, grid, l)), head = [element("b", { textContent: `${title}, deg` })];
  const robust = !attitude && $("robust").checked ? limits(made, positive) : null;
  if (robust?.beyond) head.push(element("span", { className: "note", textContent: `${robust.beyond} beyond the scale` }));
  const box = element("div", { className: "plot", role: "img", ariaLabel: `${title} over time` }, element("div", { className: "head" }, ...head));
  parent.append(box);
  const axis = { stroke: css("--dim"), grid: { stroke: css("--grid"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
  plots.push(new uPlot({
    width, height: 180, legend: { show: false }, padding: [6, 8, 0, 0],
    cursor: { y: false, points: { show: false }, sync: { key: "time" }, drag: { x: true, y: false, setScale: false }, bind: { dblclick: () => () => { zoom(...whole()); return null; } } },
    scales: { x: { time: false, range: () => view }, y: robust ? { range: () => robust.range } : {} },
    axes: [{ ...axis, size: 22, gap: 2, values: (_, v) => v.map((t) => `${+t.toFixed(2)} s`) }, { ...axis, size: 52, gap: 4, incrs: [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45, 90, 180] }],
    series: [{}, ...shown.map((l) => ({ stroke: l.color, width: l.width ?? 1.3, dash: l.dash, points: { show: false }, spanGaps: false, gaps: wider }))],
    hooks: { setSelect: [(u) => { if (u.select.width > 4) setTimeout(zoom, 0, u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")); }] },
  }, [grid, ...made], box));
}

function zoom(from, to) {
  view = to - from < 0.2 ? view : [from, to];
  draw();
}

function draw() {
  plots.forEach((p) => p.destroy());
  plots = [];
  const [a, b] = whole(), shown = results.filter((r) => r.shown);
  $("reset").disabled = view[0] <= a && view[1] >= b;
  $("errors").replaceChildren();
  $("attitudes").replaceChildren();
  $("errors-section").hidden = !recording.reference;
  if (recording.reference) for (const [k, name] of [[3, "tilt error"], [0, "roll error"], [1, "pitch error"], [2, "heading error"]]) {
    plot($("errors"), name, { positive: k === 3, lines: shown.map((r) => ({ t: r.t, values: r.errors[k], color: r.color(), circular: k === 0 || k === 2 })) });
  }
  const truth = recording.reference && referenceAngles();
  ["roll", "pitch", "heading"].forEach((name, k) => plot($("attitudes"), name, { attitude: true, lines: [
    ...shown.map((r) => ({ t: r.t, values: r.angles[k], color: r.color(), circular: k !== 1, compass: k === 2 })),
    ...(truth ? [{ t: truth.t, values: truth.angles[k], color: css("--truth"), width: 1.6, dash: [6, 3], circular: k !== 1, compass: k === 2 }] : []),
  ] }));
}

function referenceAngles() {
  const { n, stamp, q_nb } = recording.reference;
  return (recording.reference.drawn ??= {
    t: Float64Array.from(stamp.subarray(0, n), (x) => x / 1e9),
    angles: [(e) => Math.atan2(e[1], e[2]), (e) => Math.asin(clip(-e[0])), (_, q) => heading(...q)].map((of) => Float32Array.from({ length: n }, (_, i) => { const q = q_nb.subarray(4 * i, 4 * i + 4); return of(down(...q), q); })),
  });
}

root.dataset.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
$("files").onchange = () => run($("files").files);
$("robust").onchange = draw;
$("reset").onclick = () => zoom(...whole());
$("theme").onclick = () => { root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark"; if (results.length) { table(); draw(); } };
for (const name of ["dragover", "dragenter"]) addEventListener(name, (event) => { event.preventDefault(); $("drop").classList.add("over"); });
for (const name of ["dragleave", "drop"]) addEventListener(name, () => $("drop").classList.remove("over"));
addEventListener("drop", (event) => { event.preventDefault(); run(event.dataTransfer.files); });
let width = innerWidth;
addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; if (results.length) draw(); } });
$("list").replaceChildren(...data.estimators.map((e) => element("li", {}, element("b", { textContent: e.name }), ` on ${e.suite}: ${e.text}`)));
