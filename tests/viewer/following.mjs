/// How tests follow what streams, and read what the page shows of it.
import { box, eventually } from './world.mjs';

export async function interfacesOf(page, path) {
  await box(page, path).locator('header').click();
  await page.getByRole('tab', { name: 'Interfaces' }).click();
}
export async function plot(page, path, number) {
  await page.locator(`[data-plot="${path}#${number}"]`).evaluate((e) => { e.closest('details').open = true; });
  await page.locator(`[data-plot="${path}#${number}"]`).click();
}
export const points = (page) => page.locator('[data-curve]').evaluateAll((all) => all.map((e) => Number(e.dataset.points)));
/// The newest number of each curve, as the page has it.
export const latest = (page) => page.locator('[data-curve]').evaluateAll((all) => all.map((e) => e.dataset.latest));
/// All curves change, and change again: one that stands still does not, however many points it has.
export async function go_on(page, what) {
  for (let round = 0; round < 3; round += 1) {
    const before = await latest(page);
    await eventually(what, async () => (await latest(page)).every((v, i) => v !== before[i] && Number.isFinite(Number(v))));
  }
}
/// What the list of events shows: path and text of each row, oldest first.
export const eventRows = (page) => page.locator('[data-list=events] .list > div').evaluateAll((all) => all.map((e) => [e.querySelector('b').innerText, e.querySelector('span').innerText]));
