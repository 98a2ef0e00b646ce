// Estimators over samples, and their errors: WebAssembly of the same code that flies and replays.

const BLOCK = 400; // rows at once

// Which estimators run on which suites: of a log with their suite on that, else each kind once on every suite.
function planned({ suites }) {
  const own = data.estimators.filter((e) => e.suite in suites);
  if (own.length) return own.map((e) => ({ ...e, label: e.name }));
  const kinds = [...new Map(data.estimators.map((e) => [e.code, e])).values()], several = Object.keys(suites).length > 1;
  return Object.keys(suites).flatMap((suite) => kinds.map((e) => ({ ...e, suite, label: several ? `${e.kind}@${suite}` : e.kind })));
}

const instances = new Map();
async function instance(code) {
  if (!instances.has(code)) instances.set(code, WebAssembly.compile(Uint8Array.from(atob(code), (c) => c.charCodeAt(0))));
  return (await WebAssembly.instantiate(await instances.get(code), {})).exports; // its own memory: one estimator each
}

// Estimates of one estimator: t, q_nb, down_b by row, and how long it took.
async function estimate(estimator, rows, site, sensors, progress) {
  const { size, at } = data.sample, out = data.estimate, n = rows.length / size;
  const made = { t: new Float64Array(n), q_nb: new Float64Array(4 * n), down_b: new Float64Array(3 * n), failed: "" };
  const wasm = await instance(data.code[estimator.code]), base = (wasm.__heap_base.value + 15) & ~15, into = base + 4096, from = into + BLOCK * size;
  wasm.memory.grow(Math.ceil((from + BLOCK * out.size - wasm.memory.buffer.byteLength) / 65536) + 1);
  const numbers = (place, values) => new Float64Array(wasm.memory.buffer, place, values.length).set(values);
  numbers(base, [...site.lla, site.gravity, ...site.mag_n]);
  const self = wasm.ahrs_create(base, 0, 0);
  numbers(wasm.page_sensors(), Object.keys(data.sheet).flatMap((name) => sensors[name] ?? data.sheet[name]));
  wasm.ahrs_reset(self);
  let spent = 0;
  for (let first = 0; first < n; first += BLOCK) {
    const count = Math.min(BLOCK, n - first), begun = performance.now();
    new Uint8Array(wasm.memory.buffer, into).set(rows.subarray(first * size, (first + count) * size));
    const view = new DataView(wasm.memory.buffer, from), part = new DataView(rows.buffer, rows.byteOffset + first * size);
    new Float64Array(wasm.memory.buffer, from, count * out.size / 8).fill(NaN);
    for (let i = 0; i < count; i++) {
      view.setFloat64(i * out.size + out.at.t, part.getFloat64(i * size + at.t, true), true);
      view.setFloat64(i * out.size + out.at.status, 0, true); // and the bytes behind it
    }
    if (wasm.ahrs_process(self, into, count, from)) { made.failed = "a time stamp is not finite or goes back by more than a second"; break; }
    for (let i = 0; i < count; i++) {
      const row = first + i, number = (place, k) => view.getFloat64(i * out.size + place + 8 * k, true);
      made.t[row] = Math.round(number(out.at.t, 0) * 1e9) / 1e9;
      for (let k = 0; k < 4; k++) made.q_nb[4 * row + k] = number(out.at.q_nb, k);
      for (let k = 0; k < 3; k++) made.down_b[3 * row + k] = number(out.at.down_b, k);
    }
    spent += performance.now() - begun;
    await progress(count);
  }
  return { ...made, n, microseconds: 1e3 * spent / Math.max(n, 1) };
}

// ------------------------------------------------------------------------------------------ attitudes

const wrap = (x) => Math.PI - ((((Math.PI - x) % (2 * Math.PI)) + 2 * Math.PI) % (2 * Math.PI));
const clip = (x) => Math.max(-1, Math.min(1, x));
const heading = (a, b, c, d) => Math.atan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d));
const down = (a, b, c, d) => [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)];

// The reference at times rising: linear between neighbours, normalised; NaN outside and in gaps of five periods.
function* interpolated({ n, stamp, q_nb }, times) {
  const t = Float64Array.from(stamp.subarray(0, n), (x) => x / 1e9), steps = Float64Array.from({ length: n - 1 }, (_, i) => t[i + 1] - t[i]).sort();
  const longest = n > 2 ? 5 * steps[Math.floor(0.9 * (n - 2))] : Infinity;
  let k = 1;
  for (const at of times) {
    while (k < n - 1 && t[k] < at) k++;
    const span = t[k] - t[k - 1], weight = span > 0 ? (at - t[k - 1]) / span : 0;
    const p = q_nb.subarray(4 * k - 4, 4 * k), q = q_nb.subarray(4 * k, 4 * k + 4), sign = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3] < 0 ? -1 : 1;
    const gap = span > longest && at > t[k - 1] + 1e-9 && at < t[k] - 1e-9;
    if (!(n > 1) || gap || at < t[0] - 1e-9 || at > t[n - 1] + 1e-9) { yield [NaN, NaN, NaN, NaN]; continue; }
    const mixed = [0, 1, 2, 3].map((i) => (1 - weight) * p[i] + weight * sign * q[i]), size = Math.hypot(...mixed);
    yield mixed.map((x) => x / size);
  }
}

const MEASURES = ["roll", "pitch", "heading", "tilt", "total"], STEEP = Math.sqrt(1 - 0.01);

// Errors by measure, rad; none without a reference. Attitudes by roll, pitch, heading, rad.
function compared(estimates, reference) {
  const { n, t, q_nb, down_b } = estimates, errors = reference && MEASURES.map(() => new Float32Array(n)), angles = [0, 1, 2].map(() => new Float32Array(n));
  const at = reference && interpolated(reference, t);
  for (let i = 0; i < n; i++) {
    const q = q_nb.subarray(4 * i, 4 * i + 4), d = down_b.subarray(3 * i, 3 * i + 3);
    const own = [Math.atan2(d[1], d[2]), Math.asin(clip(-d[0])), heading(...q)];
    own.forEach((x, k) => { angles[k][i] = x; });
    if (!reference) continue;
    const r = at.next().value, e = down(...r), steep = Math.abs(e[0]) > STEEP;
    const truth = [Math.atan2(e[1], e[2]), Math.asin(clip(-e[0])), heading(...r)];
    own.forEach((x, k) => { errors[k][i] = steep && k !== 1 ? NaN : wrap(x - truth[k]); });
    const cross = Math.hypot(d[1] * e[2] - d[2] * e[1], d[2] * e[0] - d[0] * e[2], d[0] * e[1] - d[1] * e[0]);
    errors[3][i] = Math.atan2(cross, d[0] * e[0] + d[1] * e[1] + d[2] * e[2]);
    const [a, b, c, f] = q, [w, x, y, z] = r; // conj(q) (x) r
    const turn = Math.hypot(a * x - w * b - (c * z - f * y), a * y - w * c - (f * x - b * z), a * z - w * f - (b * y - c * x));
    errors[4][i] = 2 * Math.atan2(turn, Math.abs(a * w + b * x + c * y + f * z));
  }
  return { errors, angles };
}

// Root mean square (deg) of finite values, and their share of the rows with a reference.
function summary(errors) {
  const found = {};
  MEASURES.forEach((name, k) => {
    let sum = 0, count = 0;
    for (const x of errors[k]) if (Number.isFinite(x)) { const deg = x * 180 / Math.PI; sum += deg * deg; count++; }
    found[`${name}_rmse_deg`] = count ? Math.sqrt(sum / count) : null;
    if (name === "tilt") found.availability = count / errors[k].length;
  });
  return found;
}
