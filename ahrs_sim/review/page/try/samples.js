// Records into what estimators take: rows of ahrs_sample, and what is known of the place. The rules are those of a replay.

const SAME_NS = 1e7; // position and velocity this close in time are of one solution

// Recordings of others: in order of their stamps, which count as arrivals; place and field known from the first fix.
function foreign(form, name, records, notes, offset, label) {
  const begin = Math.min(...Object.values(records).map((table) => table.stamp.subarray(0, table.n).reduce((p, q) => Math.min(p, q), Infinity)));
  for (const [kind, table] of Object.entries(records)) {
    for (let i = 0; i < table.n; i++) { table.stamp[i] -= begin; table.arrival[i] = table.stamp[i]; }
    const ordered = table.sorted(), rows = [];
    for (let i = 0; i < ordered.n; i++) if (!i || ordered.stamp[i] !== ordered.stamp[i - 1]) rows.push(i);
    records[kind] = rows.length === ordered.n ? ordered : ordered.picked(rows);
  }
  const { attitude, ...sensors } = records;
  if (sensors.fix && sensors.velocity) together(sensors.fix, sensors.velocity);
  plausible(sensors, name);
  const steps = Array.from({ length: sensors.imu.n - 1 }, (_, i) => (sensors.imu.stamp[i + 1] - sensors.imu.stamp[i]) * 1e-9).sort((p, q) => p - q);
  return {
    form, name, notes, site: siteOf(sensors, begin + offset, notes), suites: { bag: sensors },
    sensors: { bag: { ...data.sheet, rate: 1 / steps[Math.floor(steps.length / 2)] } },
    reference: attitude?.n ? { label, ...attitude } : null,
  };
}

// Units that cannot be: said before anything runs.
function plausible({ imu, mag }, name) {
  const median = (table, column) => { const all = Array.from({ length: table.n }, (_, i) => Math.hypot(...table[column].subarray(3 * i, 3 * i + 3))).sort((p, q) => p - q); return all[Math.floor(all.length / 2)]; };
  if (imu.n < 2) refuse(`${name}: an IMU with ${imu.n} row${imu.n === 1 ? "" : "s"}`);
  const force = median(imu, "accel_b"), field = mag && median(mag, "mag_b");
  if (!(force > 4 && force < 20)) refuse(`${name}: the accelerometer reads ${force.toPrecision(3)} m/s2 in the median: write its unit into the header, accel_x (g), or gravity was removed`);
  if (mag && !(field > 5e-6 && field < 2e-4)) refuse(`${name}: the magnetometer reads ${field.toPrecision(3)} T in the median: write its unit into the header, mag_x (uT)`);
}

// Fix and velocity of one solution get one stamp and one arrival.
function together(fix, velocity) {
  if (!fix.n || !velocity.n) return;
  const own = Float64Array.from(fix.arrival.subarray(0, fix.n));
  for (let i = 0, k = 0; i < velocity.n; i++) {
    while (k + 1 < fix.n && Math.abs(fix.stamp[k + 1] - velocity.stamp[i]) < Math.abs(fix.stamp[k] - velocity.stamp[i])) k++;
    if (Math.abs(fix.stamp[k] - velocity.stamp[i]) > SAME_NS) continue;
    velocity.stamp[i] = fix.stamp[k];
    velocity.arrival[i] = fix.arrival[k] = Math.max(velocity.arrival[i], own[k]);
  }
  for (const table of [fix, velocity]) for (let i = 1; i < table.n; i++) table.arrival[i] = Math.max(table.arrival[i], table.arrival[i - 1]);
}

function siteOf({ imu, mag, fix }, epoch, notes) {
  let i = 0;
  while (fix && i < fix.n && !Number.isFinite(fix.lla_deg[3 * i])) i++;
  if (fix && i < fix.n) {
    const [latitude, longitude, height] = fix.lla_deg.subarray(3 * i, 3 * i + 3);
    const lla = [latitude * Math.PI / 180, longitude * Math.PI / 180, height], dated = epoch > 631152e12;
    const year = dated ? decimalYear(epoch) : 2027.5;
    if (!dated) notes.push(`its time is no date: magnetic field of ${year}`);
    return { lla, gravity: normalGravity(lla), mag_n: magneticField(lla, year) };
  }
  notes.push("no position: heading is from magnetic north");
  return { lla: [Math.PI / 4, 0, 0], gravity: 9.80665, mag_n: mag ? fieldAtRest(imu, mag) ?? data.field : data.field };
}

function decimalYear(ns) {
  const date = new Date(ns / 1e6), year = date.getUTCFullYear(), begin = Date.UTC(year, 0, 1);
  return year + (date.getTime() - begin) / (Date.UTC(year + 1, 0, 1) - begin);
}

const [A, B, GM, RATE] = [6378137, 6356752.314245179, 3.986004418e14, 7.292115e-5];

// Magnitude of normal gravity (NIMA TR8350.2, eq. 4-1 and 4-3).
function normalGravity([latitude, , height]) {
  const s2 = Math.sin(latitude) ** 2, e2 = 1 - (B / A) ** 2, f = 1 - B / A, m = RATE ** 2 * A ** 2 * B / GM, h = height / A;
  return 9.7803253359 * (1 + 0.00193185265241 * s2) / Math.sqrt(1 - e2 * s2) * (1 - 2 * (1 + f + m - 2 * f * s2) * h + 3 * h * h);
}

// Field (T, NED) by the model of the year: spherical harmonics, Schmidt semi-normalised (WMM2025 report, section 1.2).
function magneticField([latitude, longitude, height], year) {
  const model = data.fields.find((m) => year < m.to) ?? data.fields.at(-1), dt = Math.min(year, 2055) - model.epoch;
  const s = Math.sin(latitude), c = Math.cos(latitude), e2 = 1 - (B / A) ** 2, normal = A / Math.sqrt(1 - e2 * s * s);
  const p = (normal + height) * c, z = (normal * (1 - e2) + height) * s, r = Math.hypot(p, z), theta = Math.atan2(p, z);
  const ct = Math.cos(theta), st = Math.sin(theta), degree = model.degree, P = [[1]], D = [[0]];
  for (let n = 1; n <= degree; n++) {
    P[n] = []; D[n] = [];
    for (let m = 0; m <= n; m++) {
      if (n === m) {
        const k = n === 1 ? 1 : Math.sqrt((2 * n - 1) / (2 * n));
        P[n][n] = k * st * P[n - 1][n - 1]; D[n][n] = k * (ct * P[n - 1][n - 1] + st * D[n - 1][n - 1]);
      } else {
        const k = Math.sqrt(n * n - m * m), j = Math.sqrt((n - 1) ** 2 - m * m);
        P[n][m] = ((2 * n - 1) * ct * P[n - 1][m] - (n - 2 >= m ? j * P[n - 2][m] : 0)) / k;
        D[n][m] = ((2 * n - 1) * (ct * D[n - 1][m] - st * P[n - 1][m]) - (n - 2 >= m ? j * D[n - 2][m] : 0)) / k;
      }
    }
  }
  let north = 0, east = 0, down = 0;
  for (const [n, m, g0, h0, dg, dh] of model.terms) {
    const g = g0 + dt * dg, h = h0 + dt * dh, power = (6371200 / r) ** (n + 2), cm = Math.cos(m * longitude), sm = Math.sin(m * longitude);
    north += power * (g * cm + h * sm) * D[n][m];
    east += power * m * (g * sm - h * cm) * P[n][m] / Math.max(st, 1e-10);
    down -= power * (n + 1) * (g * cm + h * sm) * P[n][m];
  }
  const turn = Math.PI / 2 - theta - latitude; // geocentric less geodetic latitude
  return [(north * Math.cos(turn) - down * Math.sin(turn)) * 1e-9, east * 1e-9, (north * Math.sin(turn) + down * Math.cos(turn)) * 1e-9];
}

// Strength and dip of the field from readings while the accelerometer reads gravity alone.
function fieldAtRest(imu, mag) {
  const strengths = [], downs = [];
  for (let i = 0, k = 0; i < mag.n; i++) {
    while (k + 1 < imu.n && imu.stamp[k + 1] <= mag.stamp[i]) k++;
    const f = imu.accel_b.subarray(3 * k, 3 * k + 3), m = mag.mag_b.subarray(3 * i, 3 * i + 3), size = Math.hypot(...f), strength = Math.hypot(...m);
    if (Math.abs(size - 9.80665) > 0.3) continue;
    strengths.push(strength);
    downs.push(-(f[0] * m[0] + f[1] * m[1] + f[2] * m[2]) / (size * strength));
  }
  if (strengths.length < 10) return null;
  const middle = (all) => all.sort((p, q) => p - q)[Math.floor(all.length / 2)], total = middle(strengths), down = middle(downs);
  return [total * Math.sqrt(Math.max(1 - down * down, 0)), 0, total * down];
}

// Rows of ahrs_sample: one an IMU message, with the last of each other sensor that had arrived by then.
function assemble(records) {
  const { imu } = records, { size, at } = data.sample, rows = new ArrayBuffer(imu.n * size), view = new DataView(rows), bytes = new Uint8Array(rows);
  const none = { n: 0, stamp: [], arrival: [] }, latches = Object.fromEntries(["mag", "fix", "velocity", "heading", "air"].map((kind) => [kind, { table: records[kind] ?? none, last: -1, fresh: false }]));
  const put = (row, name, values) => values.forEach((value, k) => view.setFloat64(row + at[name] + 8 * k, value, true));
  const part = ({ table, last }, name, width) => (last < 0 ? new Array(width).fill(NaN) : Array.from(table[name].subarray(last * width, (last + 1) * width)));
  for (let i = 0, row = 0; i < imu.n; i++, row += size) {
    for (const latch of Object.values(latches)) {
      const before = latch.last;
      while (latch.last + 1 < latch.table.n && latch.table.arrival[latch.last + 1] <= imu.arrival[i]) latch.last++;
      latch.fresh = latch.last > before;
    }
    const { mag, fix, velocity, heading, air } = latches, stampOf = ({ table, last }) => (last < 0 ? -Infinity : table.stamp[last]);
    let lla = part(fix, "lla_deg", 3).map((x, k) => (k < 2 ? x * (Math.PI / 180) : x)), vel = part(velocity, "vel_n", 3);
    if (stampOf(fix) < stampOf(velocity)) lla = [NaN, NaN, NaN];
    if (stampOf(velocity) < stampOf(fix)) vel = [NaN, NaN, NaN];
    const seconds = (ns) => (ns === -Infinity ? NaN : ns * 1e-9), field = part(mag, "mag_b", 3), [angle] = part(heading, "heading", 1), [speed] = part(air, "airspeed", 1);
    const good = Number.isFinite(lla[0]) || Number.isFinite(vel[0]);
    put(row, "t", [imu.stamp[i] * 1e-9]);
    put(row, "gyro_b", Array.from(imu.gyro_b.subarray(3 * i, 3 * i + 3)));
    put(row, "accel_b", Array.from(imu.accel_b.subarray(3 * i, 3 * i + 3)));
    put(row, "mag_b", field);
    put(row, "lla", lla);
    put(row, "vel_n", vel);
    put(row, "gnss_t", [seconds(Math.max(stampOf(fix), stampOf(velocity)))]);
    put(row, "gnss_satellites", part(fix, "satellites", 1));
    put(row, "heading", [angle]);
    put(row, "heading_sigma", part(heading, "sigma", 1));
    put(row, "heading_t", [seconds(stampOf(heading))]);
    put(row, "airspeed", [speed]);
    put(row, "alpha", part(air, "alpha", 1));
    put(row, "beta", part(air, "beta", 1));
    bytes[row + at.mag_new] = mag.fresh && field.every(Number.isFinite);
    bytes[row + at.gnss_new] = (fix.fresh || velocity.fresh) && good;
    bytes[row + at.heading_new] = heading.fresh && Number.isFinite(angle);
    bytes[row + at.air_new] = air.fresh && Number.isFinite(speed);
  }
  return bytes;
}
