/// /video: which stream is shown, and how large.
import { create, eventually, holds, is, shot, start } from './world.mjs';

export async function another_stream_is_chosen_and_the_picture_fills_the_screen(world) {
  const host = await world.host();
  for (const [name, width] of [['narrow', 64], ['wide', 96]]) {
    await create(host.addr, 'stereo/phantom_source', `host/${name}`, { width, height: 48 }, { model: 'stream', rate_hz: 10 });
  }
  await start(host.addr, 'host/**');
  const page = await (await world.browser()).newPage();
  await page.goto(`http://${host.addr}/video?path=host/narrow/image`);
  const picture = page.locator('[data-picture-of]');
  const runs = async (of, wide) => eventually(`${of} runs`, async () => {
    if ((await picture.getAttribute('data-picture-of')) !== of || Number(await picture.getAttribute('data-shown')) < 3) return false;
    return (await picture.locator('canvas').evaluate((c) => c.width)) === wide;
  });
  await runs('host/narrow/image', 64);
  const choice = page.getByLabel('output');
  await eventually('what may be chosen', async () => (await choice.locator('option').allInnerTexts()).filter((o) => /^host\/(narrow|wide)\/image$/.test(o)).join() === 'host/narrow/image,host/wide/image');
  is(await choice.inputValue(), 'host/narrow/image', 'what is chosen');
  await choice.selectOption('host/wide/image');
  await runs('host/wide/image', 96);
  is(await page.title(), 'host/wide/image · trocar video', 'title');

  const eye = page.getByLabel('eye');
  is(await eye.inputValue(), 'left', 'the eye that is shown first');
  await eye.selectOption('both');
  await runs('host/wide/image', 2 * 96);
  await eye.selectOption('right');
  await runs('host/wide/image', 96);

  const full = () => page.evaluate(() => document.fullscreenElement !== null);
  const button = page.getByRole('button', { name: 'full screen' });
  await button.click();
  await eventually('it fills the screen', full);
  const [width, seen] = await page.evaluate(() => [document.querySelector('[data-picture-of]').getBoundingClientRect().width, innerWidth]);
  holds(width === seen, `the picture is as wide as the window: ${width} of ${seen}`);
  await shot(page, 'video-full-screen');
  await button.click();
  await eventually('it does no more', async () => !(await full()));
  await runs('host/wide/image', 96);
}

export async function an_address_names_the_eye(world) {
  const host = await world.host();
  await create(host.addr, 'stereo/phantom_source', 'host/pair', { width: 64, height: 48 }, { model: 'stream', rate_hz: 10 });
  await start(host.addr, 'host/**');
  const page = await (await world.browser()).newPage();
  await page.goto(`http://${host.addr}/video?path=host/pair/image&eye=both`);
  const canvas = page.locator('[data-picture-of="host/pair/image"] canvas');
  await eventually('both images are shown', async () => (await canvas.count()) === 1 && (await canvas.evaluate((c) => c.width)) === 2 * 64);
  is(await page.getByLabel('eye').inputValue(), 'both', 'the eye that is shown');
}
