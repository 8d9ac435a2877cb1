/// /video: which stream is shown, and how large.
import fs from 'node:fs';
import path from 'node:path';
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

/// A folder with one pair: the left image is black, the right one white.
async function blackAndWhite(page, folder) {
  fs.mkdirSync(folder);
  for (const [eye, light] of [['left', 'black'], ['right', 'white']]) {
    const png = await page.evaluate((style) => {
      const canvas = Object.assign(document.createElement('canvas'), { width: 64, height: 48 });
      const drawing = canvas.getContext('2d');
      drawing.fillStyle = style;
      drawing.fillRect(0, 0, 64, 48);
      return canvas.toDataURL('image/png').split(',')[1];
    }, light);
    fs.writeFileSync(path.join(folder, `${eye}1.png`), Buffer.from(png, 'base64'));
  }
  return folder;
}

export async function an_address_and_a_menu_name_the_eye(world) {
  const host = await world.host();
  const page = await (await world.browser()).newPage();
  const directory = await blackAndWhite(page, path.join(world.dir, 'pairs'));
  await create(host.addr, 'stereo/image_source', 'host/pair', { directory }, { model: 'stream', rate_hz: 10 });
  await start(host.addr, 'host/**');
  await page.goto(`http://${host.addr}/video?path=host/pair/image&eye=both`);
  /// Brightness at a quarter and at three quarters of the width, of a picture this wide.
  const lights = (width) => page.locator('[data-picture-of="host/pair/image"] canvas').evaluate((c, wide) => {
    const at = (part) => c.getContext('2d').getImageData(c.width * part, c.height / 2, 1, 1).data[0];
    return c.width === wide ? [at(0.25), at(0.75)].map((light) => (light > 200 ? 'white' : light < 50 ? 'black' : light)).join() : `${c.width} px`;
  }, width);
  const shows = async (eye, width, expected) => {
    await eventually(`${eye} shows ${expected}`, async () => (await lights(width)) === expected, () => lights(width));
    is(await page.getByLabel('eye').inputValue(), eye, 'the eye that is chosen');
  };
  await shows('both', 2 * 64, 'black,white');
  await page.getByLabel('eye').selectOption('left');
  await shows('left', 64, 'black,black');
  await page.getByLabel('eye').selectOption('right');
  await shows('right', 64, 'white,white');
  for (const unknown of ['third', 'toString']) {
    await page.goto(`http://${host.addr}/video?path=host/pair/image&eye=${unknown}`);
    await page.getByText(`eye=${unknown}: it is left, right or both`).waitFor();
    await shows('left', 64, 'black,black');
  }
}
