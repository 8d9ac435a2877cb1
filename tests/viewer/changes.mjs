/// Changes made from a page are taken back and done again there; the system is saved from it.
import fs from 'node:fs';
import { box, create, eventually, grpcurl, holds, is, menu, settled, shot, start, state } from './world.mjs';

const LINE = '[data-connection="host/sine/value → host/echo/sample"]';
const named = (page, name) => page.getByRole('button', { name, exact: true });
const connections = async (addr) => ((await grpcurl(addr, 'GcmService/List', {})).connections ?? []).map((c) => `${c.server} → ${c.client} ${c.options?.queue?.fifo ?? ''}`);
const config = async (addr, p) => (await grpcurl(addr, 'GcmService/GetState', { path: p })).component.config;
const there = async (addr, p) => ((await grpcurl(addr, 'GcmService/List', {})).components ?? []).some((c) => c.path === p);

/// host/sine runs at 3 Hz and feeds host/echo through a queue.
async function opened(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine', { frequency_hz: 3 });
  await create(host.addr, 'echo', 'host/echo');
  await grpcurl(host.addr, 'GcmService/Connect', { client: 'host/echo/sample', server: 'host/sine/value', options: { queue: { fifo: 7 } } });
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  await page.locator(LINE).filter({ hasText: '/s' }).waitFor();
  return { host, page };
}

export async function what_was_changed_here_is_taken_back_and_done_again(world) {
  const { host, page } = await opened(world);
  const [undo, redo] = [named(page, 'Undo'), named(page, 'Redo')];
  holds((await undo.isDisabled()) && (await redo.isDisabled()), 'nothing was changed yet');
  // A connection, with the options it had.
  await page.locator(LINE).click({ button: 'right' });
  await page.getByRole('menuitem', { name: 'Disconnect' }).click();
  await page.locator(LINE).waitFor({ state: 'detached' });
  const taken = 'Disconnect host/echo/sample from host/sine/value (Ctrl-Z)';
  await eventually('what would be taken back is told', async () => (await undo.getAttribute('title')) === taken);
  await undo.click();
  await page.locator(LINE).waitFor();
  is(await connections(host.addr), ['host/sine/value → host/echo/sample 7'], 'connections');
  await redo.click();
  await page.locator(LINE).waitFor({ state: 'detached' });
  await page.keyboard.press('Control+z');
  await page.locator(LINE).waitFor();
  // A setting; what somebody else changed meanwhile stays.
  await menu(page, 'host/sine', 'Configure…');
  await page.getByLabel(/^frequency_hz/).fill('5');
  await named(page, 'Configure').click();
  await eventually('it is configured', async () => (await config(host.addr, 'host/sine')).frequency_hz === 5);
  await grpcurl(host.addr, 'GcmService/Configure', { path: 'host/sine', config: { amplitude: 4 } });
  await undo.click();
  await eventually('it is as before', async () => (await config(host.addr, 'host/sine')).frequency_hz === 3);
  is((await config(host.addr, 'host/sine')).amplitude, 4, 'what somebody else set');
  await page.locator('header.top h1').click();
  await page.keyboard.press('Control+Shift+Z');
  await eventually('it is changed again', async () => (await config(host.addr, 'host/sine')).frequency_hz === 5);
  // A component comes back with its settings and connections, and at rest.
  await menu(page, 'host/sine', 'Remove…');
  await named(page, 'Remove').click();
  await box(page, 'host/sine').waitFor({ state: 'detached' });
  await undo.click();
  await page.locator(LINE).waitFor();
  is([await state(host.addr, 'host/sine'), (await config(host.addr, 'host/sine')).frequency_hz], ['READY', 5], 'the component');
  is(await connections(host.addr), ['host/sine/value → host/echo/sample 7'], 'connections');
  await shot(page, 'undone');
  await redo.click();
  await box(page, 'host/sine').waitFor({ state: 'detached' });
}

export async function what_cannot_be_taken_back_says_why_and_stays(world) {
  const host = await world.host();
  const page = await world.viewer(host.addr);
  await named(page, 'Palette').click();
  await page.locator('[data-class="sine/sine"]').click();
  await named(page, 'Create').click();
  await box(page, 'host/sine').waitFor();
  const undo = named(page, 'Undo');
  await start(host.addr, 'host/sine');
  await box(page, 'host/sine').locator('[data-state]', { hasText: 'ACTIVE' }).waitFor();
  await undo.click();
  await page.locator('[data-note]', { hasText: /Undo Create host\/sine: .*ACTIVE/ }).waitFor();
  holds(await there(host.addr, 'host/sine'), 'nothing that runs is taken away');
  holds(!(await undo.isDisabled()) && (await named(page, 'Redo').isDisabled()), 'it can be tried again');
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/sine' });
  await box(page, 'host/sine').locator('[data-state]', { hasText: 'STOPPED' }).waitFor();
  await undo.click();
  await box(page, 'host/sine').waitFor({ state: 'detached' });
  await named(page, 'Redo').click();
  await box(page, 'host/sine').waitFor();
  // A new change leaves nothing to do again.
  await undo.click();
  await box(page, 'host/sine').waitFor({ state: 'detached' });
  await page.locator('[data-class="sine/sine"]').click();
  await named(page, 'Create').click();
  await box(page, 'host/sine').waitFor();
  // The box comes by the Watch, and may be there before the answer to Create.
  await eventually('nothing is left to do again', () => named(page, 'Redo').isDisabled());
}

export async function the_system_is_saved_as_a_file(world) {
  const { host, page } = await opened(world);
  const coming = page.waitForEvent('download');
  await named(page, 'Save').click();
  const download = await coming;
  is(download.suggestedFilename(), 'system.json', 'the file');
  const text = fs.readFileSync(await download.path(), 'utf8');
  is(text, (await grpcurl(host.addr, 'GcmService/Save', {})).text, 'what is in it');
  holds(/"host\/sine": \{ "class": "sine\/sine", "config": \{ "frequency_hz": 3 \} \}/.test(text), text);
  await page.locator('[data-note]', { hasText: 'Saved as system.json' }).waitFor();
  is((await grpcurl(host.addr, 'GcmService/Compare', { system: text })).differences ?? [], [], 'differences');
}
