/// Drawings for tests that judge what is seen, and for those that judge how long it takes: connections,
/// and 300 components.
import { box, connect, create, eventually, grpcurl, settled } from './world.mjs';

/// A page that notes when a connection is on the screen; `connected` makes one, and answers when it was asked
/// for, done and seen, ms.
export async function watched(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'echo', 'host/echo');
  const page = await world.viewer(host.addr);
  await box(page, 'host/echo').waitFor();
  await settled(page);
  await page.evaluate(() => {
    window.seen = [];
    const look = () => {
      const there = document.querySelector('.svelte-flow__edge-path, path.wire') !== null && document.querySelector('[data-connection]') !== null;
      if (there !== (window.seen.at(-1)?.there ?? false)) window.seen.push({ there, at: performance.timeOrigin + performance.now() });
    };
    new MutationObserver(look).observe(document.body, { subtree: true, childList: true, attributes: true });
  });
  const connected = async () => {
    const before = await page.evaluate(() => window.seen.length);
    const began = Date.now();
    await connect(host.addr, 'host/echo/sample', 'host/sine/value');
    const done = Date.now();
    const { at } = await eventually('the edge is on the screen', () => page.evaluate((n) => window.seen.slice(n).find((s) => s.there), before));
    return { began, done, at };
  };
  return { host, page, connected };
}

/// Cuts it again, by grpcurl, too.
export async function cut(host, page) {
  await grpcurl(host.addr, 'GcmService/Disconnect', { client: 'host/echo/sample', server: 'host/sine/value' });
  await page.waitForFunction(() => document.querySelector('[data-connection]') === null);
}

/// A page with two components, with which something is done, and then with 300, all of them in the view.
export async function twoThenThreeHundred(world, withTwo) {
  const host = await world.host();
  const steps = [];
  for (let n = 0; n < 150; n += 1) {
    steps.push({ create: { path: `host/s${n}`, class: 'sine', execution: { model: 'none' } } }, { create: { path: `host/e${n}`, class: 'echo', execution: { model: 'none' } } });
    steps.push({ connect: { client: `host/e${n}/sample`, server: `host/s${n}/value` } });
  }
  const apply = async (steps) => {
    for (let n = 0; n < steps.length; n += 60) await grpcurl(host.addr, 'GcmService/Apply', { steps: steps.slice(n, n + 60) });
  };
  await apply(steps.slice(0, 3));
  const page = await world.viewer(host.addr);
  await page.locator('.tally', { hasText: '2 components' }).waitFor();
  await settled(page);
  await withTwo(page);
  await apply(steps.slice(3));
  // A hand that moved the view has kept it: all is shown again.
  await page.locator('.tally', { hasText: '300 components' }).waitFor();
  await page.locator('.laid-out').waitFor();
  await page.keyboard.press('a');
  await page.locator('.tally', { hasText: '300 components' }).waitFor();
  await page.locator('.laid-out').waitFor();
  await settled(page);
  return { host, page };
}

/// Moves all of it about.
export async function moved(page) {
  await page.mouse.move(750, 860);
  await page.mouse.down();
  for (let n = 0; n < 40; n += 1) await page.mouse.move(750 + 8 * n, 860 - 4 * n);
  await page.mouse.up();
}

export const onScreen = (page) => eventually('all of it is on the screen', () => page.evaluate(() => {
  const b = document.querySelector('[data-process=host]').getBoundingClientRect();
  return b.width > 300 && b.left >= 0 && b.right <= innerWidth && b.top >= 0 && b.bottom <= innerHeight;
}));
