/// Whether people without a mouse, or who hear the page instead of seeing it, can use it: judged by axe-core, view by view.
import fs from 'node:fs';
import { createRequire } from 'node:module';
import { odd, small } from './letters.mjs';
import { box, connect, create, eventually, grpcurl, is, reveal, settled, start } from './world.mjs';

const AXE = fs.readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8');

/// The findings of axe in this view (rule, severity, first places), letters below 11 px, and signs that a font
/// may lack.
async function wrong(page, view) {
  // Sent by the driver: the page's policy lets in no script that is not its own.
  if (!(await page.evaluate(() => 'axe' in window))) await page.evaluate(AXE);
  const { violations, passes } = await page.evaluate(() => window.axe.run(document, { resultTypes: ['violations'] }));
  if (passes.length < 10) throw new Error(`${view}: axe looked at nothing: ${passes.length} rules passed`);
  return [
    ...violations.map((v) => `${view}: ${v.id} (${v.impact}): ${v.help}: ${v.nodes.length} × ${v.nodes.slice(0, 3).map((n) => `${n.html.slice(0, 160)} ${n.any[0]?.message ?? ''}`).join(' | ')}`),
    ...(await small(page)).map((s) => `${view}: small letters: ${s}`),
    ...(await odd(page)).map((c) => `${view}: a sign that a font may lack: ${c}`),
  ];
}

async function every_view(world, scheme) {
  // The recording lies in the test's directory.
  const host = await world.host('host', [], { cwd: world.dir });
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'echo', 'host/echo');
  await connect(host.addr, 'host/echo/sample', 'host/sine/value');
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr, '', { colorScheme: scheme, reducedMotion: 'reduce' });
  await settled(page);
  const edge = page.locator('[data-connection="host/sine/value → host/echo/sample"]');
  await eventually('figures stand on the edge', async () => /\d\/s/.test(await edge.innerText()));
  const found = await wrong(page, 'graph');
  const look = async (view) => found.push(...(await wrong(page, view)));
  await page.keyboard.press('p');
  await page.locator('.palette').waitFor();
  await look('palette');
  await page.keyboard.press('p');
  await box(page, 'host/sine').locator('header').click();
  await page.locator('.inspector').waitFor();
  for (const tab of ['Overview', 'Interfaces', 'Configure', 'Invoke']) {
    await page.getByRole('tab', { name: tab }).click();
    await look(tab);
  }
  // A structure with every kind of field, as fields and as JSON.
  await create(host.addr, 'fixture-conform/Server', 'host/server');
  await reveal(page, 'host/server');
  await page.getByRole('tab', { name: 'Invoke' }).click();
  await page.getByLabel('Command').selectOption('ctl/mirror');
  await page.getByRole('button', { name: 'add to list' }).click();
  await page.locator('#argument\\/list\\/0').fill('far');
  await look('Invoke of a structure');
  await page.getByRole('button', { name: 'all as JSON' }).click();
  await look('Invoke as JSON');
  await box(page, 'host/sine').locator('header').click();
  await page.getByRole('tab', { name: 'Interfaces' }).click();
  await page.locator('[data-plot="host/sine/value#value"]').evaluate((e) => { e.closest('details').open = true; });
  await page.locator('[data-plot="host/sine/value#value"]').click();
  await page.locator('[data-curve]').waitFor();
  await look('plot');
  await page.getByLabel('A number that is chosen goes into').selectOption('1');
  await page.locator('[data-plot="host/sine/value#stamp"]').click();
  await page.locator('[data-curve]').nth(1).waitFor();
  await page.getByRole('button', { name: 'Settings', exact: true }).click();
  await page.locator('[data-tuning="host/sine"] [type=range]').waitFor();
  await page.getByRole('textbox', { name: 'frequency_hz, as a number' }).fill('600');
  await page.getByRole('textbox', { name: 'frequency_hz, as a number' }).press('Enter');
  await page.locator('[data-tuning] .refusal').waitFor();
  await look('two curves beside settings');
  for (const dock of ['Pictures', 'Events', 'Log']) {
    await page.getByRole('button', { name: dock, exact: true }).click();
    await look(dock);
  }
  await edge.click();
  await page.locator('.inspector dt', { hasText: 'carrier' }).waitFor();
  await look('connection');
  await edge.click({ button: 'right' });
  await page.getByRole('menuitem', { name: 'Disconnect' }).waitFor();
  await look('menu of a connection');
  await page.keyboard.press('Escape');
  await page.locator('.svelte-flow__node-process[data-id="process:host"]').focus();
  await look('process with the keyboard');
  await page.keyboard.press('Enter');
  await page.locator('[data-process-panel=host]').waitFor();
  await look('process');
  await page.locator('.svelte-flow__node-process[data-id="process:host"]').focus();
  await page.keyboard.press('Shift+F10');
  await page.getByRole('menuitem', { name: /^Start all/ }).waitFor();
  await look('menu of a process');
  await page.getByRole('menuitem', { name: /^Create component/ }).click();
  await page.locator('[data-create]').waitFor();
  await look('create without a class');
  await page.locator('[data-create]').getByLabel('Class').selectOption('recorder/recorder');
  await page.locator('[data-create] [data-part=configuration]').evaluate((e) => { e.open = true; });
  await page.locator('[data-create] [id^="new/"]').first().waitFor();
  await page.locator('[data-create]').getByLabel('jpeg_quality', { exact: true }).fill('101');
  await look('create');
  await page.getByRole('button', { name: 'Create', exact: true }).click();
  await page.locator('[data-create] .refusal').waitFor();
  await look('create, refused');
  await page.keyboard.press('Escape');
  await box(page, 'host/sine').locator('header').click({ button: 'right' });
  await page.getByRole('menuitem', { name: /^Stop/ }).waitFor();
  await look('menu');
  await page.getByRole('menuitem', { name: /^Remove/ }).click();
  await page.getByText('This would be done:').waitFor();
  await look('remove');
  await page.keyboard.press('Escape');
  await box(page, 'host/echo').locator('header').click({ button: 'right' });
  await page.getByRole('menuitem', { name: /^Connect to/ }).click();
  await page.locator('[data-connect]').waitFor();
  await look('connect');
  await page.keyboard.press('Escape');
  await page.locator('[data-recording]').click();
  await page.getByLabel('Patterns').fill('host/sine/value\nnobody');
  await page.locator('[data-nothing]').waitFor();
  await page.locator('[data-matched]').evaluate((e) => { e.open = true; });
  await look('record, with a pattern that matches nothing');
  await page.getByLabel('Patterns').fill('host/sine/value');
  await page.locator('[data-nothing]').waitFor({ state: 'detached' });
  await page.getByLabel('File').fill('looked-at.mcap');
  await page.getByRole('button', { name: 'Start', exact: true }).click();
  await page.locator('[data-recorder][data-phase=RECORDING]').waitFor();
  await look('recording');
  await page.getByRole('button', { name: 'Stop', exact: true }).click();
  await page.locator('[data-recorder][data-phase=ENDED]').waitFor();
  await look('recorded');
  await page.keyboard.press('Escape');
  await page.keyboard.press('Control+k');
  await page.getByRole('combobox', { name: 'search' }).fill('s');
  await look('search');
  is(found, [], `what is wrong with the page in ${scheme}`);
}

export const nothing_is_wrong_for_screen_readers_and_weak_eyes_in_light = (world) => every_view(world, 'light');
export const nothing_is_wrong_for_screen_readers_and_weak_eyes_in_dark = (world) => every_view(world, 'dark');

export async function what_is_read_only_stopped_faulted_or_away_can_be_read_in_both_themes(world) {
  const gcm = await world.gcm();
  await world.host('left', ['--gcm', gcm.addr]);
  const right = await world.host('right', ['--gcm', gcm.addr]);
  for (const path of ['left/ready', 'left/stopped', 'right/lost']) await create(gcm.addr, 'sine', path);
  await create(gcm.addr, 'fixture-chaos/chaos', 'left/chaos', { panic_in: 'step' }, { model: 'periodic', rate_hz: 10 });
  await start(gcm.addr, 'left/stopped', 'left/chaos', 'right/lost');
  await grpcurl(gcm.addr, 'GcmService/Stop', { path: 'left/stopped' });
  const pages = [];
  for (const scheme of ['light', 'dark']) pages.push(await world.viewer(gcm.addr, '?readonly', { colorScheme: scheme, reducedMotion: 'reduce' }));
  right.kill('SIGKILL');
  const found = [];
  for (const [n, page] of pages.entries()) {
    await page.locator('[data-process=right][data-standing=lost]').waitFor();
    await page.locator('.tally', { hasText: '1 in FAULT' }).waitFor();
    await settled(page);
    await box(page, 'left/chaos').locator('header').click();
    await page.locator('.inspector').waitFor();
    found.push(...(await wrong(page, `states ${n}`)));
  }
  gcm.kill('SIGKILL');
  for (const [n, page] of pages.entries()) {
    await page.locator('[data-banner]').waitFor();
    found.push(...(await wrong(page, `away ${n}`)));
  }
  is(found, [], 'what is wrong in light (0) and dark (1)');
}

export async function the_video_page_is_as_accessible(world) {
  const demo = await world.demo();
  const context = await world.browser();
  const page = await context.newPage();
  await page.goto(`http://${demo.addr}/video`);
  await eventually('the video runs', async () => Number(await page.locator('[data-picture-of]').getAttribute('data-shown')) > 2);
  is(await wrong(page, 'video'), [], 'what is wrong with the video page');
}
