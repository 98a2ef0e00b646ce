// Recordings into records: tables of numbers by kind of sensor, SI, FRD and NED, times in ns from the beginning.

const refuse = (line) => { throw new Error(line); };

// A growing table of numbers: `stamp` and `arrival`, and columns of one or more numbers a row.
class Table {
  constructor(widths) {
    this.n = 0;
    this.widths = { stamp: 1, arrival: 1, ...widths };
    for (const [name, width] of Object.entries(this.widths)) this[name] = new Float64Array(1024 * width);
  }

  add(row) {
    for (const [name, width] of Object.entries(this.widths)) {
      if (this[name].length < (this.n + 1) * width) {
        const longer = new Float64Array(2 * this[name].length);
        longer.set(this[name]);
        this[name] = longer;
      }
      const value = row[name];
      if (width === 1) this[name][this.n] = value ?? NaN;
      else for (let k = 0; k < width; k++) this[name][this.n * width + k] = value ? value[k] : NaN;
    }
    this.n++;
  }

  picked(rows) {
    const { stamp, arrival, ...widths } = this.widths, made = new Table(widths);
    for (const [name, width] of Object.entries(this.widths)) {
      made[name] = new Float64Array(Math.max(1, rows.length) * width);
      rows.forEach((row, i) => { for (let k = 0; k < width; k++) made[name][i * width + k] = this[name][row * width + k]; });
    }
    made.n = rows.length;
    return made;
  }

  sorted(by = "arrival") {
    for (let i = 1; i < this.n; i++) {
      if (this[by][i] < this[by][i - 1]) {
        const rows = Array.from({ length: this.n }, (_, k) => k).sort((p, q) => this[by][p] - this[by][q] || p - q);
        return this.picked(rows);
      }
    }
    return this;
  }
}

const WIDTHS = {
  imu: { gyro_b: 3, accel_b: 3 }, mag: { mag_b: 3 }, fix: { lla_deg: 3, satellites: 1 }, velocity: { vel_n: 3 },
  heading: { heading: 1, sigma: 1 }, air: { airspeed: 1, alpha: 1, beta: 1 }, attitude: { q_nb: 4 },
};

const readers = [
  { form: "MCAP", fits: (head) => head[0] === 0x89 && String.fromCharCode(...head.subarray(1, 5)) === "MCAP", read: (files, say) => readMcap(files[0], say) },
  { form: "ULog", fits: (head) => String.fromCharCode(...head.subarray(0, 4)) === "ULog", read: (files) => readUlog(files[0]) },
];

async function read(files, say) {
  const head = new Uint8Array(await files[0].slice(0, 16).arrayBuffer());
  const reader = readers.find((r) => r.fits(head));
  if (reader && files.length > 1) refuse(`${files.length} files: an ${reader.form} file comes alone; only CSV files come several at once`);
  if (reader) return reader.read(files, say);
  if (head.includes(0)) refuse(`${files[0].name}: not a log of ahrs_sim (.mcap), a ULog (.ulg) or a table of text (.csv)`);
  return readTables(files);
}

// ------------------------------------------------------------------------------------------ MCAP

class Bytes {
  constructor(view, at = 0) { this.view = view; this.at = at; }
  u16() { return this.view.getUint16((this.at += 2) - 2, true); }
  u32() { return this.view.getUint32((this.at += 4) - 4, true); }
  u64() { return Number(this.view.getBigUint64((this.at += 8) - 8, true)); }
  raw(n) { return new Uint8Array(this.view.buffer, this.view.byteOffset + (this.at += n) - n, n); }
  text() { return new TextDecoder().decode(this.raw(this.u32())); }
  map() {
    const end = this.u32() + this.at, found = {};
    while (this.at < end) { const key = this.text(); found[key] = this.text(); }
    return found;
  }
}

const SIZES = { bool: 1, byte: 1, char: 1, int8: 1, uint8: 1, int16: 2, uint16: 2, int32: 4, uint32: 4, int64: 8, uint64: 8, float32: 4, float64: 8 };
const GET = { int8: "getInt8", int16: "getInt16", uint16: "getUint16", int32: "getInt32", uint32: "getUint32", float32: "getFloat32", float64: "getFloat64" };

// Message definitions (ros2msg): by type its fields [type, count, name]; count null: one, -1: a sequence.
function definitions(name, text) {
  const made = {};
  text.split(/^=+$/m).forEach((part, i) => {
    const lines = part.trim().split("\n");
    const owner = (i ? lines.shift().replace("MSG:", "").trim() : name).replace("/msg/", "/");
    made[owner] = lines.map((line) => line.split("#")[0].trim()).filter((line) => line && !line.includes("=")).map((line) => {
      const [, base, array, size, field] = /^([\w/]+)(?:<=\d+)?(\[(?:<=)?(\d*)\])? +(\w+)/.exec(line) ?? refuse(`definition of ${owner}: '${line}' is not understood`);
      const type = base in SIZES || base === "string" || base.includes("/") ? base : base === "Header" ? "std_msgs/Header" : `${owner.split("/")[0]}/${base}`;
      return [type.replace("/msg/", "/"), array ? (size && !array.includes("<") ? Number(size) : -1) : null, field];
    });
  });
  return made;
}

// Where the numbers of a message lie (CDR, little-endian): place by dotted path.
function places(defined, name, view) {
  if (view.getUint16(0) !== 1) refuse("a message is not in little-endian CDR");
  const found = {};
  let at = 4;
  const align = (n) => { at = 4 + Math.ceil((at - 4) / n) * n; };
  const length = () => { align(4); return view.getUint32((at += 4) - 4, true); };
  const one = (type, path) => {
    if (type === "string") at = length() + at;
    else if (type in SIZES) { align(SIZES[type]); found[path] = [at, GET[type] ?? "getUint8"]; at += SIZES[type]; }
    else if (type === "builtin_interfaces/Time" || type === "builtin_interfaces/Duration") { one("int32", `${path}.sec`); one("uint32", `${path}.nanosec`); }
    else for (const [inner, count, field] of defined[type] ?? refuse(`no definition of ${type}`)) {
      const where = path ? `${path}.${field}` : field, n = count === null ? 1 : count < 0 ? length() : count;
      for (let i = 0; i < n; i++) one(inner, count === null ? where : `${where}.${i}`);
    }
  };
  one(name.replace("/msg/", "/"), "");
  return found;
}

const vector = (path, axes = "xyz") => [...axes].map((axis) => `${path}.${axis}`);
const ROUTES = {
  "/imu/data_raw": ["imu", { gyro_b: vector("angular_velocity"), accel_b: vector("linear_acceleration") }],
  "/imu/mag": ["mag", { mag_b: vector("magnetic_field") }],
  "/gps/fix": ["fix", { lla_deg: ["latitude", "longitude", "altitude"] }],
  "/gps/status": ["status", { satellites: "satellites" }],
  "/gps/vel": ["velocity", { vel_n: vector("twist.linear") }],
  "/gps/heading": ["heading", { heading: "heading", sigma: "sigma" }],
  "/air/data": ["air", { airspeed: "airspeed", alpha: "alpha", beta: "beta" }],
};
const TRUTH = "/truth/imu";

function routeOf(topic) {
  if (topic === TRUTH) return ["truth", "attitude", { q_nb: vector("orientation", "wxyz") }];
  const suite = topic.split("/")[1], route = ROUTES[topic.slice(suite.length + 1)];
  return route && suite !== "truth" && suite !== "est" ? [suite, ...route] : null;
}

async function readMcap(file, say) {
  const part = async (from, size) => new DataView(await file.slice(from, from + size).arrayBuffer());
  const end = file.size > 45 && new Bytes(await part(file.size - 37, 29));
  if (!end || end.raw(1)[0] !== 2) refuse(`${file.name}: not finished or cut off: mend it with 'ahrs-sim recover'`);
  end.u64();
  const start = end.u64(), summary = await part(start, file.size - 37 - start);
  const schemas = {}, channels = {}, chunks = [], metadata = {};
  let ours = false;
  for (const b = new Bytes(summary); b.at + 9 <= summary.byteLength;) {
    const opcode = b.raw(1)[0], size = b.u64(), next = b.at + size;
    if (opcode === 3) { const id = b.u16(), name = b.text(); b.text(); schemas[id] = { name, text: b.text() }; }
    else if (opcode === 4) { const id = b.u16(), schema = b.u16(); channels[id] = { topic: b.text(), schema }; }
    else if (opcode === 8) { b.at += 16; chunks.push([b.u64(), b.u64()]); }
    else if (opcode === 10) { b.at += 40; ours ||= b.text() === "scenario.toml"; }
    else if (opcode === 13) {
      const record = new Bytes(await part(b.u64(), b.u64()), 9), name = record.text();
      metadata[name] = record.map();
    }
    b.at = next;
  }
  if (!ours || !metadata.site || !metadata.log) refuse(`${file.name}: not a log of ahrs_sim: 'ahrs-sim replay' reads bags of others`);
  const epoch = BigInt(metadata.log.epoch_ns), epochSeconds = Number(epoch / 1000000000n), epochRest = Number(epoch % 1000000000n);
  const wanted = {}, tables = {};
  for (const [id, { topic, schema }] of Object.entries(channels)) {
    const route = routeOf(topic);
    if (!route) continue;
    const [suite, kind, fields] = route, type = schemas[schema];
    const table = ((tables[suite] ??= {})[kind] = new Table(WIDTHS[kind] ?? { satellites: 1 }));
    wanted[id] = { table, fields: Object.entries(fields), name: type.name, defined: definitions(type.name, type.text), known: new Map() };
  }
  const take = (channel, log, view) => {
    if (!channel.known.has(view.byteLength)) channel.known.set(view.byteLength, places(channel.defined, channel.name, view));
    const known = channel.known.get(view.byteLength), number = (path) => { const [at, get] = known[path]; return view[get](at, true); };
    const row = { arrival: Number(log - epoch), stamp: (number("header.stamp.sec") - epochSeconds) * 1e9 + (number("header.stamp.nanosec") - epochRest) };
    for (const [name, path] of channel.fields) row[name] = typeof path === "string" ? number(path) : path.map(number);
    channel.table.add(row);
  };
  for (const [i, [offset, size]] of chunks.entries()) {
    const b = new Bytes(await part(offset, size), 25), whole = b.u64();
    b.u32();
    const compression = b.text(), packed = b.raw(b.u64());
    const data = compression === "zstd" ? fzstd.decompress(packed, new Uint8Array(whole)) : compression === "" ? packed : refuse(`${file.name}: compressed with ${compression}; zstd and none are read here`);
    const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
    for (let at = 0; at + 9 <= view.byteLength;) {
      const length = Number(view.getBigUint64(at + 1, true)), channel = view.getUint8(at) === 5 && wanted[view.getUint16(at + 9, true)];
      if (channel) take(channel, view.getBigUint64(at + 15, true), new DataView(view.buffer, view.byteOffset + at + 31, length - 22));
      at += 9 + length;
    }
    if (i % 20 === 19) await say(`reading ${file.name}`, i / chunks.length);
  }
  const numbers = (text) => { const all = text.split(" ").map(Number); return all.length > 1 ? all : all[0]; };
  const known = (name) => Object.fromEntries(Object.entries(metadata[name] ?? refuse(`${file.name}: its metadata say nothing of '${name}'; fly the scenario again with this version`)).map(([k, v]) => [k, numbers(v)]));
  const truth = tables.truth?.attitude;
  delete tables.truth;
  const suites = {}, sensors = {};
  for (const [suite, records] of Object.entries(tables)) {
    if (!records.imu?.n) continue;
    for (const kind of Object.keys(records)) records[kind] = records[kind].sorted();
    if (records.status && records.fix) withSatellites(records.fix, records.status);
    suites[suite] = records;
    sensors[suite] = known(`sensors ${suite}`);
  }
  if (!Object.keys(suites).length) refuse(`${file.name}: no IMU in it`);
  return { form: "log of ahrs_sim", name: file.name, site: known("site"), suites, sensors, reference: truth?.n ? { label: "truth", ...truth.sorted("stamp") } : null, notes: [] };
}

// Satellites of each fix: those of the last status with a stamp not after it.
function withSatellites(fix, status) {
  const ordered = status.sorted("stamp");
  let k = 0;
  for (let i = 0; i < fix.n; i++) {
    while (k + 1 < ordered.n && ordered.stamp[k + 1] <= fix.stamp[i]) k++;
    fix.satellites[i] = ordered.n ? ordered.satellites[k] : 0;
  }
}

// ------------------------------------------------------------------------------------------ ULog of PX4

const ULOG = { int8_t: [1, "getInt8"], uint8_t: [1, "getUint8"], bool: [1, "getUint8"], char: [1, "getUint8"], int16_t: [2, "getInt16"], uint16_t: [2, "getUint16"], int32_t: [4, "getInt32"], uint32_t: [4, "getUint32"], int64_t: [8, "getBigInt64"], uint64_t: [8, "getBigUint64"], float: [4, "getFloat32"], double: [8, "getFloat64"] };

const ULOG_MESSAGES = ["sensor_combined", "vehicle_magnetometer", "sensor_mag", "vehicle_gps_position", "sensor_gps", "airspeed", "airspeed_validated", "vehicle_attitude_groundtruth", "vehicle_attitude", "estimator_attitude"];

// Messages of a ULog: by name, of the first instance, functions (field) => number or numbers.
function ulogMessages(view, file) {
  const formats = {}, subscribed = {}, messages = {};
  const text = (at, n) => new TextDecoder().decode(new Uint8Array(view.buffer, at, n));
  const laidOut = (name) => {
    const fields = {};
    let at = 0;
    for (const declared of formats[name].split(";").filter(Boolean)) {
      const [, type, count, field] = /^([\w/]+)(?:\[(\d+)\])? (\w+)$/.exec(declared) ?? refuse(`${file.name}: format of ${name} is not understood`);
      const [size, get] = ULOG[type] ?? [laidOut(type).size, null];
      if (get) fields[field] = { at, size, get, count: count ? Number(count) : null };
      at += size * Number(count ?? 1);
    }
    return { fields, size: at };
  };
  for (let at = 16; at + 3 <= view.byteLength;) {
    const size = view.getUint16(at, true), type = String.fromCharCode(view.getUint8(at + 2)), body = at + 3;
    if (body + size > view.byteLength) break;
    if (type === "F") { const all = text(body, size), colon = all.indexOf(":"); formats[all.slice(0, colon)] = all.slice(colon + 1); }
    if (type === "A") {
      const name = text(body + 3, size - 3);
      if (view.getUint8(body) === 0 && ULOG_MESSAGES.includes(name) && formats[name] && !(name in messages)) { messages[name] = []; subscribed[view.getUint16(body + 1, true)] = { rows: messages[name], fields: laidOut(name).fields }; }
    }
    const subscription = type === "D" && subscribed[view.getUint16(body, true)];
    if (subscription) subscription.rows.push((name) => {
      const f = subscription.fields[name];
      if (!f) return undefined;
      const one = (k) => Number(view[f.get](body + 2 + f.at + k * f.size, true));
      return f.count === null ? one(0) : Array.from({ length: f.count }, (_, k) => one(k));
    });
    at = body + size;
  }
  return messages;
}

async function readUlog(file) {
  const messages = ulogMessages(new DataView(await file.arrayBuffer()), file), has = (name, field) => messages[name]?.length && messages[name][0](field) !== undefined;
  const records = {}, notes = [], offset = utcOffset(messages);
  const make = (kind, name, make) => {
    if (records[kind]?.n) return;
    const sampled = messages[name].some((row) => row("timestamp_sample"));
    const table = (records[kind] = new Table(WIDTHS[kind]));
    for (const row of messages[name]) {
      const made = make(row);
      if (made) table.add({ stamp: 1000 * (row(sampled ? "timestamp_sample" : "timestamp") + (made.later ?? 0)), ...made });
    }
    if (!table.n) delete records[kind];
    else notes.push(`${kind}: ${name}, ${table.n} messages`);
  };
  if (has("sensor_combined", "gyro_rad")) make("imu", "sensor_combined", (row) => ({ gyro_b: row("gyro_rad"), accel_b: row("accelerometer_m_s2") }));
  const gauss = (field) => field.map((x) => 1e-4 * x);
  if (has("vehicle_magnetometer", "magnetometer_ga")) make("mag", "vehicle_magnetometer", (row) => ({ mag_b: gauss(row("magnetometer_ga")) }));
  if (has("sensor_combined", "magnetometer_ga")) {
    let before = [0, 0, 0];
    make("mag", "sensor_combined", (row) => { // repeated until there is a new one
      const field = row("magnetometer_ga"), later = row("magnetometer_timestamp_relative"), fresh = field.some((x, k) => x !== before[k]);
      before = field;
      return fresh && later !== 0x7fffffff && field.some(Boolean) ? { mag_b: gauss(field), later } : null;
    });
  }
  if (has("sensor_mag", "x")) make("mag", "sensor_mag", (row) => ({ mag_b: gauss([row("x"), row("y"), row("z")]) }));
  for (const name of ["vehicle_gps_position", "sensor_gps"]) {
    const degrees = has(name, "latitude_deg");
    if (degrees || has(name, "lat")) make("fix", name, (row) => ({
      lla_deg: row("fix_type") < 3 ? null : degrees ? ["latitude_deg", "longitude_deg", "altitude_ellipsoid_m"].map(row) : [1e-7 * row("lat"), 1e-7 * row("lon"), 1e-3 * row("alt_ellipsoid")], satellites: 0,
    }));
    if (has(name, "vel_n_m_s")) make("velocity", name, (row) => (row("fix_type") >= 3 && row("vel_ned_valid") !== 0 ? { vel_n: ["vel_n_m_s", "vel_e_m_s", "vel_d_m_s"].map(row) } : null));
    if (has(name, "heading")) make("heading", name, (row) => (Number.isFinite(row("heading")) ? { heading: row("heading") } : null));
  }
  for (const name of ["airspeed", "airspeed_validated"]) {
    if (has(name, "true_airspeed_m_s")) make("air", name, (row) => (Number.isFinite(row("true_airspeed_m_s")) ? { airspeed: row("true_airspeed_m_s") } : null));
  }
  for (const name of ["vehicle_attitude_groundtruth", "vehicle_attitude", "estimator_attitude"]) if (has(name, "q")) make("attitude", name, (row) => ({ q_nb: row("q") }));
  if (!records.imu) refuse(`${file.name}: no sensor_combined in it; 'ahrs-sim replay' reads logs with other IMU messages`);
  return foreign("ULog", file.name, records, notes, offset, "ekf2 of the vehicle");
}

// ns from the board's clock to UTC by its receiver; 0 without one.
function utcOffset(messages) {
  for (const name of ["vehicle_gps_position", "sensor_gps"]) {
    const shifts = (messages[name] ?? []).filter((row) => row("time_utc_usec") > 0).map((row) => row("time_utc_usec") - row("timestamp")).sort((p, q) => p - q);
    if (shifts.length) return 1000 * shifts[Math.floor(shifts.length / 2)];
  }
  return 0;
}

// ------------------------------------------------------------------------------------------ tables of text

// By kind and column: names that the columns of a table may have, without regard to case; the unit stands in brackets.
const axes = (...names) => ["x", "y", "z"].map((axis) => names.flatMap((name) => (name.length > 1 ? [`${name}_${axis}`, `${name}.${axis}`] : [`${name}${axis}`])));
const COLUMNS = {
  imu: { gyro_b: [axes("gyro", "angular_velocity", "g"), "rad/s"], accel_b: [axes("accel", "acc", "linear_acceleration", "a"), "m/s2"] },
  mag: { mag_b: [axes("mag", "magnetic_field", "m"), "T"] },
  fix: { lla_deg: [[["latitude", "lat"], ["longitude", "lon"], ["altitude", "height", "alt"]], ["deg", "deg", "m"]] },
  velocity: { vel_n: [[["vel_n", "vn", "vel_north", "twist.linear.x"], ["vel_e", "ve", "vel_east", "twist.linear.y"], ["vel_d", "vd", "vel_down", "twist.linear.z"]], "m/s"] },
  air: { airspeed: [[["airspeed", "true_airspeed", "tas"]], "m/s"] },
  attitude: { q_nb: [["w", "x", "y", "z"].map((axis) => [`pose.pose.orientation.${axis}`, `q_${axis}`, `q${axis}`, `orientation.${axis}`]), ""] },
  euler: { euler: [[["roll"], ["pitch"], ["heading", "yaw"]], "rad"] },
};
const TIMES = ["t", "time", "timestamp"], CHANGES_ONLY = ["fix", "velocity"];

function parsed(name, text) {
  const lines = text.split(/\r?\n/).filter((line) => line.trim());
  if (lines.length < 3) refuse(`${name}: no rows under a header`);
  const separator = [";", "\t", ","].find((s) => lines[0].includes(s)) ?? refuse(`${name}: no comma, semicolon or tab between the names of the columns`);
  const head = lines[0].split(separator).map((cell) => {
    const [, plain, unit] = /^\s*"?\s*([^([]*?)\s*(?:[([]([^)\]]*)[)\]])?\s*"?\s*$/.exec(cell) ?? [0, cell, ""];
    return { name: plain.toLowerCase(), unit: unit ?? "" };
  });
  const rows = lines.slice(1).map((line) => line.split(separator));
  return { name, place: (names) => head.findIndex((h) => names.includes(h.name)), head, rows, number: (row, i) => { const cell = (row[i] ?? "").trim(); return cell === "" ? NaN : Number(cell); } };
}

async function readTables(files) {
  const records = {}, notes = [];
  for (const file of [...files].sort((p, q) => (p.name < q.name ? -1 : 1))) {
    const table = parsed(file.name, await file.text()), at = table.place(TIMES);
    if (at < 0) refuse(`${file.name}: no column for the time; name it t, with its unit: t (s)`);
    let used = 0;
    for (const [kind, fields] of Object.entries(COLUMNS)) {
      const found = taken(table, kind, fields, at);
      if (!found) continue;
      const name = kind === "euler" ? "attitude" : kind;
      if (kind === "attitude" && !found.n) continue;
      if (records[name]) { notes.push(`${file.name}: ${name} left out: there is one already`); continue; }
      records[name] = found;
      notes.push(`${name}: ${file.name}, ${found.n} rows`);
      used++;
    }
    if (!used) notes.push(`${file.name}: left out: no columns of a sensor in it`);
  }
  if (!records.imu) refuse(`no columns of an IMU in ${files.length > 1 ? "them" : files[0].name}: expected gyro_x ... accel_z, with units: gyro_x (deg/s)`);
  return foreign("table of text", files.map((f) => f.name).join(", "), records, notes, 0, "reference");
}

// The rows of a kind in a table; null when a column is not there.
function taken(table, kind, fields, at) {
  const chosen = Object.entries(fields).map(([field, [names, unit]]) => [field, names.map((one, k) => {
    const i = table.place(one);
    return i < 0 ? null : [i, scale(table, i, Array.isArray(unit) ? unit[k] : unit)];
  })]);
  if (chosen.some(([, columns]) => columns.includes(null))) return null;
  const made = new Table(WIDTHS[kind === "euler" ? "attitude" : kind]), clock = scale(table, at, "s");
  for (const row of table.rows) {
    const values = Object.fromEntries(chosen.map(([field, columns]) => [field, columns.map(([i, by]) => by * table.number(row, i))]));
    const stamp = Math.round(table.number(row, at) * clock * 1e9);
    if (!Number.isFinite(stamp) || Object.values(values).flat().some((x) => !Number.isFinite(x))) continue;
    if (values.euler) values.q_nb = fromEuler(values.euler);
    if (values.airspeed) values.airspeed = values.airspeed[0];
    if (kind === "attitude" && Math.abs(Math.hypot(...values.q_nb) - 1) > 0.1) continue; // zeros: not there
    made.add({ stamp, satellites: 0, ...values });
  }
  const { n, widths } = made, names = Object.keys(widths).filter((name) => name !== "stamp" && name !== "arrival");
  const fresh = Array.from({ length: n }, (_, i) => i).filter((i) => i === 0 || names.some((name) => { const w = widths[name], v = made[name]; for (let k = 0; k < w; k++) if (v[i * w + k] !== v[(i - 1) * w + k] && !Number.isNaN(v[i * w + k])) return true; return false; }));
  const runs = fresh.map((i, k) => (fresh[k + 1] ?? n) - i).sort((p, q) => p - q);
  return CHANGES_ONLY.includes(kind) || runs[Math.floor(runs.length / 2)] >= 2 ? made.picked(fresh) : made; // a table repeats what a slow sensor has said
}

const SI = { s: ["s", 1], ms: ["s", 1e-3], us: ["s", 1e-6], ns: ["s", 1e-9], "rad/s": ["rad/s", 1], "deg/s": ["rad/s", Math.PI / 180], dps: ["rad/s", Math.PI / 180], "m/s2": ["m/s2", 1], "m/s^2": ["m/s2", 1], g: ["m/s2", 9.80665], mg: ["m/s2", 9.80665e-3], T: ["T", 1], uT: ["T", 1e-6], nT: ["T", 1e-9], G: ["T", 1e-4], mG: ["T", 1e-7], rad: ["rad", 1], deg: ["rad", Math.PI / 180], m: ["m", 1], ft: ["m", 0.3048], "m/s": ["m/s", 1], "km/h": ["m/s", 1 / 3.6], kt: ["m/s", 1852 / 3600] };

// SI value (deg of latitudes) of a 1 in a column; SI without a unit in the header.
function scale(table, i, wanted) {
  const { name, unit } = table.head[i];
  if (!unit || wanted === "") return 1;
  const [dimension, by] = SI[unit] ?? refuse(`${table.name}: ${name}: unit '${unit}' is not known`);
  if (wanted === "deg" && dimension === "rad") return (by * 180) / Math.PI;
  return dimension === wanted ? by : refuse(`${table.name}: ${name}: ${unit} is no unit of this column, expected ${wanted} or a multiple`);
}

function fromEuler([roll, pitch, heading]) {
  const [a, b, c] = [roll, pitch, heading].map((x) => Math.cos(x / 2)), [d, e, f] = [roll, pitch, heading].map((x) => Math.sin(x / 2));
  return [a * b * c + d * e * f, d * b * c - a * e * f, a * e * c + d * b * f, a * b * f - d * e * c];
}
