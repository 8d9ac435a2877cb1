/// Plots as engineers use them: units, several curves, looking back, cursors, files and fingers.
import fs from 'node:fs';
import { interfacesOf, latest, plot, points } from './following.mjs';
import { CREST, drop, eightPlots, OUTPUT, sineShown } from './plotting.mjs';
import { box, create, eventually, grpcurl, holds, is, reaches, settled, shot, start, tool } from './world.mjs';

const ROW = { path: 'host/sine', field: 'latest.value', source: 'state', unit: '' };
const READ = { path: 'host/sine/signal/value', field: '', source: 'read', unit: '' };

const values = (page) => page.locator('[data-curve] .value').allInnerTexts();
const inPlots = (page) => page.locator('[data-figure]').evaluateAll((all) => all.map((f) => [...f.querySelectorAll('[data-curve]')].map((c) => c.dataset.curve)));
const told = (page, words) => page.locator('[data-note]', { hasText: words }).waitFor();
const kept = (page) => page.locator('[data-curve]').evaluateAll((all) => all.map((e) => Number(e.dataset.kept)));
/// Pauses the plots, and waits until they stand: more is kept of each curve than is seen.
async function pause(page) {
  await page.getByRole('button', { name: 'Pause', exact: true }).click();
  await eventually('they stand', async () => { const seen = await points(page); return (await kept(page)).every((n, i) => n > seen[i]); }, () => kept(page));
}
const near = (a, b, by) => Math.abs(a - b) <= by;
const paused = (page) => page.locator('[data-paused]').getAttribute('data-paused');
const curves = (page, n) => page.locator(`[data-figure="${n}"] .u-over`);

/// A file that a click makes.
async function file(page, click) {
  const [download] = await Promise.all([page.waitForEvent('download'), click()]);
  return { name: download.suggestedFilename(), bytes: fs.readFileSync(await download.path()) };
}
const csv = async (page, n) => {
  const { name, bytes } = await file(page, () => page.locator(`[data-figure="${n}"]`).getByRole('button', { name: 'CSV' }).click());
  const [head, ...rows] = bytes.toString().trimEnd().split('\n').map((line) => line.split(','));
  return { name, head, rows };
};

export async function values_and_ticks_have_the_prefix_and_the_digits_people_read(world) {
  const { page, set } = await sineShown(world);
  for (const [value, unit, text] of [
    [0.000637, 'm', '637.00 µm'], [0.0012, 'N', '1.2000 mN'], [1500, 'Hz', '1.5000 kHz'], [0.637, 'mm', '637.00 µm'], [31, 'mm', '31.000 mm'],
    [-0.25, 'N.m', '-250.00 mN·m'], [0.0025, 'm/s^2', '2.5000 mm/s²'], [0.0025, 'm^2', '0.0025000 m²'], [1234567, '', '1234567'], [0.25, '%', '0.25000 %'],
    [1920, 'px', '1920 px'], [0.001, 'rad', '1.0000 mrad'], [2500, 's', '2500.0 s'], [1500, '1/s', '1500 1/s'], [999.999999, 'Hz', '1.0000 kHz'], [0.0025, 'm/s|rad/s', '0.0025000 m/s or rad/s'], [0, 'm', '0.0000 m'],
  ]) {
    await set({ amplitude: value });
    await drop(page, { ...OUTPUT, unit });
    await eventually(`${value} ${unit} reads ${text}`, async () => (await values(page)).join() === text, () => values(page));
    await page.getByRole('button', { name: /^remove host/ }).click();
  }
  // Two values that differ in their third digit: so do the ticks.
  await set({ amplitude: 0.000636 });
  await drop(page, { ...OUTPUT, unit: 'm' });
  await reaches('points of the first', () => points(page), 3);
  await set({ amplitude: 0.000638 });
  const axis = async () => (await page.locator('[data-figure]').getAttribute('data-left')) ?? '';
  await eventually('the axis shows both', async () => /^µm: 636\.0 .* 638\.0$/.test(await axis()), axis);
  const texts = (await axis()).split(': ')[1].split(' ');
  is([new Set(texts).size, new Set(texts.map((t) => t.length)).size], [texts.length, 1], `ticks that differ, in so many digits: ${texts}`);
  await shot(page, 'plot-units');
}

export async function several_curves_share_a_plot_and_leave_it_again(world) {
  const { page } = await sineShown(world, { frequency_hz: 1, amplitude: 0.002 });
  await drop(page, { ...OUTPUT, unit: 'm' });
  await drop(page, { ...ROW, unit: 'N' }, '[data-figure="1"]');
  const [out, row, read] = ['host/sine/value · value', 'host/sine · latest.value', 'host/sine/signal/value'];
  is(await inPlots(page), [[out, row]], 'both are in one plot');
  await reaches('both have points', () => points(page), 40);
  const figure = page.locator('[data-figure="1"]');
  await eventually('an axis for each unit', async () => /^mm: /.test(await figure.getAttribute('data-left')) && /^mN: /.test(await figure.getAttribute('data-right')));
  is(new Set(await figure.locator('li line').evaluateAll((all) => all.map((l) => l.getAttribute('stroke')))).size, 2, 'colours');
  await shot(page, 'plot-two-units');
  // A third unit, the same again, garbage, and what is gone.
  await drop(page, { ...READ, unit: 'Hz' }, '[data-figure="1"]');
  await told(page, `plot 1 has axes for m and N; ${read} is in Hz, and a third axis there is not`);
  await drop(page, { ...OUTPUT, unit: 'm' }, '[data-figure="1"]');
  await told(page, `${out} is in plot 1 already`);
  for (const garbage of ['{"path": 3', '{"path": 3}', 'null', '[]', '{"path":"host/sine","field":"","unit":"","source":"toString"}']) {
    await page.locator('[data-note]').evaluateAll((all) => all.forEach((n) => n.querySelector('button').click()));
    await page.locator('[data-note]').first().waitFor({ state: 'detached' });
    await drop(page, garbage, '[data-figure="1"]');
    await told(page, 'what was dropped is not a number of a component');
  }
  await drop(page, { ...OUTPUT, path: 'host/gone/value' });
  await told(page, 'host/gone no longer exists');
  is(await inPlots(page), [[out, row]], 'what was refused is nowhere');
  // Beside it: a plot of its own; dragged by the mouse from its legend, one goes into the other.
  await drop(page, { ...READ, unit: 'N' });
  is(await inPlots(page), [[out, row], [read]], 'dropped beside');
  // A curve without points has nothing that could be kept of it.
  await reaches('it has points where it was dropped', () => points(page), 10);
  const had = await kept(page);
  await page.locator(`[data-curve="${read}"] b`).dragTo(figure.locator('.box'));
  await eventually('it went over', async () => JSON.stringify(await inPlots(page)) === JSON.stringify([[out, row, read]]), () => inPlots(page));
  // A curve is drawn anew with the next picture; until then it shows nothing.
  let has = [];
  await eventually('it is drawn there', async () => { has = await kept(page); return has.every((n) => n > 0); }, () => has);
  holds(has.every((n, i) => n >= had[i]), `with what was kept of it: ${has}, before ${had}`);
  await page.getByRole('button', { name: `${row} into a plot of its own` }).click();
  is(await inPlots(page), [[out, read], [row]], 'one in a plot of its own');
  // By keys alone: the choice in Interfaces.
  await interfacesOf(page, 'host/sine');
  const into = page.getByLabel('A number that is chosen goes into');
  await into.focus();
  await into.selectOption('2');
  const stamp = page.locator('[data-plot="host/sine/value#stamp"]');
  await stamp.evaluate((e) => { e.closest('details').open = true; });
  await stamp.focus();
  await page.keyboard.press('Enter');
  await eventually('it is in plot 2', async () => (await inPlots(page))[1].join() === `${row},host/sine/value · stamp`, () => inPlots(page));
  await page.getByRole('button', { name: `remove ${row}` }).click();
  await page.getByRole('button', { name: 'remove host/sine/value · stamp' }).click();
  is([await inPlots(page), await into.inputValue()], [[[out, read]], '0'], 'an empty plot goes, and is no choice any more');
}

export async function paused_plots_stand_still_can_be_zoomed_and_lose_nothing(world) {
  const { page } = await sineShown(world, { frequency_hz: 0.5 });
  await drop(page, OUTPUT);
  await drop(page, { ...ROW, unit: 'N' }, '[data-figure="1"]');
  await drop(page, READ);
  await reaches('all have points', () => points(page), 60);
  await pause(page);
  is(await paused(page), 'true', 'paused');
  const [seen, shown, had] = [await points(page), await latest(page), await kept(page)];
  await reaches('data are kept on', async () => (await kept(page)).map((n, i) => n - had[i]), 40);
  is([await points(page), await latest(page)], [seen, shown], 'what is seen stays');
  // Zoom by a drag over the curves.
  const at = await curves(page, 1).boundingBox();
  await page.mouse.move(at.x + at.width * 0.8, at.y + 30);
  await page.mouse.down();
  await page.mouse.move(at.x + at.width * 0.95, at.y + 40, { steps: 5 });
  await page.mouse.up();
  const span = page.locator('[data-figure="1"] figcaption .faint');
  const zoomed = async () => (await span.innerText()).match(/-?\d+\.?\d*/g).map(Number);
  await eventually('2 to 0.5 s before the newest are seen', async () => { const [from, to] = await zoomed(); return Math.abs(from + 2) < 0.1 && Math.abs(to + 0.5) < 0.1; }, () => span.innerText());
  const below = () => page.locator('[data-figure]').evaluateAll((all) => all.map((f) => f.dataset.below));
  await eventually('and drawn, in both plots', async () => (await below()).every((t) => /-1\.\d/.test(t) && !/-[3-9]/.test(t)), below);
  await shot(page, 'plot-zoomed');
  // The table holds the time that is seen.
  const { rows } = await csv(page, 1);
  const times = rows.map((r) => Number(r[1]));
  const [from, to] = await zoomed();
  holds(rows.length > 10 && times.every((t) => t >= from - 0.01 && t <= to + 0.01), `rows of ${from} … ${to} s: ${times[0]} … ${times.at(-1)}`);
  // The wheel, keys and buttons: closer, wider, earlier.
  await page.mouse.move(at.x + at.width / 2, at.y + 30);
  await page.mouse.wheel(0, -100);
  await eventually('closer', async () => { const [a, b] = await zoomed(); return b - a < (to - from) * 0.9; });
  await page.getByRole('button', { name: 'All', exact: true }).click();
  await eventually('all that is kept', async () => { const [a, b] = await zoomed(); return b - a > 2.2 && b > -0.01; }, () => span.innerText());
  await page.getByRole('button', { name: 'Zoom in', exact: true }).click();
  const [closer] = await zoomed();
  await page.getByRole('button', { name: 'Earlier' }).click();
  await eventually('earlier', async () => (await zoomed())[0] < closer);
  await curves(page, 1).dblclick({ position: { x: 40, y: 30 } });
  await eventually('back', async () => (await span.innerText()) === 'last 10 s before the pause', () => span.innerText());
  is([await paused(page), await page.getByRole('button', { name: 'Unmark' }).count()], ['true', 0], 'a double click returns, and marks nothing');
  await curves(page, 1).click({ position: { x: 100, y: 30 } });
  const [marked, unmark] = [curves(page, 1), page.getByRole('button', { name: 'Unmark' })];
  await unmark.waitFor();
  await marked.dblclick({ position: { x: 40, y: 30 } });
  await marked.hover({ position: { x: 100, y: 30 } });
  const apart = page.locator('[data-apart]');
  await eventually('a mark stays where it was', async () => (await unmark.count()) === 1 && /^Δt -?(0|\d+\.?\d* [mµn]s)/.test(await apart.innerText()), () => apart.innerText());
  await unmark.click();
  const before = Number((await csv(page, 1)).rows.at(-1)[0]);
  await page.getByRole('button', { name: 'Continue' }).click();
  const meanwhile = (await csv(page, 1)).rows.filter(([time]) => Number(time) > before);
  holds(meanwhile.length >= 40, `what came meanwhile is there: ${meanwhile.length} rows after the pause`);
  // Zooming what goes on pauses it; returning goes on.
  // A plot without a single number takes part, too.
  await drop(page, { ...OUTPUT, field: 'none' });
  await eventually('it is said in words', async () => (await values(page))[3] === 'not a number', () => values(page));
  await page.getByRole('button', { name: 'Zoom in', exact: true }).click();
  is(await paused(page), 'true', 'paused by zooming');
  // Zoom is common: it counts from the newest of all, which may be a moment after that of this plot.
  const half = (await page.locator('[data-figure="3"] figcaption .faint').innerText()).match(/-?\d+\.\d+/g).map(Number);
  holds(near(half[1] - half[0], 5, 0.011) && near(half[1], 0, 0.5), `the newest half of what was seen: ${half}`);
  await page.getByRole('button', { name: 'Return' }).click();
  is(await paused(page), 'false', 'goes on by returning');
}

export async function one_cursor_tells_the_values_of_all_plots_and_their_differences(world) {
  const { host, page } = await sineShown(world, { frequency_hz: 0.5, amplitude: 0.01 });
  await drop(page, { ...OUTPUT, unit: 'm' });
  await drop(page, { ...ROW, unit: 'm' });
  await reaches('points', () => points(page), 60);
  await pause(page);
  const { rows, name } = await csv(page, 1);
  const tables = [rows, (await csv(page, 2)).rows];
  const at = await curves(page, 1).boundingBox();
  const x = (part) => at.x + at.width * part;
  const cursor = async () => Number(await page.locator('[data-cursor]').getAttribute('data-cursor'));
  /// Values of the tables at the time of the cursor, to the digits that are shown, mm.
  const wanted = (time) => tables.map((rows) => rows.reduce((best, r) => (Math.abs(r[0] - time) < Math.abs(best[0] - time) ? r : best))).map((r) => Number((r[2] * 1000).toPrecision(5)));
  const shown = async () => (await values(page)).map((t) => (t.endsWith(' mm') ? Number.parseFloat(t) : t));
  const agree = async () => {
    // 10 s are seen, to the newest: the cursor is a second before it.
    holds(Math.abs(await cursor() - (rows.at(-1)[0] - 1)) < 0.05, `${await cursor()}, a second before ${rows.at(-1)[0]}`);
    return (await shown()).join() === wanted(await cursor()).join();
  };
  await page.mouse.move(x(0.9), at.y + 30);
  await eventually('both tell the value at the cursor', agree, async () => [await values(page), wanted(await cursor())]);
  await page.mouse.click(x(0.85), at.y + 30);
  await page.mouse.move(x(0.95), at.y + 30);
  const apart = page.locator('[data-apart]');
  await eventually('a second lies between mark and cursor', async () => Math.abs(Number.parseFloat((await apart.innerText()).replace('Δt ', '')) - (/ ms/.test(await apart.innerText()) ? 1000 : 1)) < (/ ms/.test(await apart.innerText()) ? 30 : 0.03), () => apart.innerText());
  await eventually('differences of both', async () => (await page.locator('.difference').count()) === 2);
  await shot(page, 'plot-cursor');
  // By keys: the cursor starts at the newest and goes back.
  await page.mouse.move(10, 10);
  await eventually('the latest again', async () => (await page.locator('[data-apart]').count()) === 0);
  await page.getByRole('group', { name: /^curves of plot 2/ }).focus();
  await page.keyboard.press('Shift+ArrowLeft');
  await eventually('a second before the newest', agree, async () => [await values(page), wanted(await cursor())]);
  await page.keyboard.press('Escape');
  await eventually('nothing is marked', async () => (await page.getByRole('button', { name: 'Unmark' }).count()) === 0);
  holds(/^host\.sine\.value\.value-\d{4}-\d\d-\d\dT\d\d-\d\d-\d\d\.csv$/.test(name), `a name of signal and time: ${name}`);
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/sine' });
  await page.locator('[data-curve] .refusal').first().waitFor();
}

export async function a_plot_is_saved_as_a_table_and_as_a_picture(world) {
  const { page } = await sineShown(world, { frequency_hz: 0.3 });
  await drop(page, { ...OUTPUT, unit: 'm' });
  await drop(page, { ...READ, unit: 'N' }, '[data-figure="1"]');
  await reaches('points', () => points(page), 50);
  await pause(page);
  const { head, rows, name } = await csv(page, 1);
  is(head, ['time (s)', 'relative (s)', 'host/sine/value · value (m)', 'host/sine/signal/value (N)'], 'columns');
  const shown = await latest(page);
  for (const column of [2, 3]) is(rows.filter((r) => r[column]).at(-1)[column], shown[column - 2], 'the last value, to its last digit');
  const counts = await points(page);
  is([2, 3].map((c) => rows.filter((r) => r[c]).length).every((n, i) => n > 20 && n <= counts[i]), true, 'a row for each point');
  holds(rows.some((r) => !r[2]) && rows.every((r) => r.length === 4 && (r[2] || r[3])), 'what did not come at a time is empty, not made up');
  holds(rows.every((r, i) => i === 0 || Number(r[0]) > Number(rows[i - 1][0])) && rows.every((r) => /^\d+\.\d{9}$/.test(r[0])), 'times that grow');
  holds(rows.some((r) => r[2].replace(/[-.e]|^0+/g, '').length >= 15), 'all digits');
  is(Number(rows.at(-1)[1]), 0, 'the newest is 0 s');
  holds(name.includes('host.sine.value.value-and-1-more-'), name);
  const pictures = [];
  for (const theme of ['light', 'dark']) {
    if ((await page.evaluate(() => document.documentElement.dataset.theme)) !== theme) await page.keyboard.press('d');
    await eventually(`it is ${theme}`, () => page.evaluate((t) => document.documentElement.dataset.theme === t, theme));
    const { name, bytes } = await file(page, () => page.locator('[data-figure="1"]').getByRole('button', { name: 'PNG' }).click());
    is([bytes.subarray(1, 4).toString(), name.endsWith('.png')], ['PNG', true], 'a picture');
    const [width, height] = [bytes.readUInt32BE(16), bytes.readUInt32BE(20)];
    const drawn = await page.locator('[data-figure="1"] canvas').evaluate((c) => [c.width, c.height]);
    holds(width >= drawn[0] && height >= drawn[1] + 60, `room for title and legend: ${width} × ${height} around ${drawn}`);
    fs.mkdirSync('pictures', { recursive: true });
    fs.writeFileSync(`pictures/plot-exported-${theme}.png`, bytes);
    const ground = await page.evaluate(async (url) => {
      const image = Object.assign(new Image(), { src: url });
      await image.decode();
      const canvas = Object.assign(document.createElement('canvas'), { width: image.width, height: image.height });
      const draw = canvas.getContext('2d');
      draw.drawImage(image, 0, 0);
      return [...draw.getImageData(1, 1, 1, 1).data];
    }, `data:image/png;base64,${bytes.toString('base64')}`).catch((e) => String(e));
    pictures.push(ground);
  }
  is(pictures, [[255, 255, 255, 255], [33, 41, 50, 255]], 'grounds of the themes');
}

export async function an_axis_that_is_held_stays_and_one_that_is_not_fits_what_is_seen(world) {
  const { page, set } = await sineShown(world, { ...CREST, amplitude: 1 });
  await drop(page, { ...OUTPUT, unit: 'm' });
  const figure = page.locator('[data-figure="1"]');
  const left = () => figure.getAttribute('data-left');
  await eventually('it fits', async () => /^m: .*1\.0/.test((await left()) ?? ''), left);
  await page.getByRole('button', { name: 'Hold y' }).click();
  const held = await left();
  await set({ amplitude: 5 });
  await eventually('the new value', async () => (await latest(page))[0] === '5');
  const n = (await points(page))[0];
  await reaches('and more of it', () => points(page), n + 5);
  is(await left(), held, 'ticks of an axis that is held');
  await page.getByRole('button', { name: 'Hold y' }).click();
  await eventually('it fits again', async () => /^m: .*\b5/.test(await left()), left);
}

export async function fingers_zoom_a_plot_and_move_along_it(world) {
  const { page } = await sineShown(world, { frequency_hz: 1 }, { hasTouch: true, isMobile: true, viewport: { width: 1024, height: 768 } });
  await drop(page, OUTPUT);
  await reaches('points', () => points(page), 30);
  const fingers = await page.context().newCDPSession(page);
  const touch = (type, ...at) => fingers.send('Input.dispatchTouchEvent', { type, touchPoints: at.map(([x, y], id) => ({ x, y, id })) });
  const over = await curves(page, 1).boundingBox();
  const [x, y] = [over.x + over.width * 0.7, over.y + over.height / 2];
  const span = page.locator('[data-figure="1"] figcaption .faint');
  const seen = async () => ((await span.innerText()).match(/-?\d+\.?\d*/g) ?? []).map(Number);
  await touch('touchStart', [x - 40, y], [x + 40, y]);
  for (let d = 50; d <= 160; d += 10) await touch('touchMove', [x - d, y], [x + d, y]);
  await touch('touchEnd');
  await eventually('a quarter is seen', async () => { const [a, b] = await seen(); return b - a > 1.5 && b - a < 4; }, () => span.innerText());
  const [before] = await seen();
  await touch('touchStart', [x, y]);
  for (let d = 10; d <= 150; d += 10) await touch('touchMove', [x + d, y]);
  await touch('touchEnd');
  await eventually('earlier', async () => (await seen())[0] < before, () => span.innerText());
  await page.getByRole('button', { name: 'Return' }).click();
  await eventually('it goes on', async () => (await paused(page)) === 'false');
}

export async function a_read_only_page_has_plots_without_settings_and_a_narrow_one_has_all(world) {
  const { page, host } = await sineShown(world, CREST, {}, '?readonly');
  await drop(page, OUTPUT);
  await reaches('points', () => points(page), 5);
  is([await page.getByRole('button', { name: 'Pause', exact: true }).count(), await page.getByRole('button', { name: 'Settings', exact: true }).count()], [1, 0], 'pause, and no settings');
  const narrow = await world.viewer(host.addr, '', { viewport: { width: 300, height: 700 } });
  await tool(narrow, 'Plots');
  await narrow.locator('.plots').waitFor();
  await drop(narrow, { ...OUTPUT, unit: 'm' });
  await drop(narrow, { ...ROW, unit: 'N' }, '[data-figure="1"]');
  await reaches('points', () => points(narrow), 5);
  await narrow.getByRole('button', { name: 'Settings', exact: true }).click();
  await narrow.locator('[data-tuning]').waitFor();
  await shot(narrow, 'plot-narrow');
  const wide = await narrow.locator('.dock').evaluate((dock) => [...dock.querySelectorAll('button, figure, canvas, select, input')].filter((e) => e.getBoundingClientRect().right > innerWidth + 1).map((e) => e.outerHTML.slice(0, 80)));
  is(wide, [], 'what is beyond the edge');
}

export async function what_is_asked_for_in_a_panel_of_a_narrow_window_is_seen(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr, '', { viewport: { width: 300, height: 700 } });
  await settled(page);
  await interfacesOf(page, 'host/sine');
  await plot(page, 'host/sine/value', 'value');
  await reaches('points', () => points(page), 5);
  is(await page.locator('.inspector').count(), 0, 'the panel makes room');
  // With a panel open again the button brings the plots, and takes them away.
  await box(page, 'host/sine').locator('header').click();
  await page.locator('.inspector').waitFor();
  await tool(page, 'Plots');
  await page.locator('.plots').waitFor();
  await tool(page, 'Plots');
  await page.locator('.plots').waitFor({ state: 'detached' });
}

export async function eight_plots_of_four_curves_leave_the_page_answering(world) {
  const { page, plotted } = await eightPlots(world);
  await plotted();
  await shot(page, 'plots-many');
  await box(page, 'host/s0').locator('header').click();
  await page.locator('.inspector').waitFor();
  const had = await latest(page);
  await eventually('all go on', async () => (await latest(page)).every((v, i) => v !== had[i]));
}
