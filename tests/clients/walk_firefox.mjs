// Walks through the player and the studio in Firefox, over WebDriver BiDi, as a first visitor does; prints what it saw as JSON.
//   node walk_firefox.mjs PUPPETEER FIREFOX PLAYER STUDIO FOLDER
// PUPPETEER: folder of node_modules; PLAYER: page of a result; STUDIO: address; FOLDER: for the exported file.
import { readdirSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";

const [modules, firefox, player, studio, folder] = process.argv.slice(2);
const puppeteer = createRequire(join(modules, "index.js"))("puppeteer-core");
const seen = { problems: [] };
const browser = await puppeteer.launch({
  browser: "firefox",
  executablePath: firefox,
  headless: false, // without a window it has no WebGL
  protocolTimeout: 300_000,
  timeout: 300_000,
  extraPrefsFirefox: {
    "browser.download.folderList": 2,
    "browser.download.dir": folder,
    "browser.download.useDownloadDir": true,
    "browser.download.alwaysOpenPanel": false,
    "webgl.force-enabled": true, // drawn without a graphics card
  },
});

/** Open an address in a new tab; errors and warnings of its own scripts are noted. */
async function open(address) {
  const page = await browser.newPage();
  page.setDefaultTimeout(300_000);
  await page.setViewport({ width: 1366, height: 768 });
  page.on("pageerror", (error) => seen.problems.push(String(error)));
  page.on("console", (line) => ["error", "warn"].includes(line.type()) && seen.problems.push(line.text()));
  await page.goto(address);
  await page.waitForSelector("html[data-state]");
  return page;
}

try {
  seen.browser = await browser.version();
  let page = await open(player);
  const refusal = await page.evaluate(() => document.querySelector(".refusal")?.textContent);
  if (refusal) throw new Error(refusal);
  await page.evaluate(() => mimesh.controls.pause());
  await page.evaluate(() => mimesh.controls.seek(0));
  await page.click("[data-name=play]");
  await page.waitForFunction(() => mimesh.stage.time > 0.1);
  await page.click("[data-name=play]");
  await page.focus("[data-name=help]");
  await page.keyboard.press("Home");
  await page.keyboard.press("ArrowRight");
  seen.player = await page.evaluate(() => ({
    clock: document.querySelector(".clock").value,
    playing: mimesh.controls.playing,
    frame: mimesh.stage.time * mimesh.stage.views[1].panel.fps,
  }));
  await page.screenshot({ path: join(folder, "player.png") });
  await page.close();
  page = await open(studio);
  await page.click("#demo");
  await page.waitForSelector("#identities .row[data-state=done]");
  await page.waitForFunction(() => !mimesh.live.loading && mimesh.stage.views.length === 3);
  await page.screenshot({ path: join(folder, "studio.png") });
  await page.click("#write");
  await page.waitForSelector("#export .row[data-state=ready]");
  seen.notice = await page.evaluate(() => document.querySelector("#notice p").textContent);
  const written = () => readdirSync(folder).filter((name) => name.endsWith(".glb"));
  const end = Date.now() + 120_000;
  while (!written().length && Date.now() < end) await new Promise((done) => setTimeout(done, 200));
  seen.written = written();
} finally {
  await browser.close();
}
console.log(JSON.stringify(seen));
