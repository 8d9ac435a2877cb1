/// The page itself: where it is, search, light and dark, the keyboard.
import fs from 'node:fs';
import path from 'node:path';
import { box, connect, create, eventually, grpcurl, holds, is, PLUGINS, settled, shot, start, state } from './world.mjs';

export async function search_finds_components_ports_and_states(world) {
  const host = await world.host();
  for (const n of [1, 2]) await create(host.addr, 'sine', `host/s${n}`);
  await create(host.addr, 'echo', 'host/echo');
  await start(host.addr, 'host/s2');
  const page = await world.viewer(host.addr);
  await settled(page);
  await page.keyboard.press('Control+k');
  const found = () => page.locator('#found li b').allInnerTexts();
  for (const [typed, wanted] of [['active', ['host/s2']], ['sample_out', ['host/echo/sample_out']], ['nobody', []]]) {
    await page.getByRole('combobox', { name: 'search' }).fill(typed);
    await eventually(`${typed} finds ${wanted}`, async () => JSON.stringify(await found()) === JSON.stringify(wanted));
  }
  await page.getByRole('combobox', { name: 'search' }).fill('s');
  await shot(page, 'search');
  await page.getByRole('combobox', { name: 'search' }).fill('host/s1');
  await page.keyboard.press('Enter');
  await page.locator('.inspector strong', { hasText: 'host/s1' }).waitFor();
  is(await page.locator('.search').count(), 0, 'open searches');
}

export async function dark_and_light_are_both_legible_and_remembered(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const page = await world.viewer(host.addr, '', { colorScheme: 'dark' });
  await settled(page);
  const contrast = () => page.evaluate(() => {
    const light = (c) => { const [r, g, b] = c.match(/[\d.]+/g).map(Number).map((v) => (v / 255 <= 0.03928 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4)); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
    const e = document.querySelector('.component');
    const [a, b] = [light(getComputedStyle(e).color), light(getComputedStyle(e).backgroundColor)].sort((x, y) => y - x);
    return (a + 0.05) / (b + 0.05);
  });
  const theme = () => page.evaluate(() => document.documentElement.dataset.theme);
  is(await theme(), 'dark', 'as the system is set');
  holds((await contrast()) > 7, `dark: contrast ${await contrast()}`);
  await shot(page, 'dark');
  await page.getByRole('button', { name: 'light mode' }).click();
  await eventually('it is light and legible', async () => (await theme()) === 'light' && (await contrast()) > 7, contrast);
  await page.reload();
  await box(page, 'host/sine').waitFor();
  is(await theme(), 'light', 'after loading again');
}

export async function everything_is_reached_by_keys_alone(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const page = await world.viewer(host.addr);
  await settled(page);
  await page.locator('.svelte-flow__node-component').focus();
  await page.keyboard.press('Shift+F10');
  await page.getByRole('menuitem', { name: /^Start/ }).waitFor();
  await page.keyboard.press('Enter');
  await eventually('it runs', async () => (await state(host.addr, 'host/sine')) === 'ACTIVE');
  await page.locator('.svelte-flow__node-component').focus();
  await page.keyboard.press('Enter');
  await page.locator('.inspector').waitFor();
  await page.keyboard.press('Escape');
  await page.locator('.inspector').waitFor({ state: 'detached' });
  await page.keyboard.press('p');
  await page.locator('.palette').waitFor();
  await shot(page, 'keys');
  await page.keyboard.press('d');
  is(await page.evaluate(() => document.documentElement.dataset.theme), 'dark', 'theme');
}

export async function processes_and_connections_open_their_menus_by_keys(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'echo', 'host/echo');
  await connect(host.addr, 'host/echo/sample', 'host/sine/value');
  const page = await world.viewer(host.addr);
  await box(page, 'host/echo').waitFor();
  await settled(page);
  const focused = () => page.evaluate(() => document.activeElement?.getAttribute('aria-label') ?? '');
  // Nothing but Tab leads there, from wherever the keyboard is.
  const tabTo = (label) => eventually(`Tab leads to ${label}`, async () => (await focused()) === label || (await page.keyboard.press('Tab'), false));
  const item = () => page.evaluate(() => document.activeElement?.closest('[role=menuitem]')?.querySelector('span').innerText ?? '');
  const goTo = (text) => eventually(`${text} has the keyboard`, async () => (await item()) === text || (await page.keyboard.press('ArrowDown'), false));
  // The way of the Tab key through the graph: processes, components, lines.
  const way = [];
  await tabTo('process host');
  for (let n = 0; n < 40 && way.at(-1) !== 'line'; n += 1) {
    const kind = await page.evaluate(() => ['process', 'component', 'edge'].find((k) => document.activeElement.matches(`.svelte-flow__node-${k}, .svelte-flow__${k}`)));
    if (kind) way.push(kind === 'edge' ? 'line' : kind);
    await page.keyboard.press('Tab');
  }
  is(way, ['process', 'component', 'component', 'line'], 'where Tab leads');
  for (const key of ['Shift+F10', 'ContextMenu']) {
    await tabTo('process host');
    await page.keyboard.press(key);
    await goTo('Stop all of host');
    is(await page.locator('.menu .title').innerText(), 'host', `what ${key} opens the menu of`);
    await page.keyboard.press('Escape');
    await page.locator('.menu').waitFor({ state: 'detached' });
    is(await focused(), 'process host', 'what has the keyboard after the menu');
  }
  await page.keyboard.press('Enter');
  await page.locator('.inspector strong', { hasText: /^process host$/ }).waitFor();
  await page.keyboard.press('Escape');
  await page.locator('.inspector').waitFor({ state: 'detached' });
  await tabTo('process host');
  await shot(page, 'keys-process');
  await page.keyboard.press('Shift+F10');
  await goTo('Start all of host');
  await page.keyboard.press('Enter');
  for (const path of ['host/sine', 'host/echo']) await eventually(`${path} runs`, async () => (await state(host.addr, path)) === 'ACTIVE');

  const line = 'host/sine/value to host/echo/sample';
  await tabTo(line);
  // Who sees the page sees where the keyboard is.
  await eventually('the line stands out', () => page.locator('.svelte-flow__edge:focus-visible .wire').evaluate((e) => getComputedStyle(e).strokeWidth === '4px'));
  await shot(page, 'keys-connection');
  await page.keyboard.press('Enter');
  await page.locator('.inspector strong', { hasText: /^connection / }).waitFor();
  await page.keyboard.press('Escape');
  await page.locator('.inspector').waitFor({ state: 'detached' });
  for (const key of ['Shift+F10', 'ContextMenu']) {
    await tabTo(line);
    await page.keyboard.press(key);
    await goTo('Disconnect');
    if (key === 'Shift+F10') await page.keyboard.press('Escape');
  }
  is((await grpcurl(host.addr, 'GcmService/List', {})).connections.length, 1, 'connections');
  await page.keyboard.press('Enter');
  await page.locator('[data-connection]').waitFor({ state: 'detached' });
  is((await grpcurl(host.addr, 'GcmService/List', {})).connections ?? [], [], 'connections after Disconnect');
}

export async function a_box_that_is_moved_by_arrow_keys_stays_where_it_was_put(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/a');
  const page = await world.viewer(host.addr);
  await box(page, 'host/a').waitFor();
  await settled(page);
  const node = page.locator('.svelte-flow__node[data-id="host/a"]');
  const place = () => node.evaluate((e) => e.style.transform);
  const laid = await place();
  await node.focus();
  await page.keyboard.press('Enter');
  await page.locator('.svelte-flow__node.selected[data-id="host/a"]').waitFor();
  for (let n = 0; n < 3; n += 1) await page.keyboard.press('Shift+ArrowDown');
  await eventually('it moves', async () => (await place()) !== laid);
  const moved = await place();
  // Another layout leaves it there.
  await create(host.addr, 'sine', 'host/b');
  await box(page, 'host/b').waitFor();
  await settled(page);
  is(await place(), moved, 'where it is');
}

export async function whatever_serves_the_page_names_its_address_for_scripts(world) {
  const file = path.join(world.dir, 'one.json');
  fs.writeFileSync(file, JSON.stringify({ version: 1, processes: { host: {} }, components: { 'host/sine': { class: 'sine' } }, connections: [] }));
  const at = ['--listen', '127.0.0.1:0', '--json'];
  const plugins = ['--plugins', PLUGINS];
  const programs = {
    host: ['host', ...plugins, '--state', path.join(world.dir, 'h'), ...at],
    gcm: ['gcm', '--state', path.join(world.dir, 'g'), ...at],
    run: ['run', file, ...plugins, ...at],
    up: ['up', file, ...plugins, ...at],
    demo: ['demo', ...plugins, ...at],
  };
  for (const [name, args] of Object.entries(programs)) {
    for (const more of [[], ['--viewer-read-only']]) {
      const program = await world.start([...args, ...more], name);
      const line = program.printed.split('\n').find((l) => l.includes('"listening"'));
      const { viewer } = JSON.parse(line);
      is(viewer, `http://${program.addr}/`, `${name}'s viewer`);
      const page = await (await fetch(viewer)).text();
      is(/<meta name="viewer" content="([^"]*)"/.exec(page)?.[1], more.length ? 'read-only' : 'full', `what ${name} tells its page`);
      program.kill('SIGINT');
      await program.ended;
    }
  }
}
