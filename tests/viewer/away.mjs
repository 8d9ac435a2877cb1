/// What streams while nobody answers, and after that.
import { go_on, interfacesOf, plot, points } from './following.mjs';
import { box, create, eventually, holds, is, reaches, settled, shot, start } from './world.mjs';

export async function plots_events_and_pictures_go_on_by_themselves_when_the_gcm_is_back(world) {
  const gcm = await world.gcm();
  await world.host('left', ['--gcm', gcm.addr]);
  await create(gcm.addr, 'sine', 'left/sine');
  await create(gcm.addr, 'fixture-torture/server', 'left/events', undefined, { rate_hz: 10 });
  await create(gcm.addr, 'stereo/phantom_source', 'left/camera', { width: 64, height: 48 }, { model: 'stream', rate_hz: 10 });
  await start(gcm.addr, 'left/**');
  const page = await world.viewer(gcm.addr);
  await page.evaluate(() => (window.same = true));
  await box(page, 'left/camera').waitFor();
  await settled(page);
  // A sample, a state row and a read; an event; a picture.
  await interfacesOf(page, 'left/sine');
  await plot(page, 'left/sine/value', 'value');
  await plot(page, 'left/sine', 'latest.value');
  await plot(page, 'left/sine/signal/value', '');
  await interfacesOf(page, 'left/events');
  await page.locator('[data-follow="left/events/ctl/ticked"]').click();
  await interfacesOf(page, 'left/camera');
  await page.locator('[data-picture="left/camera/image"]').click();
  const video = await page.context().newPage();
  await video.goto(`http://${gcm.addr}/video?path=left/camera/image`);

  const dock = (name) => page.getByRole('button', { name, exact: true }).click();
  const shown = async (of) => Number(await of.locator('[data-picture-of="left/camera/image"]').getAttribute('data-shown'));
  const listed = async () => Number(await page.locator('[data-list=events]').getAttribute('data-total'));
  const more = async (what, count, than = undefined) => {
    const had = than ?? (await count());
    await reaches(what, count, had + 4);
  };
  await more('the video runs', () => shown(video));
  await page.bringToFront();
  await more('pictures come', () => shown(page));
  await dock('Events');
  await more('events come', listed);
  await dock('Plots');
  await eventually('three curves are there', async () => (await points(page)).length === 3);
  await reaches('points come', () => points(page), 11);
  await dock('Pictures');

  gcm.kill('SIGKILL');
  await gcm.ended;
  await page.locator('[data-banner]', { hasText: 'does not answer' }).waitFor();
  await video.bringToFront();
  await video.getByRole('alert').filter({ hasText: 'does not answer' }).waitFor();
  await page.bringToFront();
  await shot(page, 'gcm-gone-with-pictures');
  const had = await shown(page);
  await world.gcm(gcm.addr);
  await page.locator('[data-banner]').waitFor({ state: 'detached' });
  await more('pictures go on', () => shown(page), had);
  await dock('Events');
  await more('events go on', listed);
  is(await page.locator('[data-list=events]').getAttribute('data-interrupted'), '1', 'times nobody listened to events');
  const missing = await page.locator('[data-list=events] [role=log] div', { hasText: 'may be missing: nobody listened' }).count();
  is(missing, 1, 'rows that say that some before them may be missing');
  await dock('Plots');
  await go_on(page, 'plots go on');
  const gaps = await page.locator('[data-curve]').evaluateAll((all) => all.map((curve) => Number(curve.dataset.gaps)));
  holds(gaps.length === 3 && gaps.every((n) => n >= 1), `a line leads over the time the GCM was away: ${gaps}`);
  await eventually('nothing is complained of any more', async () => (await page.locator('[data-curve] .refusal').count()) === 0);
  await shot(page, 'gcm-back');
  await video.bringToFront();
  await video.getByRole('alert').waitFor({ state: 'detached' });
  await more('the video goes on', () => shown(video));
  await shot(video, 'video-back');
  holds(await page.evaluate(() => window.same === true), 'the page was not loaded again');
  is(await page.locator('[data-note].bad').allInnerTexts(), [], 'complaints');
}
