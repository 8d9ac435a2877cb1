/// What a designer would see: nothing is covered, cut off or out of sight, and a tone means one thing.
///
/// Invariant: places are measured on the page, in a window of a screen and of a tablet that is touched.
import { interfacesOf, plot } from './following.mjs';
import { box, create, eventually, grpcurl, holds, is, menu, reveal, settled, shot, start, tool } from './world.mjs';

const TABLET = { viewport: { width: 820, height: 1180 }, hasTouch: true };
const SCREEN = { viewport: { width: 1366, height: 768 } };
/// Whether `inner` lies in `outer`, both as `boundingBox` tells them.
const lies = (inner, outer) => inner.x >= outer.x - 0.5 && inner.y >= outer.y - 0.5 && inner.x + inner.width <= outer.x + outer.width + 0.5 && inner.y + inner.height <= outer.y + outer.height + 0.5;
const windowOf = (page) => ({ x: 0, y: 0, ...page.viewportSize() });

export async function the_buttons_of_a_long_form_stay_in_sight_and_only_the_dialog_scrolls(world) {
  const host = await world.host();
  for (const options of [SCREEN, TABLET]) {
    const page = await world.viewer(host.addr, '', options);
    await page.locator('[data-process=host]').waitFor();
    await tool(page, 'Palette');
    await page.locator('[data-class="recorder/recorder"]').click();
    const form = page.locator('[data-create]');
    await form.locator('[id^="new/"]').first().waitFor({ state: 'attached' });
    await form.locator('details').evaluateAll((all) => all.forEach((e) => { e.open = true; }));
    const dialog = page.getByRole('dialog', { name: 'Create a component' });
    await eventually('there is more than the window shows', () => dialog.evaluate((e) => e.scrollHeight > e.clientHeight + 100));
    const button = page.getByRole('button', { name: 'Create', exact: true });
    for (const to of [0, 300, 1e6]) {
      await dialog.evaluate((e, to) => { e.scrollTop = to; }, to);
      holds(lies(await button.boundingBox(), await dialog.boundingBox()) && lies(await dialog.boundingBox(), windowOf(page)), `Create at ${to} px of ${JSON.stringify(options.viewport)}`);
    }
    is(await form.locator('details').evaluateAll((all) => all.filter((e) => /auto|scroll/.test(getComputedStyle(e).overflowY)).length), 0, 'parts that scroll by themselves');
    // What is refused is said above the buttons, not below them.
    await dialog.evaluate((e) => { e.scrollTop = 0; });
    await form.getByLabel('jpeg_quality', { exact: true }).fill('101');
    await button.click();
    const refusal = form.locator('.refusal');
    await refusal.waitFor();
    await eventually('the refusal is seen', async () => { const [r, b] = [await refusal.boundingBox(), await button.boundingBox()]; return r.y > 0 && r.y + r.height <= b.y; }, async () => [await refusal.boundingBox(), await button.boundingBox()]);
    await shot(page, `looks-create-${options.viewport.width}`);
    await page.context().close();
  }
}

export async function what_is_told_stands_over_the_graph_and_covers_no_panel(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  for (const options of [SCREEN, TABLET]) {
    const page = await world.viewer(host.addr, '', options);
    await settled(page);
    await reveal(page, 'host/sine');
    await page.locator('.inspector').waitFor();
    await tool(page, 'Log');
    await page.locator('.dock').waitFor();
    await tool(page, 'Save');
    const note = page.locator('[data-note]', { hasText: 'Saved as system.json' });
    await note.waitFor();
    holds(lies(await note.boundingBox(), await page.locator('main').boundingBox()), `a note over the graph: ${JSON.stringify(await note.boundingBox())}`);
    await shot(page, `looks-note-${options.viewport.width}`);
    await page.context().close();
  }
}

export async function a_tablet_has_room_for_curves_pictures_and_triangles(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  for (const n of [1, 2, 3]) await create(host.addr, 'stereo/phantom_source', `host/camera${n}`, { width: 64, height: 48 }, { model: 'stream', rate_hz: 5 });
  await start(host.addr, 'host/sine');
  const page = await world.viewer(host.addr, '', TABLET);
  await settled(page);
  const bar = await page.locator('.top').boundingBox();
  for (const button of await page.locator('.tools > button').all()) {
    const b = await button.boundingBox();
    holds(b.y - bar.y >= 4 && bar.y + bar.height - b.y - b.height >= 4, `a button of the top has air around it: ${JSON.stringify([b, bar])}`);
  }
  await interfacesOf(page, 'host/sine');
  const summary = page.locator('.inspector summary').first();
  is(await summary.evaluate((e) => getComputedStyle(e).display), 'list-item', 'a part that opens has its triangle');
  for (const number of ['value', 'stamp']) await plot(page, 'host/sine/value', number);
  // Its axes and their numbers are in the window, beside a panel and without one.
  const inside = async () => { const [b, d] = [await page.locator('[data-figure="1"]').boundingBox(), await page.locator('.dock').boundingBox()]; return b.y + b.height <= d.y + d.height + 0.5; };
  await eventually('the plot has room beside the panel', inside);
  await page.keyboard.press('Escape');
  await page.locator('.inspector').waitFor({ state: 'detached' });
  await eventually('the plot has room without it', inside);
  const seen = async () => { const [b, d] = [await page.locator('[data-figure="1"] .box').boundingBox(), await page.locator('.dock').boundingBox()]; return Math.min(b.y + b.height, d.y + d.height) - b.y; };
  await eventually('the curves are seen beside their buttons', async () => (await seen()) >= 110, seen);
  await shot(page, 'looks-tablet-plots');
  for (const n of [1, 2, 3]) await menu(page, `host/camera${n}`, 'Show pictures of image');
  await page.locator('[data-picture-of]').nth(2).waitFor();
  is(await page.locator('.pictures').evaluate((e) => e.scrollWidth > e.clientWidth), false, 'pictures beyond the edge');
  await shot(page, 'looks-tablet-pictures');
}

export async function sixty_components_fill_a_tall_window_in_the_order_of_their_numbers(world) {
  const host = await world.host();
  await grpcurl(host.addr, 'GcmService/Apply', { steps: Array.from({ length: 60 }, (_, n) => ({ create: { path: `host/s${n}`, class: 'sine', execution: { model: 'none' } } })) });
  const page = await world.viewer(host.addr, '', TABLET);
  await settled(page);
  const process = await page.locator('[data-process=host]').boundingBox();
  holds(process.width > 820 * 0.6 && process.height > 1180 * 0.5, `the picture fills the window: ${JSON.stringify(process)}`);
  const places = await page.locator('[data-path]').evaluateAll((all) => all.map((e) => ({ n: Number(e.dataset.path.slice('host/s'.length)), x: e.getBoundingClientRect().x, y: Math.round(e.getBoundingClientRect().y) })));
  const read = places.sort((a, b) => a.y - b.y || a.x - b.x).map((p) => p.n);
  is(read, Array.from({ length: 60 }, (_, n) => n), 'as they are read');
  await shot(page, 'looks-sixty');
}

export async function an_empty_process_shows_its_pid_whole_and_one_event_is_one_event(world) {
  const host = await world.host();
  const page = await world.viewer(host.addr, '', TABLET);
  const pid = page.locator('[data-process=host] .pid');
  await pid.waitFor();
  is(await pid.evaluate((e) => e.scrollWidth <= e.clientWidth + 1 && e.getBoundingClientRect().right <= e.closest('[data-process]').getBoundingClientRect().right - 8), true, 'a whole pid');
  await create(host.addr, 'example/Server', 'host/Server');
  await start(host.addr, 'host/Server');
  await settled(page);
  await interfacesOf(page, 'host/Server');
  const stands = page.waitForResponse((r) => r.url().endsWith('InteractService/Subscribe'));
  await page.locator('[data-follow="host/Server/Provided/SetPointReached"]').click();
  await stands;
  const told = page.locator('[data-list=events] .count');
  await told.filter({ hasText: /^0 events, / }).waitFor();
  await grpcurl(host.addr, 'InteractService/Invoke', { path: 'host/Server/Provided/Write', json: 30 });
  await told.filter({ hasText: /^1 event, / }).waitFor();
}

export async function what_cannot_be_connected_is_said_without_alarm(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'echo', 'host/echo');
  const page = await world.viewer(host.addr, '', SCREEN);
  await settled(page);
  await menu(page, 'host/echo', 'Connect to');
  const why = page.locator('[data-connect] .why').first();
  await why.waitFor();
  const colours = await why.evaluate((e) => {
    const alarm = document.body.appendChild(Object.assign(document.createElement('p'), { className: 'refusal' }));
    return [getComputedStyle(e).color, getComputedStyle(alarm).color];
  });
  holds(colours[0] !== colours[1], `the colour of what has failed: ${colours}`);
  const heavy = await page.locator('[data-connect] label :is(select, input)').evaluateAll((all) => all.map((e) => getComputedStyle(e).fontWeight));
  is(heavy, ['400', '400'], 'what is entered is not as bold as its name');
  await page.keyboard.press('Escape');
  await box(page, 'host/echo').waitFor();
}

export async function a_component_that_is_stopped_has_a_name_in_ink_whole_ports_and_its_reason(world) {
  const host = await world.host();
  for (const name of ['ready', 'stopped']) await create(host.addr, 'sine', `host/${name}`);
  await start(host.addr, 'host/stopped');
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/stopped' });
  const page = await world.viewer(host.addr, '', SCREEN);
  await settled(page);
  const looks = (name) => box(page, `host/${name}`).evaluate((e) => [getComputedStyle(e).overflow, getComputedStyle(e.querySelector('strong')).color]);
  is(await looks('stopped'), await looks('ready'), 'what is cut off, and the colour of the name');
  const state = box(page, 'host/stopped').locator('[data-state]');
  is([await state.innerText(), await state.evaluate((e) => e.scrollWidth <= e.clientWidth)], ['STOPPED requested', true], 'state and reason');
}

export async function the_buttons_of_video_are_in_a_narrow_window_and_large_enough_for_a_finger(world) {
  const host = await world.host();
  await create(host.addr, 'stereo/phantom_source', 'host/a_camera_with_a_long_name', { width: 64, height: 48 }, { model: 'stream', rate_hz: 5 });
  await start(host.addr, 'host/**');
  for (const [options, least] of [[{ viewport: { width: 300, height: 600 } }, 28], [TABLET, 44]]) {
    const page = await (await world.browser(options)).newPage();
    await page.goto(`http://${host.addr}/video`);
    await eventually('the video runs', async () => Number(await page.locator('[data-picture-of]').getAttribute('data-shown')) > 2);
    for (const one of await page.locator('nav > *').all()) {
      const b = await one.boundingBox();
      holds(lies(b, windowOf(page)) && b.height >= least - 0.5, `${await one.evaluate((e) => e.outerHTML.slice(0, 60))}: ${JSON.stringify(b)}`);
    }
    await shot(page, `looks-video-${options.viewport.width}`);
    await page.context().close();
  }
}
