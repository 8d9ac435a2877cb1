/// Processes on the page: how one ended, what is said of it, and the ways back.
import fs from 'node:fs';
import path from 'node:path';
import { box, create, eventually, grpcurl, holds, is, PLUGINS, settled, shot, start, twoProcesses } from './world.mjs';

const process = (page, name) => page.locator(`[data-process="${name}"]`);
const panelOf = (page, name) => page.locator(`[data-process-panel="${name}"]`);
const pidOf = async (addr, name) => (await grpcurl(addr, 'GcmService/List', { brief: true })).processes.find((p) => p.name === name)?.pid;
const items = (page) => page.getByRole('menuitem').evaluateAll((all) => all.map((e) => e.querySelector('span').innerText));

/// Two processes that `trocar up` keeps; `restart` is the policy of `right`.
async function up(world, restart) {
  const file = path.join(world.dir, 'two.json');
  const each = { plugins: [PLUGINS] };
  fs.writeFileSync(file, JSON.stringify({
    version: 1,
    processes: { left: each, right: { ...each, restart } },
    components: { 'left/sine': { class: 'sine' }, 'right/echo': { class: 'echo' } },
    connections: [{ client: 'right/echo/sample', server: 'left/sine/value' }],
  }));
  const program = await world.start(['up', file, '--listen', '127.0.0.1:0', '--json'], 'up');
  await eventually('both are there', async () => (await pidOf(program.addr, 'left')) && (await pidOf(program.addr, 'right')));
  return program;
}

export async function a_killed_process_shows_its_last_end_and_comes_back_by_the_button(world) {
  const { addr } = await up(world, 'never');
  const page = await world.viewer(addr);
  await box(page, 'right/echo').waitFor();
  await process(page, 'right').and(page.locator('[data-standing=attached]')).waitFor();
  await settled(page);
  const before = await pidOf(addr, 'right');
  globalThis.process.kill(before, 'SIGKILL');
  const fate = process(page, 'right').locator('[data-fate]');
  await fate.filter({ hasText: /^(lost|failed) \d+ s ago: killed by SIGKILL/ }).waitFor();
  await box(page, 'right/echo').getByText('process lost').waitFor();
  await process(page, 'right').locator('header').click();
  const panel = panelOf(page, 'right');
  await panel.locator('[data-away]', { hasText: /was killed by SIGKILL/ }).waitFor();
  await panel.locator('dt:text-is("last end") + dd', { hasText: 'killed by SIGKILL' }).waitFor();
  await shot(page, 'process-failed');
  await panel.getByRole('button', { name: 'Restart' }).click();
  await process(page, 'right').and(page.locator('[data-standing=attached]')).waitFor();
  await panel.locator('[data-away]').waitFor({ state: 'detached' });
  await panel.locator('.plugin', { hasText: 'recorder recorder' }).waitFor();
  holds((await pidOf(addr, 'right')) !== before, 'it is another process');
  await box(page, 'right/echo').getByText('process lost').waitFor({ state: 'detached' });
  await page.locator('[data-note]', { hasText: 'Restart right: done' }).waitFor();
  await shot(page, 'process-back');
}

export async function a_lost_process_that_no_supervisor_keeps_says_how_it_comes_back_and_is_forgotten(world) {
  const { gcm, right } = await twoProcesses(world);
  const page = await world.viewer(gcm.addr);
  await box(page, 'right/echo').waitFor();
  await settled(page);
  await process(page, 'right').locator('header').click({ button: 'right' });
  is(await items(page), ['Show process', 'Create component…', 'Start all of right', 'Stop all of right'], 'the menu of a process that is there');
  await page.keyboard.press('Escape');
  right.kill('SIGKILL');
  await process(page, 'right').locator('[data-fate]', { hasText: /^lost \d+ s ago$/ }).waitFor();
  // The component says so, and leads to its process.
  await box(page, 'right/echo').locator('header').click();
  await page.locator('.inspector dt:text-is("process") + dd button', { hasText: /right lost \d+ s ago/ }).click();
  const panel = panelOf(page, 'right');
  await panel.locator('pre', { hasText: `trocar host --name right --gcm ${gcm.addr}` }).waitFor();
  await panel.getByRole('button', { name: 'Restart' }).click();
  await panel.getByRole('alert').filter({ hasText: 'has no supervisor' }).waitFor();
  await shot(page, 'process-lost-panel');
  await process(page, 'right').locator('header').click({ button: 'right' });
  is((await items(page)).slice(-2), ['Restart', 'Forget…'], 'the ways back in its menu');
  await page.getByRole('menuitem', { name: 'Forget…' }).click();
  const question = page.getByRole('dialog', { name: 'Forget process right?' });
  await question.getByText('- remove right/echo').waitFor();
  await shot(page, 'process-forget');
  await question.getByRole('button', { name: 'Forget', exact: true }).click();
  await process(page, 'right').waitFor({ state: 'detached' });
  is((await grpcurl(gcm.addr, 'GcmService/List', { brief: true })).processes.map((p) => p.name), ['left'], 'processes');
}

export async function of_a_process_lost_while_nobody_looked_no_time_is_told(world) {
  const gcm = await world.gcm();
  await world.host('left', ['--gcm', gcm.addr]);
  const right = await world.host('right', ['--gcm', gcm.addr]);
  await create(gcm.addr, 'echo', 'right/echo');
  const context = await world.browser();
  await context.clock.install();
  const page = await context.newPage();
  await page.goto(`http://${gcm.addr}/`);
  await settled(page);
  const seen = (yes) => page.evaluate((yes) => {
    Object.defineProperty(document, 'hidden', { configurable: true, get: () => !yes });
    document.dispatchEvent(new Event('visibilitychange'));
  }, yes);
  await seen(false);
  // For long enough to let go; see UNSEEN in App.svelte.
  await page.clock.fastForward(6000);
  right.kill('SIGKILL');
  await eventually('it is lost', async () => (await grpcurl(gcm.addr, 'GcmService/List', { brief: true })).processes.find((p) => p.name === 'right').state === 'PROCESS_STATE_LOST');
  await seen(true);
  await process(page, 'right').and(page.locator('[data-standing=lost]')).waitFor();
  is(await process(page, 'right').locator('[data-fate]').innerText(), 'lost', 'what is said of it');
}

export async function a_process_is_shown_by_a_click_and_by_keys_and_a_page_that_only_reads_offers_no_way_back(world) {
  const gcm = await world.gcm();
  const right = await world.host('right', ['--gcm', gcm.addr]);
  await create(gcm.addr, 'echo', 'right/echo');
  const page = await world.viewer(gcm.addr, '?readonly');
  await box(page, 'right/echo').waitFor();
  await settled(page);
  const panel = panelOf(page, 'right');
  await page.locator('.svelte-flow__node-process[data-id="process:right"]').focus();
  await page.keyboard.press('Enter');
  await panel.locator('dt:text-is("pid") + dd', { hasText: String(await pidOf(gcm.addr, 'right')) }).waitFor();
  await page.keyboard.press('Escape');
  await panel.waitFor({ state: 'detached' });
  await process(page, 'right').locator('header').click();
  await panel.locator('dt:text-is("since") + dd', { hasText: 'before this page looked' }).waitFor();
  right.kill('SIGKILL');
  await panel.locator('[data-away]', { hasText: 'No supervisor reported how it ended' }).waitFor();
  is(await panel.getByRole('button').allInnerTexts().then((all) => all.filter((text) => /Restart|Forget/.test(text))), [], 'ways back');
}
