/// The first day: from `trocar plugin new` to a filter of one's own, changed, plotted beside its input.
import { execFile } from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import { eventually, handle, holds, is, PLUGINS, settled, shot, still } from './world.mjs';

const BIN = process.env.TROCAR_BIN_DIR ?? path.resolve('../../release');
/// The budget of the way: each typed line, edit, click, drag and key of a person is one step.
const STEPS = 20;

/// Runs a command as a person types it, with what a plugin is built of already at hand.
function typed(cwd, program, ...args) {
  const env = {
    ...process.env,
    CARGO_NET_OFFLINE: 'true',
    // The test asks whether it runs, not how fast.
    CARGO_PROFILE_RELEASE_OPT_LEVEL: '0',
    CARGO_BUILD_BUILD_DIR: path.resolve('../readme-build'),
  };
  delete env.CARGO_TARGET_DIR;
  return new Promise((yes, no) => execFile(program, args, { cwd, env, maxBuffer: 16 << 20 }, (error, out, said) => (error ? no(new Error(`${program} ${args.join(' ')}: ${out}${said}`)) : yes(out))));
}

export async function a_filter_of_ones_own_is_changed_built_dropped_connected_and_plotted_beside_its_input(world) {
  const done = [];
  const step = async (what, doing) => { done.push(what); return doing(); };
  const plugins = path.join(world.dir, 'plugins');
  fs.mkdirSync(plugins);
  fs.copyFileSync(path.join(PLUGINS, 'libtrocar_sine.so'), path.join(plugins, 'libtrocar_sine.so'));
  const host = await world.start(['host', '--name', 'host', '--plugins', plugins, '--listen', '127.0.0.1:0', '--state', path.join(world.dir, 'host')], 'host');
  const page = await world.viewer(host.addr, '', { viewport: { width: 1366, height: 768 } });

  await step('trocar plugin new my-filter', () => typed(world.dir, path.join(BIN, 'trocar'), 'plugin', 'new', 'my-filter'));
  const source = path.join(world.dir, 'my-filter/src/lib.rs');
  await step('edit: twice the signal', () => {
    const before = fs.readFileSync(source, 'utf8');
    const after = before.replace('(raw.value - self.latest.value)', '(2.0 * raw.value - self.latest.value)');
    holds(after !== before, 'the template has the line that is changed');
    fs.writeFileSync(source, after);
  });
  await step('cargo build --release', () => typed(path.join(world.dir, 'my-filter'), 'cargo', 'build', '--release'));
  await step('cp … plugins/', () => fs.copyFileSync(path.join(world.dir, 'my-filter/target/release/libmy_filter.so'), path.join(plugins, 'libmy_filter.so')));

  await step('P', () => page.keyboard.press('p'));
  for (const cls of ['sine/sine', 'my-filter/my_filter']) {
    // The class is there by itself, a moment after its file.
    await step(`click ${cls}`, () => page.locator(`[data-class="${cls}"]`).click());
    await step('Create', () => page.getByRole('button', { name: 'Create', exact: true }).click());
    await page.locator('[data-create]').waitFor({ state: 'detached' });
  }
  await step('P', () => page.keyboard.press('p'));
  await page.locator('[data-port="host/my_filter/raw"]').waitFor();
  await settled(page);
  await step('drag value to raw', async () => {
    const [from, to] = [await handle(page, 'host/sine/value'), await handle(page, 'host/my_filter/raw')];
    await page.mouse.move(from.x, from.y);
    await page.mouse.down();
    await page.mouse.move((from.x + to.x) / 2, (from.y + to.y) / 2, { steps: 4 });
    await page.mouse.move(to.x, to.y, { steps: 4 });
    await page.locator('[data-verdict]:not(.bad)', { hasText: 'can be connected' }).waitFor();
    await page.mouse.up();
  });
  await page.locator('[data-connection="host/sine/value → host/my_filter/raw"]').waitFor({ state: 'attached' });
  await step('right click on the process', () => page.locator('[data-process=host] header').click({ button: 'right' }));
  await step('Start all', () => page.getByRole('menuitem', { name: /^Start all/ }).click());
  await page.locator('[data-path="host/my_filter"] [data-state]', { hasText: 'ACTIVE' }).waitFor();

  await step('click on sine', () => page.locator('[data-path="host/sine"] header').click());
  await step('Interfaces', () => page.getByRole('tab', { name: 'Interfaces' }).click());
  const number = (of) => page.locator(`[data-plot="${of}#value"]`);
  const open = (of) => page.locator('details.numbers', { has: number(of) }).locator('summary').click();
  await step('its numbers', () => open('host/sine/value'));
  await step('plot value', () => number('host/sine/value').click());
  await page.locator('[data-figure="1"]').waitFor();
  await step('click on my_filter', async () => { await still(page.locator('[data-path="host/my_filter"]')); await page.locator('[data-path="host/my_filter"] header').click(); });
  await page.locator('.inspector strong', { hasText: 'host/my_filter' }).waitFor();
  await step('its numbers', () => open('host/my_filter/filtered'));
  await step('drag filtered into the plot', () => number('host/my_filter/filtered').dragTo(page.locator('[data-figure="1"] .box')));
  await eventually('both are in one plot', async () => (await page.locator('[data-figure="1"] [data-curve]').count()) === 2);

  // The sine goes to 1, the filter, which is slower than it and doubles, beyond it.
  const highest = {};
  const curves = () => page.locator('[data-curve]').evaluateAll((all) => all.map((e) => [e.dataset.curve, Number(e.dataset.latest)]));
  await eventually('the changed filter shows', async () => {
    for (const [name, value] of await curves()) if (Number.isFinite(value)) highest[name] = Math.max(highest[name] ?? 0, value);
    return Object.keys(highest).length === 2 && highest['host/my_filter/filtered · value'] > 1.6;
  }, () => JSON.stringify(highest));
  holds(highest['host/sine/value · value'] <= 1.000001, `what goes in: ${JSON.stringify(highest)}`);
  await shot(page, 'first-day');
  is(done.length, STEPS, `steps: ${done.join(', ')}`);
}
