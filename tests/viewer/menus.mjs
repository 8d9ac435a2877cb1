/// Menus of connections, processes and the graph, and the Delete key: what is done from them, and that it is done.
import { eventRows } from './following.mjs';
import { box, connect, create, eventually, grpcurl, holds, is, menu, settled, shot, start, state, still } from './world.mjs';

const items = (page) => page.getByRole('menuitem').evaluateAll((all) => all.map((e) => e.querySelector('span').innerText));
const choose = (page, name) => page.getByRole('menuitem', { name, exact: false }).click();
const connections = async (addr) => ((await grpcurl(addr, 'GcmService/List', {})).connections ?? []).length;
const LINE = '[data-connection="host/sine/value → host/echo/sample"]';

/// host/sine runs and is connected to host/echo; the line says what flows, so there is something to point at.
async function connected(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'echo', 'host/echo');
  await connect(host.addr, 'host/echo/sample', 'host/sine/value');
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  await page.locator(LINE).filter({ hasText: '/s' }).waitFor();
  return { host, page };
}

export async function a_connection_is_shown_and_cut_from_its_menu(world) {
  const { host, page } = await connected(world);
  const open = () => page.locator(LINE).click({ button: 'right' });
  const title = page.locator('.inspector strong');
  await open();
  is(await items(page), ['Show connection', 'Show server', 'Show client', 'Disconnect'], 'the menu of a connection');
  is(await page.locator('.menu .title').innerText(), 'host/sine/value → host/echo/sample', 'what the menu is of');
  await shot(page, 'menu-connection');
  for (const [item, shown] of [['Show server', /^host\/sine$/], ['Show client', /^host\/echo$/], ['Show connection', /^connection \d+$/]]) {
    if ((await page.getByRole('menu').count()) === 0) await open();
    await choose(page, item);
    await title.filter({ hasText: shown }).waitFor();
    await still(page.locator(LINE));
  }
  await page.locator('.inspector dt:text-is("server") + dd').filter({ hasText: 'host/sine/value' }).waitFor();
  is(await connections(host.addr), 1, 'connections that were only looked at');
  await open();
  await choose(page, 'Disconnect');
  await page.locator(LINE).waitFor({ state: 'detached' });
  is(await connections(host.addr), 0, 'connections');
  await page.locator('[data-note]', { hasText: 'Disconnect host/echo/sample from host/sine/value: done' }).waitFor();
}

export async function a_connection_is_cut_from_its_details(world) {
  const { host, page } = await connected(world);
  await page.locator(LINE).click();
  await page.locator('.inspector strong', { hasText: /^connection \d+$/ }).waitFor();
  await page.locator('.inspector').getByRole('button', { name: 'Disconnect' }).click();
  await page.locator(LINE).waitFor({ state: 'detached' });
  is(await connections(host.addr), 0, 'connections');
  await page.locator('.inspector', { hasText: 'It no longer exists.' }).waitFor();
}

export async function all_of_a_process_is_started_and_stopped_from_its_menu_and_nothing_else(world) {
  const gcm = await world.gcm();
  await world.host('left', ['--gcm', gcm.addr]);
  await world.host('right', ['--gcm', gcm.addr]);
  const paths = ['left/a', 'left/b', 'right/c'];
  for (const path of paths) await create(gcm.addr, 'sine', path);
  const page = await world.viewer(gcm.addr);
  await box(page, 'right/c').waitFor();
  await settled(page);
  const open = () => page.locator('[data-process=left] header').click({ button: 'right' });
  const are = async (...wanted) => eventually(`they are ${wanted}`, async () => JSON.stringify(await Promise.all(paths.map((p) => state(gcm.addr, p)))) === JSON.stringify(wanted));
  await open();
  is(await items(page), ['Show process', 'Create component…', 'Start all of left', 'Stop all of left'], 'the menu of a process');
  await shot(page, 'menu-process');
  await choose(page, 'Start all of left');
  await are('ACTIVE', 'ACTIVE', 'READY');
  await start(gcm.addr, 'right/c');
  await open();
  await choose(page, 'Stop all of left');
  await are('STOPPED', 'STOPPED', 'ACTIVE');
  await open();
  await choose(page, 'Create component…');
  const form = page.locator('[data-create]');
  await form.getByLabel('Class').selectOption('sine/sine');
  is(await form.getByLabel(/^Process/).inputValue(), 'left', 'where it would be made');
  await form.getByLabel('Name').fill('made');
  await page.getByRole('button', { name: 'Create', exact: true }).click();
  await box(page, 'left/made').waitFor();
}

export async function the_menu_of_the_graph_creates_arranges_and_searches(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/a');
  await create(host.addr, 'sine', 'host/b');
  const page = await world.viewer(host.addr);
  await box(page, 'host/b').waitFor();
  await settled(page);
  const open = () => page.locator('.svelte-flow__pane').click({ button: 'right', position: { x: 6, y: 6 } });
  await open();
  is(await items(page), ['Create component…', 'Arrange', 'Search'], 'the menu of the graph');
  await shot(page, 'menu-graph');
  await choose(page, 'Search');
  await page.getByRole('combobox', { name: 'search' }).waitFor();
  await page.keyboard.press('Escape');
  await page.locator('.search').waitFor({ state: 'detached' });
  // What a hand has put elsewhere goes back to where the layout wants it.
  const place = () => page.locator('.svelte-flow__node[data-id="host/a"]').evaluate((e) => e.style.transform);
  const laid = await place();
  const at = await still(box(page, 'host/a').locator('header'));
  await page.mouse.move(at.x + 60, at.y + 12);
  await page.mouse.down();
  await page.mouse.move(at.x + 130, at.y + 90, { steps: 6 });
  await page.mouse.up();
  await eventually('it was moved', async () => (await place()) !== laid, place);
  await open();
  await choose(page, 'Arrange');
  await eventually('it is back', async () => (await place()) === laid);
  await open();
  await choose(page, 'Create component…');
  const form = page.locator('[data-create]');
  holds(await page.getByRole('button', { name: 'Create', exact: true }).isDisabled(), 'without a class there is nothing to create');
  await form.getByLabel('Class').selectOption('sine/sine');
  await form.getByLabel('Name').fill('made');
  await page.getByRole('button', { name: 'Create', exact: true }).click();
  await box(page, 'host/made').waitFor();
  is(await state(host.addr, 'host/made'), 'READY', 'state');
}

export async function a_view_that_was_moved_shows_all_of_it_again_when_asked(world) {
  const host = await world.host();
  for (const name of ['a', 'b']) await create(host.addr, 'sine', `host/${name}`);
  const page = await world.viewer(host.addr);
  await box(page, 'host/b').waitFor();
  await settled(page);
  /// How far the middle of the graph is from that of its area, px; where it stands in the middle, all of it is shown.
  const aside = () => page.evaluate(() => {
    const middle = (name) => {
      const { x, y, width, height } = document.querySelector(name).getBoundingClientRect();
      return [x + width / 2, y + height / 2];
    };
    const [[x, y], [to, down]] = ['.svelte-flow__node-process', '.svelte-flow'].map(middle);
    return Math.round(Math.hypot(x - to, y - down));
  });
  await eventually('all of it is shown at first', async () => (await aside()) < 3);
  for (const button of ['fit view', 'Arrange']) {
    await page.mouse.move(750, 860);
    await page.mouse.down();
    await page.mouse.move(900, 700, { steps: 5 });
    await page.mouse.up();
    await eventually('it is moved', async () => (await aside()) > 100);
    await page.getByRole('button', { name: button, exact: true }).click();
    await eventually(`${button} shows all of it`, async () => (await aside()) < 3);
    // A window of another size shows all of it, too, as long as nobody moves it.
    const { width, height } = page.viewportSize();
    await page.setViewportSize({ width: width - 300, height });
    await eventually(`${button}, and then a smaller window`, async () => (await aside()) < 3);
    await page.setViewportSize({ width, height });
    await eventually(`${button}, and then the window as before`, async () => (await aside()) < 3);
  }
}

export async function pictures_are_shown_and_events_followed_from_menus(world) {
  const host = await world.host();
  await create(host.addr, 'stereo/phantom_source', 'host/camera', { width: 64, height: 48 }, { model: 'stream', rate_hz: 10 });
  await create(host.addr, 'example/Server', 'host/Server');
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await box(page, 'host/camera').waitFor();
  await page.locator('[data-port="host/camera/image"]').waitFor();
  await page.locator('[data-port="host/Server/Provided"]').waitFor();
  await settled(page);
  await menu(page, 'host/camera', 'Show pictures of image');
  const shown = page.locator('[data-picture-of="host/camera/image"]');
  await eventually('pictures come', async () => Number(await shown.getAttribute('data-shown')) > 3);
  // Of a port only what is its own.
  await settled(page);
  await page.locator('[data-port="host/Server/Provided"] span').click({ button: 'right' });
  const event = 'host/Server/Provided/SetPointReached';
  await page.getByRole('menuitem', { name: 'Follow event Provided/SetPointReached' }).waitFor();
  const offered = (await items(page)).filter((i) => /^(Follow|Show pictures)/.test(i));
  holds(offered.length >= 2 && offered.every((i) => i.startsWith('Follow event Provided/')), `of that port: ${offered}`);
  await shot(page, 'menu-port');
  const stands = page.waitForResponse((r) => r.url().endsWith('InteractService/Subscribe'));
  await choose(page, 'Follow event Provided/SetPointReached');
  await stands;
  await grpcurl(host.addr, 'InteractService/Invoke', { path: 'host/Server/Provided/Write', json: 30 });
  await eventually('it is listed', async () => JSON.stringify(await eventRows(page)) === JSON.stringify([[event, '30']]));
}

export async function the_delete_key_on_a_component_asks_before_it_is_removed(world) {
  const { host, page } = await connected(world);
  const node = page.locator('.svelte-flow__node-component[data-id="host/echo"]');
  const question = page.getByRole('dialog', { name: 'Remove host/echo?' });
  const ask = async () => {
    await node.focus();
    await page.keyboard.press('Enter');
    await page.locator('.svelte-flow__node-component.selected[data-id="host/echo"]').waitFor();
    await page.keyboard.press('Delete');
    await question.getByText('This would be done:').waitFor();
  };
  await ask();
  await shot(page, 'delete-component');
  await page.keyboard.press('Escape');
  await question.waitFor({ state: 'detached' });
  is([await box(page, 'host/echo').count(), await connections(host.addr)], [1, 1], 'what there is after Escape');
  await ask();
  await question.getByRole('button', { name: 'Remove', exact: true }).click();
  await box(page, 'host/echo').waitFor({ state: 'detached' });
  await page.locator(LINE).waitFor({ state: 'detached' });
  is((await grpcurl(host.addr, 'GcmService/List', {})).components.map((c) => c.path), ['host/sine'], 'components');
}
