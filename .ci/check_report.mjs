// Open a report in headless Chromium as a file, light and dark: no error, no request, plots drawn, cursor, zoom and
// playback work. node check_report.mjs REPORT.html FOLDER-FOR-SCREENSHOTS
import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";

const [report, folder] = process.argv.slice(2);
const fail = (text) => { throw new Error(text); };
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
try {
  for (const colorScheme of ["light", "dark"]) {
    const page = await browser.newPage({ colorScheme, viewport: { width: 1440, height: 1000 } });
    const trouble = [];
    page.on("console", (m) => { if (["error", "warning"].includes(m.type())) trouble.push(m.text()); });
    page.on("pageerror", (e) => trouble.push(String(e)));
    page.on("request", (r) => { if (!/^(file|data|blob):/.test(r.url())) trouble.push(`asks for ${r.url()}`); });
    const begun = Date.now();
    await page.goto(pathToFileURL(report).href);
    await page.waitForFunction(() => document.documentElement.dataset.ready === "yes", null, { timeout: 30_000 });
    const ready = Date.now() - begun;
    const shot = (name) => page.screenshot({ path: `${folder}/${colorScheme}-${name}.png` });
    await shot("top");

    // Every plot gets drawn when it comes into sight, and is not blank.
    const boxes = await page.$$(".plot");
    if (boxes.length < 7) fail(`only ${boxes.length} plots`);
    const colours = (handle) => handle.evaluate((c) => {
      const { data } = c.getContext("2d").getImageData(0, 0, c.width, c.height);
      const seen = new Set();
      for (let i = 0; i < data.length; i += 4) seen.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]);
      return seen.size;
    });
    for (const box of boxes) {
      await box.scrollIntoViewIfNeeded();
      const canvas = await box.waitForSelector("canvas", { timeout: 30_000 });
      const title = await box.$eval(".head b", (b) => b.textContent);
      if ((await colours(canvas)) < 8) fail(`the plot '${title}' is blank`);
    }
    // Without a truth there are no phases of flight, and nothing on the time line but the time.
    const phases = await page.$eval("#phases-section", (e) => !e.hidden);
    for (const id of ["aircraft", "track", ...(phases ? ["timeline"] : [])]) if ((await colours(await page.$(`#${id}`))) < 4) fail(`#${id} is blank`);
    for (const [name, id] of [["errors", "errors"], ["attitude", "attitude"], ["worst", "worst-section"], ...(phases ? [["phases", "phases"]] : []), ["biases", "bias-section"], ["consistency", "consistency"], ["innovations", "innovations"], ["state", "state-section"], ["provenance", "provenance"]]) {
      await page.$eval(`#${id}`, (e) => e.scrollIntoView({ block: "start" }));
      await page.waitForTimeout(150);
      await shot(name);
    }

    // The cursor of one plot moves the time of all.
    const time = () => page.$eval("#now", (o) => parseFloat(o.textContent));
    const plot = await page.$("#errors .u-over");
    await plot.scrollIntoViewIfNeeded();
    const area = await plot.boundingBox();
    await page.mouse.move(area.x + area.width * 0.3, area.y + area.height / 2);
    const before = await time();
    await page.mouse.move(area.x + area.width * 0.6, area.y + area.height / 2, { steps: 4 });
    const after = await time();
    if (!(after > before)) fail(`the cursor does not move the time: ${before}, ${after}`);
    const lines = await page.$$eval("#errors .u-cursor-x", (all) => all.map((e) => new DOMMatrix(getComputedStyle(e).transform).e));
    if (lines.length < 3 || Math.max(...lines) - Math.min(...lines) > 2) fail(`cursors are not linked: ${lines}`);

    // Dragging zooms to full detail: points a hundredth of a second apart; a double click goes back.
    const width = () => page.evaluate(() => Number(document.querySelector("#reset").disabled));
    const [y, x0] = [area.y + area.height / 2, area.x + area.width * 0.6];
    for (const turn of [0, 1]) {
      await page.mouse.move(x0 - 20, y);
      await page.mouse.down();
      await page.mouse.move(x0 + 40, y, { steps: 4 });
      await page.mouse.up();
      await page.waitForTimeout(turn ? 200 : 100);
    }
    if (await width()) fail("dragging does not zoom");
    await shot("zoomed");
    const again = await page.$("#errors .u-over");
    await again.dblclick();
    await page.waitForTimeout(200);
    if (!(await width())) fail("a double click does not show the whole flight");

    // Playback goes on by itself, and the aircraft moves; the slider sets the time.
    await page.$eval("#aircraft", (e) => e.scrollIntoView({ block: "center" }));
    await page.$eval("#scrub", (e) => { e.value = String((Number(e.min) + Number(e.max)) / 3); e.dispatchEvent(new Event("input")); });
    const picture = () => page.$eval("#aircraft", (c) => c.toDataURL());
    const [t0, p0] = [await time(), await picture()];
    await page.selectOption("#speed", "16");
    await page.click("#play");
    await page.waitForTimeout(1000);
    await page.click("#play");
    const [t1, p1] = [await time(), await picture()];
    if (!(t1 > t0 + 1)) fail(`playback stands still: ${t0}, ${t1}`);
    if (p0 === p1) fail("the aircraft does not move");
    await shot("playback");
    await page.click("#theme");

    // A link to a moment opens the page there, zoomed.
    const moment = Math.round(await page.$eval("#scrub", (e) => (2 * Number(e.min) + Number(e.max)) / 3));
    await page.goto("about:blank");
    await page.goto(`${pathToFileURL(report).href}#t=${moment}`);
    await page.waitForFunction(() => document.documentElement.dataset.ready === "yes", null, { timeout: 30_000 });
    if (Math.abs((await time()) - moment) > 0.1 || (await width())) fail(`#t=${moment} opens the page at ${await time()}`);
    if (trouble.length) fail(trouble.join("\n"));
    console.log(`${colorScheme}: ready after ${ready} ms, ${boxes.length} plots drawn, cursor, zoom and playback work`);
    await page.close();
  }
} finally {
  await browser.close();
}
