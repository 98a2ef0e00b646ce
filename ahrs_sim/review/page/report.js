"use strict";
// The page's program: unpack the series, keep one time (now) and one span (view) for all plots, draw.
(async function () {
  const $ = (id) => document.getElementById(id);
  const data = JSON.parse($("data").textContent);
  const AXES = ["roll", "pitch", "heading"];
  const MEASURES = [...AXES, "tilt"], TILT = 3;
  const colorOf = (i) => data.colors[i % data.colors.length][root.dataset.theme === "dark" ? 1 : 0];
  const root = document.documentElement;
  const css = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const element = (tag, properties = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children);
    return made;
  };

  // ------------------------------------------------------------------------------------------ series

  const bytes = Uint8Array.from(atob($("series").textContent), (c) => c.charCodeAt(0));
  const inflated = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const packed = new Uint8Array(await new Response(inflated).arrayBuffer());
  const unpacked = new Map();

  // A series on an even grid: {t0, dt, v}, NaN in its gaps. See _Packer in report.py for the coding.
  function series(ref) {
    if (!ref) return null;
    if (unpacked.has(ref.at)) return unpacked.get(ref.at);
    const { at, n, planes, order, step, gaps } = ref;
    const v = new Float32Array(n);
    let value = 0, slope = 0;
    for (let i = 0; i < n; i++) {
      let z = 0;
      for (let p = planes - 1; p >= 0; p--) z = z * 256 + packed[at + p * n + i];
      const coded = z % 2 ? -(z + 1) / 2 : z / 2;
      if (order === 2) { slope += coded; value += slope; } else value += coded;
      v[i] = value * step;
    }
    for (let k = 0; k < gaps.length; k += 2) v.fill(NaN, gaps[k], gaps[k + 1]);
    const made = { t0: ref.t0, dt: ref.dt, v };
    unpacked.set(at, made);
    return made;
  }
  const columns = (refs) => (refs ? refs.map(series) : null);
  const derived = (s, f) => s && { t0: s.t0, dt: s.dt, v: s.v.map(f) };
  const sum = (a, b) => a && b && { t0: a.t0, dt: a.dt, v: a.v.map((x, i) => x + b.v[i]) };
  const circular = (s) => s && { ...s, circular: true }; // jumps by a turn where it wraps: not to be drawn
  const constant = (y) => ({ at: () => y, dt: Infinity });
  const steps = (list) => ({ // of runs [from, to, value]
    dt: 0.25,
    at: (t) => { const run = list.findLast((r) => r[0] <= t); return run && t <= list.at(-1)[1] ? run[2] : NaN; },
  });

  function valueAt(s, t) {
    if (!s) return NaN;
    if (s.at) return s.at(t);
    const x = (t - s.t0) / s.dt, i = Math.floor(x);
    if (i < 0 || i >= s.v.length) return NaN;
    const a = s.v[i], b = i + 1 < s.v.length ? s.v[i + 1] : a;
    const change = s.circular && Math.abs(b - a) > 180 ? b - a - 360 * Math.sign(b - a) : b - a;
    return Number.isFinite(change) ? a + (x - i) * change : a;
  }

  // Times at which a plot of some series over [a, b] is drawn: all samples, or two in a bucket a pixel wide.
  function grid(list, a, b, pixels) {
    const fine = Math.min(...list.map((s) => s.dt));
    const dt = Number.isFinite(fine) ? fine : (b - a) / 200;
    if ((b - a) / dt <= 2 * pixels) {
      const t0 = (list.find((s) => s.dt === fine && s.t0 !== undefined) ?? { t0: 0 }).t0;
      const first = Math.floor((a - t0) / dt), n = Math.ceil((b - a) / dt) + 3;
      return { x: Float64Array.from({ length: n }, (_, i) => t0 + (first + i) * dt), bucket: 0, gap: Math.floor(1.5 * n / pixels) };
    }
    const bucket = (b - a) / pixels;
    return { x: Float64Array.from({ length: 2 * pixels }, (_, i) => a + i * bucket / 2), bucket, gap: 3 };
  }

  // Values at the times of a grid; of a bucket the minimum and the maximum in their order, so that no peak is lost.
  // Where a heading wraps there is a gap of a pixel: less is not seen.
  function sampled(s, { x, bucket, gap }) {
    const out = new Array(x.length), wraps = [];
    if (!s.v || s.dt * 2 > bucket) for (let i = 0; i < x.length; i++) {
      const y = valueAt(s, x[i]);
      out[i] = Number.isFinite(y) ? y : null;
    } else extremes(s, x, bucket, out, wraps);
    if (s.circular) for (let i = 1; i < out.length; i++) if (out[i] !== null && out[i - 1] !== null && Math.abs(out[i] - out[i - 1]) > 180) wraps.push(i);
    for (const i of wraps) out.fill(null, Math.max(0, i - gap), i + gap + 1);
    return out;
  }

  function extremes(s, x, bucket, out, wraps) {
    for (let i = 0; i < x.length; i += 2) {
      const from = Math.max(0, Math.ceil((x[i] - s.t0) / s.dt)), to = Math.min(s.v.length, Math.ceil((x[i] + bucket - s.t0) / s.dt));
      let low = Infinity, high = -Infinity, lowAt = 0, highAt = 0;
      for (let k = from; k < to; k++) {
        const y = s.v[k];
        if (y < low) { low = y; lowAt = k; }
        if (y > high) { high = y; highAt = k; }
      }
      if (low > high) out[i] = out[i + 1] = null;
      else if (lowAt <= highAt) { out[i] = low; out[i + 1] = high; } else { out[i] = high; out[i + 1] = low; }
      if (s.circular && high - low > 180) wraps.push(i);
    }
  }

  // ------------------------------------------------------------------------------------------ estimators

  const SHOWN = 10; // at first
  const run_index = (e) => e.run.estimators.findIndex((x) => x.name === e.name);
  const compass = (x) => ((x % 360) + 360) % 360;
  const campaign = data.runs[0].kind === "campaign";
  const estimators = data.runs.flatMap((run, r) => run.estimators.map((e) => ({ ...e, run, r })));
  estimators.forEach((e, i) => {
    e.label = data.runs.length > 1 ? `${e.run.label}: ${e.name}` : e.name;
    e.color = () => colorOf(data.runs.length > 1 ? i : run_index(e));
    e.part = (name) => columns(e[name]);
    e.attitude = [0, 1, 2].map((k) => { let made; return () => (made ??= k === 2 ? circular(derived(sum(series(e.run.truth.attitude[k]), series(e.error[k])), compass)) : sum(series(e.run.truth.attitude[k]), series(e.error[k]))); });
  });
  const rank = (e) => e.summary.tilt_rmse_deg ?? 1e9;
  estimators.sort((a, b) => rank(a) - rank(b)); // colours stay those of the order in the log
  estimators.forEach((e, i) => { e.shown = i < SHOWN; });
  const from = Math.min(...data.runs.map((r) => r.from)), to = Math.max(...data.runs.map((r) => r.to));
  let focus = estimators[0], now = from, view = [from, to], playing = false;
  const shown = () => estimators.filter((e) => e.shown);
  const upwards = () => shown().reverse(); // the best drawn last, over the others
  const placeOf = (line) => (estimators.findIndex((e) => e.label === line.label) + 1) || Infinity;
  const truthOf = (k, run = focus.run) => {
    const s = series(run.truth.attitude[k]);
    return k === 2 && s ? circular((run.heading ??= derived(s, compass))) : s;
  };
  const banded = (e) => $("bands").checked && (e === focus || shown().length <= 4);
  const wrapped = (x) => ((x % 360) + 540) % 360 - 180;
  const digits = (x) => (x == null || !Number.isFinite(x) ? "–" : Math.abs(x) >= 1e5 ? x.toExponential(1).replace("e+", "e") : Math.abs(x) >= 99.95 ? x.toFixed(0) : Math.abs(x) >= 9.995 ? x.toFixed(1) : Math.abs(x) >= 0.0995 ? x.toFixed(2) : x.toPrecision(2));
  const zoomed = () => view[0] > from || view[1] < to;
  const clampView = (a, b) => {
    a = Math.max(from, a); b = Math.min(to, b);
    return b - a < 0.2 ? [Math.max(from, (a + b) / 2 - 0.1), Math.min(to, (a + b) / 2 + 0.1)] : [a, b];
  };

  // ------------------------------------------------------------------------------------------ plots

  const plots = [];
  const visible = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      const plot = plots.find((p) => p.box === entry.target);
      if (plot) { plot.visible = entry.isIntersecting; if (plot.visible) plot.refresh(); }
    }
  }, { rootMargin: "200px" });

  // One plot. lines(): [{label, color, s, width, dash, mute}]; bands(): [{low, high, color}]; span(): of time.
  class Plot {
    constructor(parent, { title, unit = "", height = 170, lines, bands = () => [], span = () => view, format = digits, ticks, range, small, robust }) {
      Object.assign(this, { title, unit, height, lines, bands, span, format, ticks, range, small, robust, dirty: true, visible: false });
      this.head = element("div", { className: "head" });
      this.box = element("div", { className: "plot" }, this.head);
      parent.append(this.box);
      plots.push(this);
      visible.observe(this.box);
    }

    remove() {
      visible.unobserve(this.box);
      this.u?.destroy();
      this.box.remove();
      plots.splice(plots.indexOf(this), 1);
    }

    refresh() {
      if (!this.visible || !this.dirty) return;
      this.dirty = false;
      this.u?.destroy();
      const [a, b] = this.span();
      const width = Math.max(200, this.box.clientWidth);
      this.drawn = this.lines().filter((l) => l.s);
      const bands = this.bands().filter((l) => l.low && l.high);
      const all = [...this.drawn.map((l) => l.s), ...bands.flatMap((l) => [l.high, l.low])];
      if (!all.length) return this.caption();
      const g = grid(all, a, b, Math.round(width - 70));
      const blank = { stroke: "transparent", width: 0, points: { show: false } };
      const axis = { stroke: css("--dim"), grid: { stroke: css("--grid"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
      const opts = {
        width, height: this.height, legend: { show: false }, padding: [6, 16, 0, 0],
        cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false }, bind: { dblclick: () => () => { setView(from, to); return null; } } },
        scales: { x: { time: false, range: () => [a, b] }, y: this.range ? { range: this.range } : this.robust && $("robust").checked ? { range: () => this.limits(a, b) } : {} },
        axes: [
          { ...axis, size: 27, gap: 7, values: (_, v) => v.map((t) => `${+t.toFixed(2)} s`) },
          { ...axis, size: 56, gap: 4, ...(this.ticks ?? {}) },
        ],
        series: [
          {},
          ...this.drawn.map((l) => ({ stroke: l.color, width: l.width ?? 1.4, dash: l.dash, points: { show: false }, spanGaps: false })),
          ...bands.flatMap(() => [{ ...blank }, { ...blank }]),
        ],
        bands: bands.map((l, i) => ({ series: [1 + this.drawn.length + 2 * i, 2 + this.drawn.length + 2 * i], fill: l.color })),
        hooks: {
          drawClear: [(u) => shade(u)],
          draw: [(u) => mark(u)],
          ready: [() => setTimeout(() => this.point())],
          setCursor: [(u) => { if (!moving && u.cursor.left >= 0 && u.cursor.event) setNow(u.posToVal(u.cursor.left, "x")); }],
          setSelect: [(u) => {
            if (u.select.width < 4) return;
            const [p, q] = [u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")];
            setTimeout(() => setView(p, q));
          }],
        },
      };
      this.u = new uPlot(opts, [g.x, ...all.map((s) => sampled(s, g))], this.box);
      this.caption();
    }

    // A scale for the estimators that are comparable: one that is far worse than most of them may leave the frame.
    limits(a, b) {
      const size = (s, share) => {
        const from = Math.max(0, Math.floor((a - s.t0) / s.dt)), v = s.v.subarray(from, Math.max(from, Math.ceil((b - s.t0) / s.dt)));
        const known = Float32Array.from(v.filter(Number.isFinite), Math.abs).sort();
        return known.length ? known[Math.floor(share * (known.length - 1))] : NaN;
      };
      const own = this.drawn.filter((l) => l.s.v && !l.mute).map((l) => ({ s: l.s, p: size(l.s, 0.95) })).filter((l) => Number.isFinite(l.p));
      if (!own.length) return [-1, 1];
      const ordered = own.map((l) => l.p).sort((p, q) => p - q), middle = ordered[Math.floor((ordered.length - 1) / 2)];
      const kept = own.filter((l) => l.p <= 8 * Math.max(middle, 0.02));
      const top = 1.15 * Math.max(1e-3, ...kept.map((l) => size(l.s, 0.999)));
      this.cut = own.length - kept.length;
      return [this.robust === "positive" ? 0 : -top, top];
    }

    point() {
      if (this.u && this.visible) {
        moving = true;
        const [a, b] = this.span();
        this.u.setCursor({ left: now >= a && now <= b ? this.u.valToPos(now, "x") : -10, top: 5 });
        moving = false;
      }
      this.caption();
    }

    caption() {
      if (!this.visible) return;
      const others = new Set(this.small ? shown().filter((e) => e !== focus).map((e) => e.label) : []); // no room for their values
      const parts = (this.drawn ?? []).filter((l) => l.label && !l.mute && !others.has(l.label))
        .sort((a, b) => (placeOf(a) === placeOf(b) ? 0 : placeOf(a) - placeOf(b))).slice(0, 12)
        .map((l) => { const s = element("span", { textContent: `${l.label} ${this.format(valueAt(l.s, now))}` }); s.style.color = l.color; return s; });
      const beyond = this.robust && $("robust").checked && this.cut ? [element("span", { className: "note", textContent: `${this.cut} beyond the scale` })] : [];
      this.head.replaceChildren(element("b", { textContent: this.title + (this.unit ? `, ${this.unit}` : "") }), ...parts, ...beyond);
    }
  }
  let moving = false;

  // Phases of flight and what happened behind a plot.
  function shade(u) {
    const { ctx, bbox } = u;
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    for (const [a, b, phase] of focus.run.phase) {
      ctx.fillStyle = css(`--p${phase}`);
      const x = u.valToPos(a, "x", true);
      ctx.fillRect(x, bbox.top, u.valToPos(b, "x", true) - x, bbox.height);
    }
    ctx.restore();
  }

  // Faults and warnings, over the grid and the series.
  function mark(u) {
    const { ctx, bbox } = u;
    ctx.save();
    ctx.strokeStyle = css("--bad"); ctx.globalAlpha = 0.75; ctx.setLineDash([4, 4]);
    for (const e of focus.run.events) {
      if (e.name === "pilot" && e.level === "info") continue;
      const x = Math.round(u.valToPos(e.t, "x", true)) + 0.5;
      if (x < bbox.left || x > bbox.left + bbox.width) continue;
      ctx.beginPath(); ctx.moveTo(x, bbox.top); ctx.lineTo(x, bbox.top + bbox.height); ctx.stroke();
    }
    ctx.restore();
  }

  function redraw(only) {
    for (const plot of plots) if (!only || only(plot)) { plot.dirty = true; plot.refresh(); }
  }

  function setView(a, b) {
    view = clampView(a, b);
    $("reset").disabled = !zoomed();
    redraw((p) => p.span() === view);
    timeline();
    track();
  }

  function setNow(t) {
    now = Math.min(to, Math.max(from, t));
    $("now").textContent = `${now.toFixed(2)} s`;
    $("scrub").value = now;
    const phase = focus.run.phase.find((p) => p[0] <= now && now <= p[1]);
    const step = focus.run.events.findLast((e) => e.name === "pilot" && e.t <= now && e.text.endsWith(" begins"));
    const recent = focus.run.events.findLast((e) => e.name !== "pilot" && e.t <= now && now - e.t < 5);
    $("doing").textContent = [phase && data.phases[phase[2]], step?.text.replace(/ begins$/, ""), recent?.text].filter(Boolean).join(" · ");
    for (const plot of plots) if (plot.visible) plot.point();
    timeline(); track(); aircraft(); readout();
  }

  // ------------------------------------------------------------------------------------------ canvases

  function canvas(id) {
    const c = $(id), ratio = devicePixelRatio || 1, w = c.clientWidth, h = c.clientHeight;
    if (c.width !== Math.round(w * ratio) || c.height !== Math.round(h * ratio)) { c.width = Math.round(w * ratio); c.height = Math.round(h * ratio); }
    const ctx = c.getContext("2d");
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    return { ctx, w, h };
  }

  function timeline() {
    const { ctx, w, h } = canvas("timeline"), x = (t) => (t - from) / (to - from) * w;
    ctx.fillStyle = css("--line");
    ctx.fillRect(0, 14, w, 8);
    for (const [a, b, phase] of focus.run.phase) {
      ctx.fillStyle = css(`--s${phase}`);
      ctx.fillRect(x(a), 14, Math.max(1, x(b) - x(a)), 8);
    }
    ctx.font = "10.5px system-ui, sans-serif"; ctx.textBaseline = "top";
    let end = -1;
    const lanes = [-1, -1]; // where the last text of each lane of faults ends
    for (const e of focus.run.events) {
      const begins = e.name === "pilot" && e.text.endsWith(" begins");
      if (!begins && e.name === "pilot" && e.level === "info") continue;
      ctx.fillStyle = begins ? css("--dim") : css("--bad");
      ctx.fillRect(x(e.t), 12, 1, begins ? 12 : 14);
      const text = begins ? (e.text.match(/\((.*?)\)/)?.[1] ?? "") : e.text;
      if (begins) {
        if (x(e.t) > end) { ctx.fillText(text, x(e.t) + 2, 0); end = x(e.t) + ctx.measureText(text).width + 8; }
        continue;
      }
      const short = text.slice(0, 40), wide = ctx.measureText(short).width, left = Math.min(x(e.t) + 3, w - wide);
      const lane = lanes.findIndex((last) => left > last);
      if (lane >= 0) { ctx.fillText(short, left, 25 + 11 * lane); lanes[lane] = left + wide + 8; }
    }
    ctx.strokeStyle = css("--accent"); ctx.lineWidth = 1.5;
    if (zoomed()) ctx.strokeRect(x(view[0]), 11, Math.max(2, x(view[1]) - x(view[0])), 14);
    ctx.fillStyle = css("--ink");
    ctx.fillRect(x(now) - 1, 8, 2, h - 10);
  }

  let bounds;
  function track() {
    const { ctx, w, h } = canvas("track"), run = focus.run;
    const north = series(run.truth.north), east = series(run.truth.east), fixes = Object.values(run.suites).flatMap((s) => s.fix);
    if (bounds?.run !== run) {
      const range = (list) => list.reduce(([a, b], x) => (Number.isFinite(x) ? [Math.min(a, x), Math.max(b, x)] : [a, b]), [Infinity, -Infinity]);
      bounds = { run, n: range(north ? [...north.v] : fixes.map((f) => f[0])), e: range(east ? [...east.v] : fixes.map((f) => f[1])) };
    }
    $("track-section").hidden = !Number.isFinite(bounds.n[0]);
    if ($("track-section").hidden) return;
    const scale = Math.min((w - 40) / Math.max(20, bounds.e[1] - bounds.e[0]), (h - 40) / Math.max(20, bounds.n[1] - bounds.n[0]));
    const px = (e) => w / 2 + (e - (bounds.e[0] + bounds.e[1]) / 2) * scale, py = (n) => h / 2 - (n - (bounds.n[0] + bounds.n[1]) / 2) * scale;
    ctx.fillStyle = css("--dim"); ctx.globalAlpha = 0.35;
    for (const [n, e] of fixes) ctx.fillRect(px(e) - 0.8, py(n) - 0.8, 1.6, 1.6);
    ctx.globalAlpha = 1;
    const path = (n, e, a, b, color, width) => {
      if (!n || !e) return;
      ctx.strokeStyle = color; ctx.lineWidth = width; ctx.beginPath();
      let pen = false;
      for (let i = Math.max(0, Math.floor((a - n.t0) / n.dt)); i <= Math.min(n.v.length - 1, (b - n.t0) / n.dt); i++) {
        if (!Number.isFinite(n.v[i])) { pen = false; continue; }
        if (pen) ctx.lineTo(px(e.v[i]), py(n.v[i])); else ctx.moveTo(px(e.v[i]), py(n.v[i]));
        pen = true;
      }
      ctx.stroke();
    };
    path(north, east, from, to, css("--s1"), 1.5);
    path(north, east, view[0], view[1], css("--truth"), 1.6);
    for (const e of shown()) if (e.run === run) path(series(e.north), series(e.east), view[0], view[1], e.color(), 1.3);
    const length = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000].find((l) => l * scale > 60) ?? 20000;
    ctx.fillStyle = css("--dim"); ctx.font = "11px system-ui, sans-serif"; ctx.textBaseline = "alphabetic";
    ctx.fillRect(14, h - 14, length * scale, 2);
    ctx.fillText(`${length} m`, 14, h - 19); ctx.fillText("N ↑", w - 30, 18);
    const at = [[north, east], [series(focus.north), series(focus.east)]].map((p) => p.map((s) => valueAt(s, now))).find((p) => p.every(Number.isFinite));
    const mark = (heading, color, fill) => {
      if (!at || !Number.isFinite(heading)) return;
      ctx.save(); ctx.translate(px(at[1]), py(at[0])); ctx.rotate(heading * Math.PI / 180);
      ctx.beginPath(); ctx.moveTo(0, -11); ctx.lineTo(6.5, 8); ctx.lineTo(0, 4); ctx.lineTo(-6.5, 8); ctx.closePath();
      if (fill) { ctx.fillStyle = color; ctx.fill(); } else { ctx.strokeStyle = color; ctx.lineWidth = 2; ctx.stroke(); }
      ctx.restore();
    };
    mark(valueAt(truthOf(2), now), css("--truth"), true);
    mark(valueAt(focus.attitude[2](), now), focus.color(), false);
    const flown = north ? `height ${digits(valueAt(series(run.truth.height), now))} m above the start, airspeed ${digits(valueAt(series(run.truth.speed), now))} m/s. ` : "";
    $("track-note").textContent = `${flown}Filled: ${run.reference === "truth" ? "true heading" : "heading of " + run.reference}, outline: ${focus.label}. Dots: position fixes.`;
  }

  // A simple aircraft in body axes (forward, right, down): faces as lists of points.
  const FACES = (() => {
    const faces = [], ring = (x, r, z) => [0, 1, 2, 3, 4, 5].map((k) => [x, r * Math.cos(k * Math.PI / 3), z + r * Math.sin(k * Math.PI / 3)]);
    const rings = [ring(1.25, 0.05, 0.02), ring(1.05, 0.16, 0), ring(0.4, 0.2, -0.02), ring(-0.2, 0.15, -0.03), ring(-1.3, 0.05, -0.06)];
    for (let i = 0; i + 1 < rings.length; i++) for (let k = 0; k < 6; k++) faces.push([rings[i][k], rings[i][(k + 1) % 6], rings[i + 1][(k + 1) % 6], rings[i + 1][k]]);
    faces.push(rings[0], rings[4]);
    for (const s of [1, -1]) {
      faces.push([[0.5, 0, -0.14], [0.38, s * 1.7, -0.24], [0.02, s * 1.7, -0.24], [-0.05, 0, -0.14]]);
      faces.push([[-1.0, 0, -0.08], [-1.1, s * 0.58, -0.08], [-1.35, s * 0.58, -0.08], [-1.35, 0, -0.08]]);
    }
    faces.push([[-0.92, 0, -0.1], [-1.22, 0, -0.58], [-1.42, 0, -0.58], [-1.36, 0, -0.06]]);
    return faces;
  })();

  function rotation(roll, pitch, heading) { // body to NED
    const [cr, sr, cp, sp, ch, sh] = [roll, pitch, heading].flatMap((a) => [Math.cos(a * Math.PI / 180), Math.sin(a * Math.PI / 180)]);
    return [[cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh], [cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch], [-sp, sr * cp, cr * cp]];
  }
  const times = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);

  function aircraft() {
    const { ctx, w, h } = canvas("aircraft");
    const truth = [0, 1, 2].map((k) => valueAt(truthOf(k), now)), estimate = [0, 1, 2].map((k) => valueAt(focus.attitude[k](), now));
    if (!truth.every(Number.isFinite)) return;
    // Seen from behind, the right and above, turning along with the true heading.
    const azimuth = (truth[2] + 28) * Math.PI / 180, tilt = 10 * Math.PI / 180, size = Math.min(w, h * 1.5) * 0.25;
    const project = ([n, e, d]) => {
      const ahead = n * Math.cos(azimuth) + e * Math.sin(azimuth), right = -n * Math.sin(azimuth) + e * Math.cos(azimuth);
      const depth = ahead * Math.cos(tilt) + d * Math.sin(tilt), up = ahead * Math.sin(tilt) - d * Math.cos(tilt), near = 7 / (7 + depth);
      return [w / 2 + right * size * near, h / 2 - up * size * near, depth];
    };
    const horizon = h / 2 - 7 * Math.tan(tilt) * size;
    ctx.fillStyle = css("--sky"); ctx.fillRect(0, 0, w, h);
    ctx.fillStyle = css("--ground"); ctx.fillRect(0, Math.max(0, horizon), w, h);
    ctx.strokeStyle = css("--line"); ctx.lineWidth = 1;
    for (let k = -8; k <= 8; k++) for (const line of [[[k, -8, 1.5], [k, 8, 1.5]], [[-8, k, 1.5], [8, k, 1.5]]]) {
      // Lines that pass behind the eye are cut where they would.
      const points = Array.from({ length: 33 }, (_, i) => project(line[0].map((v, j) => v + (line[1][j] - v) * i / 32))).filter((p) => p[2] > -5.5);
      ctx.beginPath(); points.forEach((p, i) => (i ? ctx.lineTo(p[0], p[1]) : ctx.moveTo(p[0], p[1]))); ctx.stroke();
    }
    const draw = (angles, color, solid) => {
      const m = rotation(...angles);
      const faces = FACES.map((f) => f.map((p) => times(m, p))).map((f) => ({ f, p: f.map(project) }));
      faces.sort((a, b) => b.p.reduce((s, p) => s + p[2], 0) / b.p.length - a.p.reduce((s, p) => s + p[2], 0) / a.p.length);
      for (const { f, p } of faces) {
        ctx.beginPath(); p.forEach((q, i) => (i ? ctx.lineTo(q[0], q[1]) : ctx.moveTo(q[0], q[1]))); ctx.closePath();
        if (solid) {
          const [a, b] = [1, 2].map((i) => f[i].map((x, j) => x - f[0][j]));
          const normal = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
          const light = Math.abs(normal[2]) / Math.hypot(...normal, 1e-9);
          ctx.fillStyle = root.dataset.theme === "dark" ? `hsl(212 14% ${46 + 26 * light}%)` : `hsl(212 16% ${58 + 26 * light}%)`;
          ctx.fill(); ctx.strokeStyle = css("--dim"); ctx.lineWidth = 0.6; ctx.stroke();
        } else { ctx.fillStyle = color + "22"; ctx.fill(); ctx.strokeStyle = color; ctx.lineWidth = 1.3; ctx.stroke(); }
      }
    };
    draw(truth, "", true);
    if (estimate.every(Number.isFinite)) draw(estimate, focus.color(), false);
    ctx.font = "12px system-ui, sans-serif"; ctx.textBaseline = "top";
    ctx.fillStyle = css("--dim"); ctx.fillText(`solid: ${focus.run.reference}`, 12, 10);
    ctx.fillStyle = focus.color(); ctx.fillText(`outline: ${focus.label}`, 12, 26);
  }

  function readout() {
    const row = (name, values, color) => {
      const tr = element("tr", {}, element("td", { textContent: name }), ...values.map((v) => element("td", { textContent: v })));
      if (color) tr.style.color = color;
      return tr;
    };
    const truth = [0, 1, 2].map((k) => valueAt(truthOf(k), now)), error = [0, 1, 2].map((k) => valueAt(series(focus.error[k]), now));
    const sigma = focus.part("sigma") ?? [], show = (v, k) => (Number.isFinite(v) ? (k === 2 ? compass(v) : wrapped(v)).toFixed(2) : "–");
    $("readout").replaceChildren(
      row("deg", AXES), row(focus.run.reference, truth.map(show)), row(focus.label, truth.map((v, k) => show(v + error[k], k)), focus.color()),
      row("error", error.map((v) => (Number.isFinite(v) ? v.toFixed(3) : "–"))),
      row("3σ", [0, 1, 2].map((k) => { const s = 3 * valueAt(sigma[k], now); return Number.isFinite(s) ? s.toFixed(3) : "–"; })));
  }

  // ------------------------------------------------------------------------------------------ tables

  const name = (e) => { const dot = element("span", { className: "dot" }); dot.style.background = e.color(); return element("td", {}, dot, e.label); };

  function badge(e) {
    const { nees, inside } = e.summary;
    if (nees == null) return element("span", { className: "badge", textContent: "not given" });
    if (nees > 3) return element("span", { className: `badge ${nees > 30 ? "bad" : "warn"}`, textContent: `overconfident ×${digits(Math.sqrt(nees))}` });
    if (nees < 0.2 && inside > 0.99) return element("span", { className: "badge", textContent: "conservative" });
    return element("span", { className: "badge good", textContent: "consistent" });
  }

  function summary() {
    const measures = ["tilt", "heading", "roll", "pitch"], kinds = ["rmse", "p95", "max"];
    const best = (key) => Math.min(...estimators.map((e) => e.summary[key] ?? Infinity));
    const wide = (m, kind = "") => (m === "roll" || m === "pitch" || kind === "p95" ? " wide" : ""); // not on a phone
    const narrow = matchMedia("(max-width: 600px)").matches; // one row of headings there
    const head = element("thead", {},
      element("tr", { className: "wide" }, element("th", { className: "group" }), element("th", { className: "group" }), ...measures.map((m) => element("th", { className: "group" + wide(m), colSpan: 3, textContent: m })), element("th", { className: "group wide", colSpan: 4 })),
      element("tr", {}, element("th", { textContent: campaign ? "estimator (medians)" : "estimator" }), element("th", { className: "l", textContent: "claimed uncertainty" }),
        ...measures.flatMap((m) => kinds.map((k, i) => element("th", { textContent: narrow ? `${m} ${k}` : k, className: (i ? "" : "gap") + wide(m, k) }))),
        ...["within 3σ", "NEES", "NIS", "available"].map((k) => element("th", { textContent: k, className: "wide" }))));
    const percent = (x) => (x == null ? "–" : `${(100 * x).toFixed(x > 0.995 && x < 1 ? 1 : 0)} %`);
    const body = element("tbody");
    for (const e of estimators) {
      const s = e.summary;
      body.append(element("tr", { className: "first" }, name(e), element("td", { className: "l" }, badge(e)),
        ...measures.flatMap((m) => kinds.map((k, i) => {
          const key = `${m}_${k}_deg`;
          return element("td", { textContent: digits(s[key]), className: (i ? "" : "gap ") + wide(m, k) + " " + (s[key] != null && s[key] <= best(key) && estimators.length > 1 ? "best" : "") });
        })),
        ...[percent(s.inside), digits(s.nees), digits(s.nis), percent(s.availability)].map((text) => element("td", { textContent: text, className: "wide" }))));
      const say = element("td", { colSpan: 18 }, e.finding + " ");
      if (e.worst) {
        const link = element("button", { className: "link", textContent: "show" });
        link.onclick = () => { choose(e); setView(e.worst.from - 10, e.worst.to + 10); setNow(e.worst.from); $("errors").scrollIntoView({ behavior: "smooth" }); };
        say.append(link);
      }
      body.append(element("tr", { className: "say" }, say));
    }
    $("table").replaceChildren(head, body);
  }

  function phases() {
    const used = data.phases.filter((p) => estimators.some((e) => e.summary.phases[p]));
    $("phases-section").hidden = !used.length;
    if (!used.length) return;
    const keys = ["tilt", "heading"], value = (e, p, k) => e.summary.phases[p]?.[`${k}_rmse_deg`];
    const all = estimators.flatMap((e) => used.flatMap((p) => keys.map((k) => value(e, p, k)))).filter((v) => v > 0);
    const low = Math.log(Math.min(...all)) - 0.5, high = Math.log(Math.max(...all));
    $("phases").replaceChildren(
      element("thead", {}, element("tr", {}, element("th"), ...used.map((p) => element("th", { className: "group", colSpan: 2, textContent: p }))),
        element("tr", {}, element("th", { textContent: "estimator" }), ...used.flatMap(() => keys.map((k, i) => element("th", { textContent: k, className: i ? "" : "gap" }))))),
      element("tbody", {}, ...estimators.map((e) => element("tr", { className: "first" }, name(e), ...used.flatMap((p) => keys.map((k, i) => {
        const v = value(e, p, k), cell = element("td", { className: "cell" + (i ? "" : " gap"), textContent: digits(v) });
        if (v > 0) { const u = element("u"); u.style.width = `${100 * (Math.log(v) - low) / (high - low)}%`; u.style.background = e.color(); cell.append(element("i", {}, u)); }
        return cell;
      }))))));
  }

  function flights() {
    $("flights-section").hidden = !campaign;
    if (!campaign) return;
    const run = data.runs[0];
    $("flights").replaceChildren(
      element("thead", {}, element("tr", {}, element("th", { textContent: "flight" }), element("th", { textContent: "seed" }), ...estimators.map((e) => element("th", { className: "group", colSpan: 2, textContent: e.name }))),
        element("tr", {}, element("th"), element("th"), ...estimators.flatMap(() => ["tilt", "heading"].map((k) => element("th", { textContent: k }))))),
      element("tbody", {}, ...run.flights.map((f) => element("tr", { className: "first" }, element("td", { textContent: f.label }), element("td", { textContent: f.seed }),
        ...estimators.flatMap((e) => ["tilt", "heading"].map((k) => element("td", { textContent: digits(f.estimators[e.name]?.[`${k}_rmse_deg`]) })))))));
  }

  function provenance() {
    const table = (values) => element("table", {}, ...Object.entries(values).map(([k, v]) => element("tr", {}, element("td", { textContent: k }), element("td", { textContent: v }))));
    $("provenance").replaceChildren(...data.runs.flatMap((run) => [
      ...(data.runs.length > 1 ? [element("h3", { textContent: run.label })] : []),
      ...Object.entries(run.provenance).map(([title, values]) => element("details", { open: title === "flight" || title === "versions" },
        element("summary", { textContent: title + (values.title ? `: ${values.title}` : values.method ? `: ${values.method} on ${values.suite}` : "") }), table(values))),
      ...Object.entries(run.attachments).map(([title, text]) => element("details", {}, element("summary", { textContent: title }), element("pre", { textContent: text }))),
      element("details", {}, element("summary", { textContent: `events (${run.events.length})` }),
        element("table", {}, ...run.events.map((e) => {
          const link = element("button", { className: "link", textContent: `${e.t.toFixed(2)} s` });
          link.onclick = () => setNow(e.t);
          return element("tr", {}, element("td", {}, link), element("td", { textContent: `${e.level} · ${e.name}: ${e.text}` }));
        }))),
    ]));
  }

  function legend() {
    const truth = element("button", { textContent: focus.run.reference, disabled: true });
    truth.prepend(Object.assign(element("span", { className: "dot" }), { style: `background:${css("--truth")}` }));
    const wanted = $("filter").value.trim().toLowerCase(), found = estimators.filter((e) => e.label.toLowerCase().includes(wanted));
    $("filter").hidden = estimators.length <= SHOWN;
    $("count").textContent = estimators.length > SHOWN ? `${shown().length} of ${estimators.length} shown` : "";
    $("legend").replaceChildren(truth, ...found.map((e) => {
      const dot = element("span", { className: "dot" }), button = element("button", { className: e.shown ? "" : "off", title: "show or hide" }, dot, e.label);
      dot.style.background = e.color();
      button.onclick = () => { e.shown = !e.shown; legend(); redraw(); track(); tabs(); };
      return button;
    }), element("span", { className: "grow" }), ...(focus.run.phase.length ? data.phases : []).map((phase, i) => {
      const dot = element("span", { className: "dot" });
      dot.style.background = css(`--s${i}`);
      return element("span", { className: "note" }, dot, phase);
    }));
  }

  // ------------------------------------------------------------------------------------------ what is plotted

  const power = (v) => (Number.isFinite(v) ? digits(10 ** v) : "–");
  const decades = { values: (_, v) => v.map((y) => (Number.isInteger(y) ? (Math.abs(y) > 3 ? `1e${y}` : `${+(10 ** y).toFixed(4)}`) : "")), incrs: [1, 2, 5] };
  const degrees = { size: 56, incrs: [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45, 90, 180, 360, 720] };
  const headings = { ...degrees, incrs: degrees.incrs.filter((x) => x <= 90), values: (_, v) => v.map((y) => `${+compass(y).toFixed(3)}`) };
  const shadowed = (color) => color + "26";

  function attitudePlot(parent, k, options = {}) {
    return new Plot(parent, {
      title: AXES[k], unit: "deg", format: (x) => (Number.isFinite(x) ? (k === 2 ? compass(x) : wrapped(x)).toFixed(2) : "–"), ticks: k === 2 ? headings : degrees,
      lines: () => [
        ...(campaign ? [] : upwards().map((e) => ({ label: e.label, color: e.color(), s: e.attitude[k](), width: e === focus ? 1.8 : 1.2 }))),
        ...(campaign ? [focus.run] : [...new Set([focus.run, ...shown().map((e) => e.run)])]).map((run) => ({
          label: data.runs.length > 1 ? `${run.label}: ${run.reference}` : run.reference,
          color: run === focus.run ? css("--truth") : css("--dim"), s: truthOf(k, run), width: 1.6, dash: [6, 3],
        })),
      ],
      ...options,
    });
  }

  function build() {
    for (const k of [TILT, 0, 1, 2]) {
      new Plot($("errors"), {
        title: `${MEASURES[k]} error`, unit: "deg", height: 190, ticks: degrees, robust: k === TILT ? "positive" : "both",
        lines: () => [
          ...upwards().map((e) => ({ label: e.label, color: e.color(), s: k === 1 || k === TILT ? series(e.error[k]) : circular(series(e.error[k])), width: e === focus ? 1.6 : 1.1 })),
          ...(campaign && $("bands").checked ? shown() : []).flatMap((e) => [3, -3].map((n) => ({ color: e.color(), s: derived(e.part("sigma")?.[k], (s) => n * s), dash: [3, 4], width: 1, mute: true }))),
        ],
        bands: () => shown().filter((e) => campaign || banded(e)).map((e) => {
          if (campaign) return { low: series(e.low[k]), high: series(e.high[k]), color: shadowed(e.color()) };
          const sigma = e.part("sigma")?.[k];
          return { low: derived(sigma, (s) => -3 * s), high: derived(sigma, (s) => 3 * s), color: shadowed(e.color()) };
        }),
      });
      if (k < TILT) attitudePlot($("attitude"), k);
    }

    const biased = { gyro_bias: ["gyro bias", "deg/s"], accel_bias: ["accelerometer bias", "m/s²"] };
    let any = false;
    for (const [key, [title, unit]] of Object.entries(biased)) {
      if (!estimators.some((e) => e[key])) continue;
      any = true;
      ["x", "y", "z"].forEach((axis, k) => new Plot($("biases"), {
        title: `${title} ${axis}`, unit, small: true, height: 160, robust: "both",
        lines: () => [
          ...upwards().filter((e) => e[key]).map((e) => ({ label: e.label, color: e.color(), s: e.part(key)[k] })),
          ...[...new Set(shown().map((e) => `${e.r}/${e.suite}`))].map((id) => {
            const [r, suite] = [id.slice(0, id.indexOf("/")), id.slice(id.indexOf("/") + 1)];
            return { label: suite === focus.suite ? "truth" : "", color: suite === focus.suite ? css("--truth") : css("--dim"), s: columns(data.runs[r].suites[suite]?.[key])?.[k], dash: [6, 3], width: 1.6 };
          }),
        ],
        bands: () => shown().filter(banded).map((e) => {
          const value = e.part(key)?.[k], sigma = e.part(`${key}_sigma`)?.[k];
          return { low: sum(value, derived(sigma, (s) => -3 * s)), high: sum(value, derived(sigma, (s) => 3 * s)), color: shadowed(e.color()) };
        }),
      }));
    }
    $("bias-section").hidden = !any;

    const bound = (s) => ({ color: css("--dim"), s, dash: [4, 4], width: 1, mute: true });
    new Plot($("consistency"), {
      title: campaign ? "NEES, mean over the flights, with its 95 % bounds" : "NEES of the attitude, with its 95 % bounds", unit: "1 is consistent", format: power, ticks: decades,
      lines: () => [...upwards().map((e) => ({ label: e.label, color: e.color(), s: series(e.nees) })),
        ...(campaign ? [bound(series(focus.nees_low)), bound(series(focus.nees_high))] : [bound(constant(Math.log10(0.2158 / 3))), bound(constant(Math.log10(9.348 / 3)))])],
    });
    if (estimators.some((e) => e.nis)) new Plot($("consistency"), {
      title: "NIS, sum over a second, with its 95 % bounds", unit: "1 is consistent", format: power, ticks: decades,
      lines: () => [...upwards().map((e) => ({ label: e.label, color: e.color(), s: series(e.nis) })), bound(series(focus.nis_low)), bound(series(focus.nis_high))],
    });
    detail();
  }

  // What is shown of the estimator in focus alone.
  let details = [];
  function detail() {
    details.forEach((p) => p.remove());
    details = [];
    const add = (parent, options) => details.push(new Plot($(parent), options));
    const used = (focus.innovation_low ?? []).map((ref, i) => (ref ? i : -1)).filter((i) => i >= 0);
    $("innovation-title").textContent = used.length ? `Innovations of ${focus.label}, in their sigma: extremes of every second, ±3 dashed` : "";
    for (const i of used) add("innovations", {
      title: focus.innovation_names?.[i] ?? `component ${i + 1}`, small: true, height: 110,
      lines: () => [["low", "high"].map((w) => ({ label: w, color: focus.color(), s: series(focus[`innovation_${w}`][i]), width: 1 })), [3, -3].map((y) => ({ color: css("--dim"), s: constant(y), dash: [4, 4], width: 1, mute: true }))].flat(),
      bands: () => [{ low: series(focus.innovation_low[i]), high: series(focus.innovation_high[i]), color: shadowed(focus.color()) }],
    });
    const suites = Object.entries(focus.run.suites).filter(([, s]) => s.satellites?.length);
    if (suites.length) add("state", {
      title: "satellites in use", height: 110, format: (x) => (Number.isFinite(x) ? String(x) : "–"), range: (_, a, b) => [Math.min(0, a ?? 0), Math.max(12, (b ?? 0) + 1)],
      lines: () => suites.map(([suite, s], i) => ({ label: suite, color: colorOf(i + 5), s: steps(s.satellites), width: 1.6 })),
    });
    if (focus.adaptation) add("state", {
      title: `adaptation of ${focus.label}`, height: 130,
      lines: () => focus.adaptation.map((ref, i) => ({ label: `state ${i + 1}`, color: colorOf(i), s: series(ref) })),
    });
    if (estimators.some((e) => e.status)) add("state", {
      title: `status: ${data.status.map((s, i) => `${i} ${s}`).join(", ")}`, height: 110, format: (x) => data.status[x] ?? "–", range: () => [-0.3, data.status.length - 0.5],
      ticks: { incrs: [1], space: 12 },
      lines: () => shown().filter((e) => e.status).map((e) => ({ label: e.label, color: e.color(), s: steps(e.status), width: e === focus ? 2.4 : 1.4 })),
    });
    $("state-section").hidden = !$("state").childElementCount;
  }

  let worst = [], seen = null; // the plots, and the estimator whose worst seconds they show
  function tabs() {
    $("tabs").replaceChildren(...estimators.filter((e) => e.worst && (e.shown || e === seen)).map((e) => {
      const button = element("button", { className: e === seen ? "on" : "", textContent: `${e.label}, ${e.worst.from.toFixed(0)}–${e.worst.to.toFixed(0)} s` });
      button.onclick = () => { choose(e); setNow(e.worst.from); };
      return button;
    }));
  }

  function windows(chosen) {
    $("worst-section").hidden = !chosen || campaign;
    if ($("worst-section").hidden) return;
    seen = chosen;
    tabs();
    worst.forEach((p) => p.remove());
    const span = [chosen.worst.from - 1, chosen.worst.to + 1];
    worst = [2, 1, 0].map((k) => attitudePlot($("worst"), k, { span: () => span, height: 240, small: true }));
  }

  function choose(e) {
    focus = e;
    e.shown = true;
    $("focus").value = estimators.indexOf(e);
    legend(); detail(); redraw();
    if (e.worst) windows(e);
    setNow(now);
  }

  // ------------------------------------------------------------------------------------------ controls

  function play(on) {
    playing = on && !playing;
    $("play").textContent = playing ? "❚❚" : "▶";
    if (!playing) return;
    if (now >= view[1] - 0.01) setNow(view[0]);
    let last = performance.now();
    requestAnimationFrame(function frame(at) {
      if (!playing) return;
      const next = now + Math.max(0, at - last) / 1000 * Number($("speed").value);
      last = at;
      setNow(Math.min(next, view[1]));
      if (next >= view[1]) return play(false);
      requestAnimationFrame(frame);
    });
  }

  function controls() {
    $("play").onclick = () => play(true);
    $("scrub").min = from; $("scrub").max = to;
    $("scrub").oninput = () => setNow(Number($("scrub").value));
    $("reset").onclick = () => setView(from, to);
    $("bands").onchange = () => redraw();
    $("robust").onchange = () => redraw();
    $("filter").oninput = () => legend();
    $("focus").replaceChildren(...estimators.map((e, i) => element("option", { value: i, textContent: e.label })));
    $("focus").onchange = () => choose(estimators[$("focus").value]);
    $("theme").onclick = () => { root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark"; paint(); };
    addEventListener("keydown", (event) => {
      if (/INPUT|SELECT|TEXTAREA/.test(event.target.tagName)) return;
      const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (event.key === " ") { event.preventDefault(); play(true); }
      if (step) { event.preventDefault(); setNow(now + step * (view[1] - view[0]) / (event.shiftKey ? 20 : 400)); }
    });
    const strip = $("timeline"), at = (event) => from + (event.offsetX / strip.clientWidth) * (to - from);
    let begun = null;
    strip.onpointerdown = (event) => { begun = at(event); strip.setPointerCapture(event.pointerId); };
    strip.onpointermove = (event) => { if (begun !== null) setNow(at(event)); };
    strip.onpointerup = (event) => {
      const end = at(event), start = begun;
      begun = null;
      setNow(end);
      if (Math.abs(end - start) > (to - from) * 0.005) setView(Math.min(start, end), Math.max(start, end));
    };
    strip.ondblclick = () => setView(from, to);
    let width = innerWidth;
    addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; paint(); } });
  }

  function paint() {
    summary(); phases(); legend(); redraw(); setNow(now);
  }

  root.dataset.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  const first = data.runs[0], flight = first.provenance.flight ?? {};
  document.title = `${data.title} – ahrs_sim`;
  $("title").textContent = `${data.title}: attitude estimators against ${first.reference}`;
  $("subtitle").textContent = [
    `${data.runs.map((r) => r.label).join(", ")}`, flight.seed !== undefined && !campaign ? `seed ${data.runs.map((r) => r.provenance.flight?.seed ?? "?").join(", ")}` : "",
    `${(to - from).toFixed(0)} s`, flight.epoch ? flight.epoch.replace("T", " ").slice(0, 16) + " UTC" : "",
    Object.keys(first.provenance).filter((k) => k.startsWith("suite ")).map((k) => `${k.slice(6)} = ${first.provenance[k].grade}`).join(", "),
  ].filter(Boolean).join(" · ");
  if (campaign) $("attitude-title").textContent = `Attitude of the first flight's ${first.reference}`;
  if (campaign) $("errors-title").textContent = "Errors: median and middle 95 % over the flights, dashed ±3σ as the estimators claim (median)";
  $("reference").textContent = first.reference === "truth" ? "the truth" : first.reference;
  controls(); build(); windows(estimators.find((e) => e.worst)); flights(); provenance();
  $("reset").disabled = true;
  now = focus.worst?.from ?? from;
  paint();
  const asked = /^#t=(\d+(?:\.\d+)?)$/.exec(location.hash); // a link to a moment: report.html#t=123.4
  if (asked) { setView(+asked[1] - 15, +asked[1] + 15); setNow(+asked[1]); $("errors").scrollIntoView(); }
  root.dataset.ready = "yes";
})();
