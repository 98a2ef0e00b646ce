// Open a log with a layout in the prebuilt Foxglove Studio of npm, in headless Chromium: no trouble, nothing blank.
// node check_layout.mjs LOG LAYOUT.json FOLDER-FOR-SCREENSHOTS
import { createReadStream, readFileSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { dirname, extname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const [log, layout, folder] = process.argv.slice(2);
const modules = join(dirname(fileURLToPath(import.meta.url)), "node_modules");
const page = `<!DOCTYPE html><html><head><meta charset="utf-8"><style>html, body, #root { height: 100%; margin: 0; }</style></head>
<body><div id="root"></div>
<script src="/react/umd/react.production.min.js"></script><script src="/react-dom/umd/react-dom.production.min.js"></script>
<script>window.global = window; self.react = React; self["react-dom"] = ReactDOM;</script>
<script>self.exports = undefined;</script>
<script src="/@foxglove/studio-base/assets/index.js"></script>
<script type="module">
  const data = await (await fetch("/layout.json")).json();
  const layout = { id: "1", name: "ahrs_sim", permission: "CREATOR_WRITE", baseline: { data, savedAt: new Date().toISOString() }, working: undefined, syncInfo: undefined };
  const values = new Map([["colorScheme", "light"], ["ui.open-dialog-startup", false], ["hideSignInPrompt", true], ["telemetry.telemetryEnabled", false], ["crashReportingEnabled", false]]);
  const appConfiguration = { get: (k) => values.get(k), set: async (k, v) => void values.set(k, v), addChangeListener() {}, removeChangeListener() {} };
  const layoutStorage = { list: async () => [layout], get: async () => layout, put: async (_, l) => l, delete: async () => {}, importLayouts: async () => {} };
  const source = new RemoteDataSourceFactory();
  await initI18n();
  ReactDOM.render(React.createElement(App, { appConfiguration, dataSources: [source], layoutStorage, extensionLoaders: [], enableGlobalCss: true,
    deepLinks: [location.href] }), document.getElementById("root"));
</script></body></html>`;

const types = { ".js": "text/javascript", ".wasm": "application/wasm", ".png": "image/png" };
const server = createServer((request, response) => {
  const path = new URL(request.url, "http://localhost").pathname;
  if (path === "/") return response.setHeader("content-type", "text/html").end(page);
  if (path === "/layout.json") return response.end(readFileSync(layout));
  // The studio asks for its workers and chunks beside the page.
  const file = path === "/log.mcap" ? log : /^\/[^/]+\.(js|wasm|png|woff2?)$/.test(path) ? join(modules, "@foxglove/studio-base/assets", path) : join(modules, path);
  try {
    const { size } = statSync(file), range = /bytes=(\d+)-(\d*)/.exec(request.headers.range ?? "");
    const [from, to] = range ? [Number(range[1]), range[2] ? Math.min(Number(range[2]), size - 1) : size - 1] : [0, size - 1];
    response.writeHead(range ? 206 : 200, { "content-type": types[extname(file)] ?? "application/octet-stream", "accept-ranges": "bytes", "content-length": to - from + 1, ...(range && { "content-range": `bytes ${from}-${to}/${size}` }) });
    createReadStream(file, { start: from, end: to }).pipe(response);
  } catch { response.writeHead(404).end(); }
}).listen(0);
const address = `http://localhost:${server.address().port}/`;

const WAIT = 180_000; // ms without a change in the plots: a slow machine may take its time over a long log, what stays blank fails
const panel = (name) => `[data-testid="panel-mouseenter-container ${name}"]`;

// Coloured pixels from the given fraction of the width on, of pictures or of canvases: [all, red, green, blue] each.
// Curves and the axes of the aircraft are coloured, text, scales and grids are not.
const colours = async ([sources, from]) => {
  const found = [];
  for (const source of sources) {
    const picture = typeof source !== "string" ? source : source.startsWith("data:") ? Object.assign(new Image(), { src: source }) : document.querySelector(source);
    if (picture?.decode) await picture.decode();
    const { width, height } = picture ?? {}, seen = [0, 0, 0, 0];
    found.push(seen);
    if (!width || !height) continue;
    const ctx = Object.assign(document.createElement("canvas"), { width, height }).getContext("2d"), first = Math.floor(from * width);
    ctx.drawImage(picture, 0, 0);
    const { data } = ctx.getImageData(first, 0, width - first, height);
    for (let i = 0; i < data.length; i += 4) {
      const rgb = [data[i], data[i + 1], data[i + 2]], high = Math.max(...rgb);
      if (high - Math.min(...rgb) > 60) { seen[0]++; seen[1 + rgb.indexOf(high)]++; }
    }
  }
  return found;
};

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
try {
  const tab = await browser.newPage({ viewport: { width: 1500, height: 950 } });
  const trouble = [];
  tab.on("pageerror", (e) => trouble.push(String(e)));
  if (process.env.VERBOSE) tab.on("console", (m) => console.log(m.type(), m.text().slice(0, 300)));
  const { configById } = JSON.parse(readFileSync(layout));
  const names = (node) => (typeof node === "string" ? [node] : [...names(node.first), ...names(node.second)]);
  for (const [k, { title, layout: node }] of configById["Tab!main"].tabs.entries()) {
    const begun = Date.now(), plots = names(node);
    // What is still missing of a tab; null: all is there.
    const missing = async () => {
      // The end of every plot is coloured once the whole flight is in it.
      const drawn = await tab.evaluate(colours, [plots.map((name) => `${panel(name)} canvas`), 0.8]);
      const blank = plots.filter((_, i) => drawn[i][0] < 10);
      if (blank.length) return `blank: ${blank.join(", ")}`;
      // The canvas of the 3-D view cannot be read, but a picture taken of it.
      const picture = await tab.locator(panel("3D!aircraft")).screenshot({ timeout: WAIT });
      const [seen] = await tab.evaluate(colours, [[`data:image/png;base64,${picture.toString("base64")}`], 0]);
      return Math.min(...seen.slice(1)) < 20 ? `no aircraft in the 3-D view: ${seen.slice(1)} pixels red, green, blue` : null;
    };
    if (k) await tab.locator(panel("Tab!main")).getByTestId("toolbar-tab").nth(k).click({ timeout: WAIT });
    else await tab.goto(`${address}?${new URLSearchParams({ layoutId: "1", ds: "remote-file", "ds.url": `${address}log.mcap` })}`, { timeout: WAIT });
    let lacks, seen = "", changed = Date.now();
    while ((lacks = await missing()) && !trouble.length && Date.now() - changed < WAIT) {
      const now = JSON.stringify(await tab.evaluate(colours, [plots.map((name) => `${panel(name)} canvas`), 0]));
      if (now !== seen) { seen = now; changed = Date.now(); }
      await tab.waitForTimeout(1000);
    }
    await tab.screenshot({ path: `${folder}/layout-${k + 1}.png`, timeout: WAIT });
    if (trouble.length) throw new Error(trouble.join("\n"));
    if (lacks) throw new Error(`${title}: ${lacks}`);
    console.log(`${title}: ${plots.length} plots and the 3-D view after ${((Date.now() - begun) / 1000).toFixed(0)} s`);
  }
} finally {
  await browser.close();
  server.close();
}
