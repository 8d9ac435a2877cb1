/// How tests follow what streams, and read what the page shows of it.
import { box, create, eventually, reveal, settled, start } from './world.mjs';

export async function interfacesOf(page, path) {
  await box(page, path).locator('header').click();
  await page.getByRole('tab', { name: 'Interfaces' }).click();
}
export async function plot(page, path, number) {
  await page.locator(`[data-plot="${path}#${number}"]`).evaluate((e) => { e.closest('details').open = true; });
  await page.locator(`[data-plot="${path}#${number}"]`).click();
}
export const points = (page) => page.locator('[data-curve]').evaluateAll((all) => all.map((e) => Number(e.dataset.points)));
/// The newest number of each curve, as the page has it.
export const latest = (page) => page.locator('[data-curve]').evaluateAll((all) => all.map((e) => e.dataset.latest));
/// All curves change, and change again: one that stands still does not, however many points it has.
export async function go_on(page, what) {
  for (let round = 0; round < 3; round += 1) {
    const before = await latest(page);
    await eventually(what, async () => (await latest(page)).every((v, i) => v !== before[i] && Number.isFinite(Number(v))));
  }
}
/// Begins to note how long each frame of the page takes, ms, in place of what was noted before.
export const noteFrames = (page) =>
  page.evaluate(() => {
    const frames = (window.frames = []);
    let last = performance.now();
    requestAnimationFrame(function f(now) {
      if (window.frames !== frames) return;
      frames.push(now - last);
      last = now;
      requestAnimationFrame(f);
    });
  });
/// What was noted: how many frames, the time that 95 % of them kept, and the longest, ms.
export async function framesNoted(page) {
  const frames = (await page.evaluate(() => window.frames)).sort((a, b) => a - b);
  return { count: frames.length, p95: frames[Math.floor(frames.length * 0.95)], most: frames.at(-1) };
}
/// What the list of events shows: path and text of each row, oldest first.
export const eventRows = (page) => page.locator('[data-list=events] .list > div').evaluateAll((all) => all.map((e) => [e.querySelector('b').innerText, e.querySelector('span').innerText]));
/// The numbers of listed events by path; what was skipped is said behind them.
export function numbered(rows) {
  const out = {};
  for (const [path, text] of rows) (out[path] ??= []).push(JSON.parse(text.replace(/ \(\d+ skipped before\)$/, '')).number);
  return out;
}

/// A host with sixteen makers of a thousand events a second each, and a page that follows none of them yet.
export async function manyMakers(world) {
  const host = await world.host();
  const makers = Array.from({ length: 16 }, (_, n) => `host/e${n}`);
  for (const path of makers) await create(host.addr, 'fixture-torture/server', path, undefined, { rate_hz: 1000 });
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  return { host, page, makers };
}
export async function followAll(page, makers) {
  for (const path of makers) {
    await reveal(page, path);
    await page.getByRole('tab', { name: 'Interfaces' }).click();
    await page.locator(`[data-follow="${path}/ctl/ticked"]`).click();
  }
}
