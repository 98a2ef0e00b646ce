// node run_wasm.mjs MODULE KNOWN SAMPLES OUT SAMPLE ESTIMATE SITE: structures of ahrs_estimator.h in, estimates out; sizes last
import fs from "node:fs";

const [module, known, samples, out, ...sizes] = process.argv.slice(2);
const [SAMPLE, ESTIMATE, SITE] = sizes.map(Number), BLOCK = 100;
const { instance } = await WebAssembly.instantiate(fs.readFileSync(module), {});
const { memory, ahrs_create, ahrs_process, __heap_base } = instance.exports;
const rows = fs.readFileSync(samples), file = fs.openSync(out, "w");
const base = (__heap_base.value + 15) & ~15, into = base + 4096, from = into + BLOCK * SAMPLE;
memory.grow(4);
new Uint8Array(memory.buffer).set(fs.readFileSync(known), base);
const estimator = ahrs_create(base, base + SITE, 0);
for (let k = 0; k < rows.length; k += BLOCK * SAMPLE) {
  const part = rows.subarray(k, k + BLOCK * SAMPLE), n = part.length / SAMPLE;
  new Uint8Array(memory.buffer).set(part, into);
  new Float64Array(memory.buffer, from, (n * ESTIMATE) / 8).fill(NaN);
  for (let i = 1; i <= n; i++) new Uint8Array(memory.buffer, from + i * ESTIMATE - 8, 8).fill(0);
  if (ahrs_process(estimator, into, n, from)) throw new Error("ahrs_process failed");
  fs.writeSync(file, new Uint8Array(memory.buffer, from, n * ESTIMATE));
}
