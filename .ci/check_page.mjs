// A recording dropped on the page of estimators in headless Chromium: the table has the command line's figures, plots are
// drawn, nothing is asked of a network, a wrong file is one line.
// node check_page.mjs PAGE.html EXPECTED.json FOLDER-FOR-SCREENSHOTS FILE...
import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";
import fs from "node:fs";

const [html, expected, folder, ...files] = process.argv.slice(2);
const fail = (text) => { throw new Error(text); };
const wanted = JSON.parse(fs.readFileSync(expected, "utf8")).estimators, MEASURES = ["tilt", "roll", "pitch", "heading", "total"];
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
try {
  for (const [colorScheme, width] of [["light", 1400], ["dark", 1400], ["light", 390], ["dark", 390]]) {
    const page = await browser.newPage({ colorScheme, viewport: { width, height: 900 } });
    const trouble = [];
    page.on("console", (m) => { if (["error", "warning"].includes(m.type())) trouble.push(m.text()); });
    page.on("pageerror", (e) => trouble.push(String(e)));
    page.on("request", (r) => { if (!/^(file|data|blob):/.test(r.url())) trouble.push(`asks for ${r.url()}`); });
    await page.goto(pathToFileURL(html).href);
    const shot = (name) => page.screenshot({ path: `${folder}/page-${colorScheme}-${width}-${name}.png`, fullPage: true });
    await shot("empty");
    const ended = async () => {
      await page.waitForFunction(() => document.documentElement.dataset.ready, null, { timeout: 300_000 });
      return page.evaluate(() => document.documentElement.dataset.ready);
    };

    const wrong = await page.evaluateHandle(() => {
      const data = new DataTransfer();
      data.items.add(new File(["no table"], "notes.txt"));
      return data;
    });
    await page.dispatchEvent("#drop", "drop", { dataTransfer: wrong });
    if ((await ended()) !== "no") fail("a text that is no table is taken");
    if (!(await page.textContent("#trouble")).startsWith("notes.txt: ")) fail("no line for a text that is no table");

    const begun = Date.now();
    await page.setInputFiles("#files", files);
    await page.waitForFunction(() => !document.documentElement.dataset.ready);
    if ((await ended()) !== "yes") fail(await page.textContent("#trouble"));
    const took = Date.now() - begun;
    const found = Object.fromEntries(await page.$$eval("#table tbody tr", (rows) => rows.map((r) => [r.cells[0].textContent.trim(), [...r.cells].slice(1, 6).map((c) => parseFloat(c.title))])));
    if (Object.keys(found).sort().join() !== Object.keys(wanted).sort().join()) fail(`estimators: ${Object.keys(found)}; expected ${Object.keys(wanted)}`);
    let largest = 0;
    for (const [name, figures] of Object.entries(wanted)) MEASURES.forEach((measure, k) => {
      const value = figures[`${measure}_rmse_deg`];
      if (value === null && Number.isNaN(found[name][k])) return;
      const off = Math.abs(found[name][k] - value);
      if (!(off < 2e-5 * Math.max(1, value))) fail(`${name}: ${measure} ${found[name][k]}, the command line has ${value}`);
      largest = Math.max(largest, off);
    });
    for (const box of await page.$$(".plot canvas")) {
      const colours = await box.evaluate((c) => {
        const { data } = c.getContext("2d").getImageData(0, 0, c.width, c.height), seen = new Set();
        for (let i = 0; i < data.length; i += 4) seen.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]);
        return seen.size;
      });
      if (colours < 8) fail("a plot is blank");
    }
    if ((await page.$$(".plot canvas")).length !== 7) fail("not every plot is there");
    const wide = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    if (wide > 0) fail(`the page is ${wide} px wider than the screen`);
    await shot("result");
    if (trouble.length) fail(trouble.join("\n"));
    console.log(`${colorScheme}, ${width} px: ${Object.keys(found).length} estimators in ${took} ms, at most ${largest.toExponential(1)} deg from the command line`);
    await page.close();
  }
} finally {
  await browser.close();
}
