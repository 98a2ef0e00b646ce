// node run_page.mjs PAGE FILE...: the page's own programs without a browser: figures by estimator, and notes, as JSON
import fs from "node:fs";
import path from "node:path";
import vm from "node:vm";

const [html, ...names] = process.argv.slice(2), page = fs.readFileSync(html, "utf8");
const scripts = [...page.matchAll(/<script>(.*?)<\/script>/gs)].map((m) => m[1]);
const known = /<script type="application\/json" id="data">(.*?)<\/script>/s.exec(page)[1];
const programs = scripts.at(-1).split("// The page: files in")[0].replace(/^\s*\(function \(\) \{/, ""); // without what draws
const files = names.map((name) => new File([fs.readFileSync(name)], path.basename(name)));
const outside = { document: { getElementById: () => ({ textContent: known }) }, files, TextDecoder, WebAssembly, performance, atob, console, Buffer };
outside.self = outside;
vm.createContext(outside);
vm.runInContext(scripts.at(-2), outside); // the decoder of zstd
const run = `(async () => { ${programs}
  const recording = await read(files, async () => {}), found = { notes: recording.notes, form: recording.form, site: recording.site, estimators: {} };
  for (const e of planned(recording)) {
    const rows = assemble(recording.suites[e.suite]);
    const made = await estimate(e, rows, recording.site, recording.sensors[e.suite], async () => {});
    const { errors } = compared(made, recording.reference);
    found.estimators[e.label] = errors ? summary(errors) : {};
  }
  return found;
})()`;
vm.runInContext(run, outside).then((found) => console.log(JSON.stringify(found)), (error) => { console.log(JSON.stringify({ refused: error.message })); });
