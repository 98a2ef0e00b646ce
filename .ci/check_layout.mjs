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
  data.configById["Tab!main"].activeTabIdx = Number(new URL(location).searchParams.get("tab"));
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

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
try {
  const tab = await browser.newPage({ viewport: { width: 1500, height: 950 } });
  const trouble = [];
  tab.on("pageerror", (e) => trouble.push(String(e)));
  if (process.env.VERBOSE) tab.on("console", (m) => console.log(m.type(), m.text().slice(0, 300)));
  const names = JSON.parse(readFileSync(layout)).configById["Tab!main"].tabs.map((t) => t.title);
  for (const [k, name] of names.entries()) {
    const query = new URLSearchParams({ tab: k, layoutId: "1", ds: "remote-file", "ds.url": `${address}log.mcap` });
    await tab.goto(`${address}?${query}`);
    await tab.waitForFunction(() => document.querySelectorAll("canvas").length > 3, null, { timeout: 60_000 });
    // Curves are coloured, axes and grids are not; of the 3-D view, which a script cannot read, there is the screenshot.
    const coloured = () => tab.$$eval("canvas", (all) => all.map((c) => {
      if (!c.width || !c.height) return 0;
      const copy = Object.assign(document.createElement("canvas"), { width: c.width, height: c.height }), ctx = copy.getContext("2d");
      ctx.drawImage(c, 0, 0);
      const { data } = ctx.getImageData(0, 0, c.width, c.height);
      let count = 0;
      for (let i = 0; i < data.length; i += 4) if (Math.max(data[i], data[i + 1], data[i + 2]) - Math.min(data[i], data[i + 1], data[i + 2]) > 60) count++;
      return count;
    }));
    const until = Date.now() + 120_000;
    let drawn = await coloured();
    while (drawn.filter((n) => n > 100).length < drawn.length - 1 && Date.now() < until) {
      await tab.waitForTimeout(2000);
      drawn = await coloured();
    }
    await tab.screenshot({ path: `${folder}/layout-${k + 1}.png` });
    console.log(`${name}: ${drawn.length} canvases, coloured pixels ${drawn.join(" ")}`);
    if (drawn.filter((n) => n > 100).length < drawn.length - 1) throw new Error(`${name}: a plot stays blank`);
    if (trouble.length) throw new Error(trouble.join("\n"));
  }
} finally {
  await browser.close();
  server.close();
}
