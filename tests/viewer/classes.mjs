/// Classes: how they come into the palette, and what is made of them.
import fs from 'node:fs';
import path from 'node:path';
import { box, create, eventually, grpcurl, is, PLUGINS, shot } from './world.mjs';

export async function a_plugin_that_is_dropped_into_the_directory_appears_in_the_palette_by_itself(world) {
  const plugins = path.join(world.dir, 'plugins');
  fs.mkdirSync(plugins);
  const drop = (file) => fs.copyFileSync(path.join(PLUGINS, file), path.join(plugins, file));
  drop('libtrocar_fixture_echo.so');
  const host = await world.start(['host', '--name', 'host', '--plugins', plugins, '--listen', '127.0.0.1:0', '--state', path.join(world.dir, 'host')], 'host');
  const page = await world.viewer(host.addr);
  await page.evaluate(() => (window.same = true));
  await page.getByRole('button', { name: 'Palette' }).click();
  const classes = () => page.locator('[data-class]').evaluateAll((all) => all.map((e) => e.dataset.class));
  await eventually('what the host began with is there', async () => (await classes()).length > 0);
  const before = await classes();
  is(before.filter((c) => c.startsWith('sine/')), [], 'classes of a plugin that is not there');
  drop('libtrocar_sine.so');
  await eventually('its class is there, beside the others', async () => {
    const now = await classes();
    return now.includes('sine/sine') && before.every((c) => now.includes(c));
  });
  await shot(page, 'palette-dropped-plugin');
  await page.locator('[data-class="sine/sine"]').click();
  await page.getByLabel('Name').fill('made');
  await page.getByRole('button', { name: 'Create', exact: true }).click();
  await box(page, 'host/made').waitFor();
  is(await page.evaluate(() => window.same), true, 'the page was not loaded again');
}

export async function a_component_is_created_with_what_was_changed_of_its_configuration(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const usual = (await grpcurl(host.addr, 'GcmService/GetState', { path: 'host/sine' })).component.config;
  const page = await world.viewer(host.addr);
  await page.getByRole('button', { name: 'Palette' }).click();
  await page.locator('[data-class="sine/sine"]').click();
  const form = page.locator('[data-create]');
  is(await form.getByLabel('Name').inputValue(), 'sine2', 'a name that is free');
  await form.locator('[data-part=configuration]').evaluate((e) => { e.open = true; });
  const field = form.getByLabel(/^frequency_hz/);
  is(Number(await field.inputValue()), usual.frequency_hz, 'what it is without a change');
  const make = page.getByRole('button', { name: 'Create', exact: true });
  // Refused in the server's words; the form stays as it is.
  await field.fill('501');
  await make.click();
  await form.locator('.refusal', { hasText: '500' }).waitFor();
  is((await grpcurl(host.addr, 'GcmService/List', {})).components.map((c) => c.path), ['host/sine'], 'components');
  await shot(page, 'create-configuration-refused');
  await field.fill('2.5');
  await make.click();
  await form.waitFor({ state: 'detached' });
  await box(page, 'host/sine2').waitFor();
  const { config } = (await grpcurl(host.addr, 'GcmService/GetState', { path: 'host/sine2' })).component;
  is(config, { ...usual, frequency_hz: 2.5 }, 'what it is configured with');
}
