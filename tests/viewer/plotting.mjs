/// Plots for tests: a drop, and eight plots of four curves.
import { points } from './following.mjs';
import { create, grpcurl, is, reaches, settled, start } from './world.mjs';

/// A sine that stands at its crest: all that comes of it is its amplitude.
export const CREST = { frequency_hz: 0, phase_rad: Math.PI / 2 };
export const OUTPUT = { path: 'host/sine/value', field: 'value', source: 'output', unit: '' };

/// Drops this as a drag from elsewhere would.
export const drop = (page, data, onto = '.plots', kind = 'application/x-trocar-signal') =>
  page.locator(onto).evaluate((e, [kind, text]) => {
    const transfer = new DataTransfer();
    transfer.setData(kind, text);
    e.dispatchEvent(new DragEvent('drop', { bubbles: true, cancelable: true, dataTransfer: transfer }));
  }, [kind, typeof data === 'string' ? data : JSON.stringify(data)]);

/// A page with its plots open, beside a sine.
export async function sineShown(world, config = CREST, options = {}, query = '') {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine', config);
  await start(host.addr, 'host/sine');
  const page = await world.viewer(host.addr, query, options);
  await settled(page);
  await page.getByRole('button', { name: 'Plots', exact: true }).click();
  await page.locator('.plots').waitFor();
  return { host, page, set: (config) => grpcurl(host.addr, 'GcmService/Configure', { path: 'host/sine', config }) };
}

/// A page beside eight sines; `plotted` draws each four times, in eight plots.
export async function eightPlots(world) {
  const host = await world.host();
  for (let n = 0; n < 8; n += 1) await create(host.addr, 'sine', `host/s${n}`, { frequency_hz: 1 + n }, { rate_hz: 100 });
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr, '', { viewport: { width: 1366, height: 768 } });
  await settled(page);
  await page.getByRole('button', { name: 'Plots', exact: true }).click();
  await page.locator('.plots').waitFor();
  const plotted = async () => {
    for (let n = 0; n < 8; n += 1) {
      await drop(page, { ...OUTPUT, path: `host/s${n}/value` });
      for (const k of [1, 2, 3]) await drop(page, { ...OUTPUT, path: `host/s${(n + k) % 8}/value` }, `[data-figure="${n + 1}"]`);
    }
    is((await points(page)).length, 32, 'curves');
    await reaches('all have points', () => points(page), 60);
  };
  return { page, plotted };
}
