/// A page nobody sees: it lets go of its calls, and takes them up again. The driver's pages always count as
/// seen, so what the browser would say is said in its place; the page's clock is the driver's, which turns it
/// on.
import { go_on, interfacesOf, latest, plot, points } from './following.mjs';
import { drop, sineShown } from './plotting.mjs';
import { box, create, eventually, grpcurl, holds, is, reaches, settled, shot, start } from './world.mjs';

/// After so long unseen a page has let go, and after so long it has not yet, ms; see UNSEEN in App.svelte.
const LONG = 6000;
const SHORT = 4000;

async function seen(page, yes) {
  await page.evaluate((yes) => {
    Object.defineProperty(document, 'hidden', { configurable: true, get: () => !yes });
    Object.defineProperty(document, 'visibilityState', { configurable: true, get: () => (yes ? 'visible' : 'hidden') });
    document.dispatchEvent(new Event('visibilitychange'));
  }, yes);
}

/// The calls of a page that are open, by method, and how many were ever begun.
function calls(page) {
  const open = new Map();
  const began = { all: 0, streams: 0 };
  page.on('request', (request) => {
    const method = /Service\/(\w+)$/.exec(request.url())?.[1];
    if (!method) return;
    began.all += 1;
    if (['Watch', 'Subscribe'].includes(method)) began.streams += 1;
    open.set(request, method);
  });
  for (const over of ['requestfinished', 'requestfailed']) page.on(over, (request) => open.delete(request));
  return { began, open: () => [...open.values()].sort() };
}

const gaps = (page) => page.locator('[data-curve]').evaluateAll((all) => all.map((curve) => Number(curve.dataset.gaps)));

export async function a_page_nobody_sees_lets_go_of_its_calls_and_takes_them_up_when_it_is_seen(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'fixture-torture/server', 'host/events', undefined, { rate_hz: 10 });
  await start(host.addr, 'host/**');
  const context = await world.browser();
  await context.clock.install();
  const page = await context.newPage();
  const { open, began } = calls(page);
  await page.goto(`http://${host.addr}/`);
  await settled(page);
  // A sample, a state row and a read.
  await interfacesOf(page, 'host/sine');
  await plot(page, 'host/sine/value', 'value');
  await plot(page, 'host/sine', 'latest.value');
  await plot(page, 'host/sine/signal/value', '');
  await interfacesOf(page, 'host/events');
  await page.locator('[data-follow="host/events/ctl/ticked"]').click();
  await page.getByRole('button', { name: 'Plots', exact: true }).click();
  await interfacesOf(page, 'host/sine');
  await eventually('three curves are there', async () => (await points(page)).length === 3);
  await reaches('points come', () => points(page), 11);
  await eventually('what streams are two calls', () => open().filter((m) => m === 'Watch' || m === 'Subscribe').join() === 'Subscribe,Watch');

  // Looked away for a moment only: what streams goes on in the same calls. The page's clock stands still
  // between the calls of the driver, however long those take.
  await page.clock.pauseAt((await page.evaluate(() => Date.now())) + LONG);
  const before = { streams: began.streams, gaps: await gaps(page) };
  await seen(page, false);
  await page.clock.fastForward(SHORT);
  await seen(page, true);
  await page.clock.resume();
  await page.clock.fastForward(LONG);
  await go_on(page, 'all three go on');
  is(began.streams, before.streams, 'calls begun anew after a moment');
  is((await gaps(page)).slice(0, 2), before.gaps.slice(0, 2), 'gaps after a moment in what streams');

  // For long: nothing is asked any more, and what happens meanwhile is not known.
  await seen(page, false);
  await page.clock.fastForward(LONG);
  await eventually('all calls end', () => open().length === 0);
  await eventually('each curve ends in a gap', async () => (await gaps(page)).every((n, i) => n > before.gaps[i]));
  const [asked, had, away] = [began.all, await points(page), await gaps(page)];
  await create(host.addr, 'sine', 'host/later');
  // Each turn of the clock lets every timer of the page that is due go off once.
  for (let turn = 0; turn < 5; turn += 1) await page.clock.fastForward(LONG);
  is([began.all, open()], [asked, []], 'calls begun by a page nobody sees');
  is(await points(page), had, 'points drawn meanwhile');
  is(await box(page, 'host/later').count(), 0, 'components told of meanwhile');

  await seen(page, true);
  await box(page, 'host/later').waitFor();
  await go_on(page, 'all three go on again');
  await eventually('what streams are two calls again', () => open().filter((m) => m === 'Watch' || m === 'Subscribe').join() === 'Subscribe,Watch');
  is(await gaps(page), away, 'gaps, one for the time nobody looked');
  holds((await points(page)).every((n, i) => n > had[i]), `curves go on rather than begin anew: ${had}, then ${await points(page)}`);
  is(await page.locator('[data-curve] .refusal').allInnerTexts(), [], 'complaints');
  // The figures, too, which are asked for.
  await eventually('steps are told', async () => /\d Hz/.test(await box(page, 'host/sine').locator('footer').innerText()));
  const { executed } = (await grpcurl(host.addr, 'GcmService/List', {})).components.find((c) => c.path === 'host/sine').stats;
  await page.getByRole('tab', { name: 'Overview' }).click();
  await eventually('figures are of now', async () => Number(/(\d+) executed/.exec(await page.locator('.inspector').innerText())?.[1]) >= Number(executed));
  await shot(page, 'seen-again');
  // It is said where some events may be missing.
  await page.getByRole('button', { name: 'Events', exact: true }).click();
  const list = page.locator('[data-list=events]');
  await list.locator('[role=log] div', { hasText: 'may be missing: nobody listened' }).waitFor();
  is(await list.getAttribute('data-interrupted'), '1', 'times nobody listened to events');
}

export async function a_read_of_what_is_stopped_keeps_its_points_over_a_gap(world) {
  const { host, page } = await sineShown(world, { frequency_hz: 1 });
  await drop(page, { path: 'host/sine/signal/value', field: '', source: 'read', unit: '' });
  await reaches('points come', () => points(page), 30);
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/sine' });
  // Its reads are answered with the row it stopped at.
  let [row, rows] = ['', 0];
  await eventually('that row is there', async () => (rows = row === (row = (await latest(page))[0]) ? rows + 1 : 0) > 3);
  await seen(page, false);
  await eventually('a gap', async () => (await gaps(page))[0] === 1);
  const had = await points(page);
  await seen(page, true);
  await eventually('its value is read again', async () => Number.isFinite(Number((await latest(page))[0])), () => latest(page));
  holds((await points(page))[0] >= had[0] - 1, `it keeps its points: ${had}, then ${await points(page)}`);
  await start(host.addr, 'host/sine');
  await go_on(page, 'it goes on');
  holds((await points(page))[0] > had[0], `the new ones come behind the old: ${had}, then ${await points(page)}`);
}

export async function the_video_page_lets_go_while_nobody_sees_it(world) {
  const host = await world.host();
  await create(host.addr, 'stereo/phantom_source', 'host/camera', { width: 64, height: 48 }, { model: 'stream', rate_hz: 10 });
  await start(host.addr, 'host/camera');
  const page = await (await world.browser()).newPage();
  const { open } = calls(page);
  await page.goto(`http://${host.addr}/video`);
  const shown = async () => Number(await page.locator('[data-picture-of]').getAttribute('data-shown'));
  await eventually('the video runs', async () => (await shown()) > 3);
  holds(open().includes('Subscribe') && open().includes('Watch'), `what streams: ${open()}`);
  await seen(page, false);
  await eventually('all calls end', () => open().length === 0);
  const had = await shown();
  await seen(page, true);
  await eventually('the video goes on', async () => (await shown()) > had + 3);
}
