/// What streams: plots, pictures, events, the log, and how many windows may look at once.
import { eventRows, framesNoted, go_on, interfacesOf, latest, noteFrames, plot, points } from './following.mjs';
import { box, create, eventually, grpcurl, holds, is, settled, shot, start, state } from './world.mjs';

/// A host whose `host/Server` runs, and a page that shows its interfaces.
async function serverShown(world) {
  const host = await world.host();
  await create(host.addr, 'example/Server', 'host/Server');
  await start(host.addr, 'host/Server');
  const page = await world.viewer(host.addr);
  await settled(page);
  await interfacesOf(page, 'host/Server');
  return { host, page };
}

export async function six_plots_and_a_second_window_stay_live(world) {
  const host = await world.host();
  for (const n of [1, 2, 3]) await create(host.addr, 'sine', `host/s${n}`, { frequency_hz: n / 2 });
  await start(host.addr, 'host/**');
  const open = async (page) => {
    await page.locator('[data-standing=live]').waitFor();
    await box(page, 'host/s3').waitFor();
    for (const n of [1, 2, 3]) {
      await page.keyboard.press('Control+k');
      await page.getByRole('combobox', { name: 'search' }).fill(`host/s${n}`);
      await page.keyboard.press('Enter');
      await page.getByRole('tab', { name: 'Interfaces' }).click();
      await plot(page, `host/s${n}/value`, 'value');
      await (n === 1 ? plot(page, 'host/s1', 'latest.value') : n === 2 ? plot(page, 'host/s2/signal/value', '') : plot(page, 'host/s3', 'latest.value'));
    }
  };
  const first = await world.viewer(host.addr);
  const asked = { open: new Set(), reads: 0 };
  const isCall = (name) => (request) => request.url().endsWith(`InteractService/${name}`);
  first.on('request', (request) => {
    if (isCall('Subscribe')(request)) asked.open.add(request);
    if (isCall('Read')(request)) asked.reads += 1;
  });
  for (const over of ['requestfinished', 'requestfailed']) first.on(over, (request) => asked.open.delete(request));
  await open(first);
  is((await points(first)).length, 6, 'plots');
  await eventually('all six have points', async () => (await points(first)).every((n) => n > 40));
  await eventually('one call brings all that is followed', () => asked.open.size === 1);
  is(asked.reads, 0, 'state rows that were asked for one by one');
  const second = await first.context().newPage();
  await second.goto(`http://${host.addr}/`);
  await open(second);
  for (const page of [first, second, first]) {
    await page.bringToFront();
    await go_on(page, 'all six go on');
  }
  await shot(first, 'plots');
  await shot(second, 'second-window');
  // And calls still get through beside what streams.
  await first.bringToFront();
  await box(first, 'host/s3').locator('header').click({ button: 'right' });
  await first.getByRole('menuitem', { name: /^Stop/ }).click();
  await eventually('it stops', async () => (await state(host.addr, 'host/s3')) === 'STOPPED');
}

export async function a_plot_shows_the_number_that_was_written_last(world) {
  const { host, page } = await serverShown(world);
  for (const [path, number] of [['host/Server/Provided/SetPointReached', ''], ['host/Server', 'set_point']]) {
    const stands = page.waitForResponse((r) => r.url().endsWith('InteractService/Subscribe'));
    await plot(page, path, number);
    await stands;
  }
  await plot(page, 'host/Server/Provided/Read', '');
  for (const written of [30, 31]) {
    await grpcurl(host.addr, 'InteractService/Invoke', { path: 'host/Server/Provided/Write', json: written });
    await eventually(`event, read and state row are ${written}`, async () => (await latest(page)).join() === `${written},${written},${written}`);
  }
  is(await page.locator('[data-curve] figcaption span').allInnerTexts(), ['31.000 mm', '31.000 mm', '31.000 mm'], 'what people read');
}

export async function an_enum_is_plotted_as_its_numbers_with_its_names(world) {
  const host = await world.host();
  await create(host.addr, 'eyerobot/eyerobot', 'host/robot');
  await start(host.addr, 'host/robot');
  const page = await world.viewer(host.addr);
  await settled(page);
  await interfacesOf(page, 'host/robot');
  // A read and an event, which have one name, and a state row.
  const both = page.locator('[data-plot="host/robot/arm/operating_state#state"]');
  is(await both.count(), 2, 'a read and an event');
  await both.evaluateAll((all) => all.forEach((e) => { e.closest('details').open = true; }));
  const stands = page.waitForResponse((r) => r.url().endsWith('InteractService/Subscribe'));
  await both.last().click();
  await stands;
  await both.first().click();
  await plot(page, 'host/robot', 'operating_state.state');
  await eventually('reads and rows come', async () => (await latest(page)).slice(1).join() === '1,1');
  const shown = page.locator('[data-curve] figcaption span');
  const command = (word) => grpcurl(host.addr, 'InteractService/Invoke', { path: 'host/robot/arm/state_command', json: word });
  for (const [word, number, name] of [['pause', 2, 'PAUSED'], ['resume', 1, 'ENABLED']]) {
    await command(word);
    await eventually(`all are ${name}`, async () => (await latest(page)).join() === `${number},${number},${number}`);
    is(await shown.allInnerTexts(), Array(3).fill(`${number} ${name}`), 'what people read');
  }
  is(await shown.first().getAttribute('title'), '0 = DISABLED\n1 = ENABLED\n2 = PAUSED\n3 = FAULT', 'all its names');
  await shot(page, 'plot-enum');
  // And what is no number, or one of too many, is named as not offered.
  const not = await page.locator('[data-others="host/robot/body/jacobian"]').textContent();
  is(not, 'not plotted: values[16…29] (more than 16 items)', 'what is left out of a long array');
  is([await page.locator('[data-plot="host/robot/body/jacobian#values[15]"]').count(), await page.locator('[data-plot="host/robot/body/jacobian#values[16]"]').count()], [1, 0], 'items that are offered');
  is(await page.locator('[data-others="host/robot/arm/operating_state"]').first().textContent(), 'not plotted: message (text)', 'what is left out of a structure with text');
}

export async function numbers_of_events_are_plotted(world) {
  const host = await world.host();
  await create(host.addr, 'fixture-torture/server', 'host/e', undefined, { rate_hz: 100 });
  await start(host.addr, 'host/e');
  const page = await world.viewer(host.addr);
  await settled(page);
  await interfacesOf(page, 'host/e');
  await plot(page, 'host/e/ctl/ticked', 'number');
  await eventually('points come', async () => (await points(page))[0] > 100);
  await go_on(page, 'more come');
  await shot(page, 'plot-event');
}

export async function pictures_of_a_stream_are_shown_and_one_window_is_all_video(world) {
  const demo = await world.demo();
  const page = await world.viewer(demo.addr);
  await box(page, 'host/pip').waitFor();
  await settled(page);
  const feet = page.locator('.component footer');
  await eventually('every component says how often it steps', async () => (await feet.allInnerTexts()).every((t) => /\d Hz/.test(t)));
  const wires = page.locator('[data-connection]');
  await eventually('streams say what flows', async () => (await wires.allInnerTexts()).filter((t) => /\d\/s/.test(t) && /p99/.test(t)).length > 8);
  const covered = await page.evaluate(() => {
    const over = (a, b) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1;
    const label = (e) => e.getBoundingClientRect();
    return [...document.querySelectorAll('.flow.short')].filter((e) => e.innerText).flatMap((e) => {
      const ends = e.dataset.connection.split(' → ').map((p) => p.slice(0, p.lastIndexOf('/')));
      return ends.filter((p) => over(label(e), document.querySelector(`[data-path="${p}"]`).getBoundingClientRect())).map((p) => `${e.dataset.connection} over ${p}`);
    });
  });
  is(covered, [], 'figures that cover the ports they stand between');
  // Rates are taken over four answers: the first are those of a system that was just started.
  for (let n = 0; n < 4; n += 1) await page.waitForResponse((r) => r.url().endsWith('GcmService/List'));
  await shot(page, 'demo');
  await page.keyboard.press('Control+k');
  await page.getByRole('combobox', { name: 'search' }).fill('host/pip');
  await page.keyboard.press('Enter');
  await page.getByRole('tab', { name: 'Interfaces' }).click();
  await page.locator('[data-picture="host/pip/composed"]').click();
  const shown = page.locator('[data-picture-of="host/pip/composed"]');
  await eventually('pictures come', async () => Number(await shown.getAttribute('data-shown')) > 3);
  const colours = await shown.locator('canvas').evaluate((c) => {
    const { data } = c.getContext('2d').getImageData(0, 0, c.width, c.height);
    return { width: c.width, different: new Set(Array.from({ length: data.length / 400 }, (_, i) => data[i * 400] >> 3)).size };
  });
  holds(colours.width > 100 && colours.width <= 480 && colours.different > 5, `a picture with something in it: ${JSON.stringify(colours)}`);
  await shot(page, 'thumbnails');
  await page.goto(`http://${demo.addr}/video`);
  const video = page.locator('[data-picture-of]');
  await video.waitFor();
  is(await video.getAttribute('data-picture-of'), 'host/pip/composed', 'what goes into the display');
  await eventually('the video runs', async () => Number(await video.getAttribute('data-shown')) > 5);
  await shot(page, 'video');
}

export async function an_event_that_is_followed_is_listed_with_path_and_value_in_order(world) {
  const { host, page } = await serverShown(world);
  const event = 'host/Server/Provided/SetPointReached';
  const stands = page.waitForResponse((r) => r.url().endsWith('InteractService/Subscribe'));
  await page.locator(`[data-follow="${event}"]`).click();
  await stands;
  const write = (value) => grpcurl(host.addr, 'InteractService/Invoke', { path: 'host/Server/Provided/Write', json: value });
  await write(30);
  await write(31);
  await eventually('both are listed', async () => (await eventRows(page)).length >= 2);
  is(await eventRows(page), [[event, '30'], [event, '31']], 'rows');
  const list = page.locator('[data-list=events]');
  is([await list.getAttribute('data-total'), await list.getAttribute('data-skipped')], ['2', '0'], 'events and skipped ones');
  const times = (await list.locator('time').allInnerTexts()).map(Number.parseFloat);
  holds(times[0] > 0 && times[0] < times[1], `each at its time: ${times}`);
  await shot(page, 'event-values');
  // What is followed no more comes no more.
  await page.getByRole('button', { name: `follow ${event} no more` }).click();
  const again = page.waitForResponse((r) => r.url().endsWith('InteractService/Subscribe'));
  await page.locator('[data-follow="host/Server/Provided/VoidCalled"]').click();
  await again;
  await write(32);
  await grpcurl(host.addr, 'InteractService/Invoke', { path: 'host/Server/Provided/Void' });
  await eventually('the other event is listed', async () => (await eventRows(page)).some(([path]) => path === 'host/Server/Provided/VoidCalled'));
  is(await eventRows(page), [[event, '30'], [event, '31'], ['host/Server/Provided/VoidCalled', '']], 'rows at the end');
}

export async function who_follows_another_event_misses_none_of_the_first(world) {
  const host = await world.host();
  const makers = [1, 2, 3].map((n) => `host/e${n}`);
  const events = makers.map((path) => `${path}/ctl/ticked`);
  for (const path of makers) await create(host.addr, 'fixture-torture/server', path, undefined, { rate_hz: 40 });
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  const list = page.locator('[data-list=events]');
  /// All that was listed, from a list that keeps the newest 200 only: it has to be looked at before they are through.
  const numbers = {};
  const read = async () => {
    for (const [path, shown] of Object.entries(numbered(await eventRows(page)))) {
      holds(shown.every((n, i) => i === 0 || n > shown[i - 1]), `each once, in order, ${path}: ${shown}`);
      const had = (numbers[path] ??= []);
      had.push(...shown.filter((n) => n > (had.at(-1) ?? -1)));
    }
  };
  const more = async (path, what) => {
    const had = numbers[path]?.length ?? 0;
    await eventually(what, async () => (await read(), (numbers[path]?.length ?? 0) >= had + 10));
  };
  for (const [n, event] of events.entries()) {
    await interfacesOf(page, makers[n]);
    await page.locator(`[data-follow="${event}"]`).click();
    await more(event, `${event} is listed, and goes on`);
  }
  // One is left, and a curve is drawn: every change is a new call, and none of them may cost the others an event.
  await page.getByRole('button', { name: `follow ${events[0]} no more` }).click();
  await more(events[1], 'the second goes on without the first');
  await plot(page, events[2], 'number');
  await eventually('a curve beside the list', async () => (await points(page))[0] > 20);
  // An item that came twice or too late would begin it anew.
  const drawn = (await points(page))[0];
  await page.getByRole('button', { name: 'Events' }).click();
  await more(events[2], 'the third goes on beside its curve');
  await interfacesOf(page, makers[1]);
  await plot(page, events[1], 'number');
  await eventually('a second curve', async () => (await points(page))[1] > 20);
  holds((await points(page))[0] > drawn, `the first goes on: ${drawn} points, then ${(await points(page))[0]}`);
  await page.getByRole('button', { name: 'Events' }).click();
  await more(events[2], 'the third goes on');
  for (const path of events) {
    const had = numbers[path];
    const gaps = had.flatMap((n, i) => (i && n !== had[i - 1] + 1 ? [`${had[i - 1]} to ${n}`] : []));
    is(gaps, [], `what is missing of ${path}, of ${had.length}`);
  }
  is(await list.getAttribute('data-skipped'), '0', 'skipped');
}

/// 95 % of the frames while ten thousand events a second come may take this long beyond twice those without any, ms.
const FRAME = 100;

export async function ten_thousand_events_a_second_do_not_stop_the_page(world) {
  const host = await world.host();
  const makers = Array.from({ length: 16 }, (_, n) => `host/e${n}`);
  for (const path of makers) await create(host.addr, 'fixture-torture/server', path, undefined, { rate_hz: 1000 });
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  // What this browser takes beside the same makers, when nothing of them is followed.
  await noteFrames(page);
  await page.waitForFunction(() => window.frames.length >= 100);
  const control = await framesNoted(page);
  for (const path of makers) {
    await page.keyboard.press('Control+k');
    await page.getByRole('combobox', { name: 'search' }).fill(path);
    await page.keyboard.press('Enter');
    await page.getByRole('tab', { name: 'Interfaces' }).click();
    await page.locator(`[data-follow="${path}/ctl/ticked"]`).click();
  }
  const list = page.locator('[data-list=events]');
  const seen = async () => Number(await list.getAttribute('data-total')) + Number(await list.getAttribute('data-skipped'));
  await eventually('events come', async () => (await seen()) > 20_000);
  await noteFrames(page);
  const total = async () => Number(await list.getAttribute('data-total'));
  const [shown, older] = [await total(), numbered(await eventRows(page))];
  // Beside other work the makers may be late for a while; at least once all that is promised comes, forty thousand in a row.
  const rate = await eventually('ten thousand come each second', async () => {
    const [began, had] = [Date.now(), await seen()];
    await eventually('forty thousand more', async () => (await seen()) > had + 40_000);
    const rate = ((await seen()) - had) / ((Date.now() - began) / 1000);
    return rate >= 10_000 && rate;
  });
  const frames = await framesNoted(page);
  const rows = await list.locator('.list > div').count();
  console.log(`events: ${rate.toFixed(0)}/s came or were counted as skipped (${await list.getAttribute('data-skipped')} in all), ${frames.count} frames, p95 ${frames.p95.toFixed(0)} ms, largest ${frames.most.toFixed(0)} ms; control (none followed) p95 ${control.p95.toFixed(0)} ms; ${rows} rows`);
  holds(rows > 0 && rows <= 200, `events are listed, and the list stays short: ${rows} rows`);
  holds(shown > 0 && (await total()) > shown, `some were really sent, not only counted: ${shown}, then ${await total()}`);
  const newer = numbered(await eventRows(page));
  holds(Object.keys(older).some((path) => newer[path]?.at(-1) > older[path].at(-1)), `the newest are listed: ${JSON.stringify(older)}, then ${JSON.stringify(newer)}`);
  for (const [path, numbers] of Object.entries(newer)) holds(makers.includes(path.split('/').slice(0, 2).join('/')) && numbers.every((n, i) => n > (numbers[i - 1] ?? 0)), `in order, ${path}: ${numbers}`);
  holds(frames.count > 20 && frames.p95 <= FRAME + 2 * control.p95, `frames take too long: p95 ${frames.p95} ms of ${frames.count}; ${FRAME} ms and twice the control of ${control.p95} ms are allowed`);
  // The page answers while they come: it goes back to the first of them, and stops it.
  await page.keyboard.press('Control+k');
  await page.getByRole('combobox', { name: 'search' }).fill('host/e0');
  await page.keyboard.press('Enter');
  await box(page, 'host/e0').locator('header').click({ button: 'right' });
  await page.getByRole('menuitem', { name: /^Stop/ }).click();
  await eventually('it stops', async () => (await state(host.addr, 'host/e0')) === 'STOPPED');
  await shot(page, 'events');
}

/// The numbers of listed events by path; what was skipped is said behind them.
function numbered(rows) {
  const out = {};
  for (const [path, text] of rows) (out[path] ??= []).push(JSON.parse(text.replace(/ \(\d+ skipped before\)$/, '')).number);
  return out;
}

export async function a_number_that_is_dropped_into_the_plots_is_drawn(world) {
  const { host, page } = await serverShown(world);
  await page.getByRole('button', { name: 'Plots' }).click();
  const plots = page.locator('.plots');
  await plots.getByText('Nothing is plotted').waitFor();
  const number = page.locator('[data-plot="host/Server#set_point"]');
  await number.evaluate((e) => { e.closest('details').open = true; });
  const drop = async (onto) => {
    await number.scrollIntoViewIfNeeded();
    const [from, to] = [await number.boundingBox(), await onto.boundingBox()];
    await page.mouse.move(from.x + from.width / 2, from.y + from.height / 2);
    await page.mouse.down();
    await page.mouse.move(to.x + to.width / 2, to.y + to.height / 2, { steps: 8 });
    await page.mouse.up();
  };
  // Beside them it is nothing.
  await drop(page.locator('.tally'));
  is((await points(page)).length, 0, 'plots of what was dropped elsewhere');
  const stands = page.waitForResponse((r) => r.url().endsWith('InteractService/Subscribe'));
  await drop(plots);
  await page.locator('[data-curve="host/Server · set_point"]').waitFor();
  await stands;
  await grpcurl(host.addr, 'InteractService/Invoke', { path: 'host/Server/Provided/Write', json: 30 });
  await eventually('it is drawn', async () => (await latest(page)).join() === '30');
  await shot(page, 'plot-dropped');
  await drop(plots);
  is((await points(page)).length, 1, 'plots of what was dropped twice');
}

export async function a_plot_goes_on_when_its_component_is_made_anew(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await start(host.addr, 'host/sine');
  const page = await world.viewer(host.addr);
  await settled(page);
  await interfacesOf(page, 'host/sine');
  await plot(page, 'host/sine/value', 'value');
  await eventually('points come', async () => (await points(page))[0] > 20);
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/sine' });
  await grpcurl(host.addr, 'GcmService/Reset', { path: 'host/sine' });
  await grpcurl(host.addr, 'GcmService/Start', { path: 'host/sine' });
  await go_on(page, 'points come again');
}

export async function a_plot_goes_on_when_its_process_was_lost_and_is_back(world) {
  const gcm = await world.gcm();
  const left = await world.host('left', ['--gcm', gcm.addr]);
  await create(gcm.addr, 'sine', 'left/sine');
  await start(gcm.addr, 'left/sine');
  const page = await world.viewer(gcm.addr);
  await settled(page);
  await interfacesOf(page, 'left/sine');
  // A sample and a state row.
  await plot(page, 'left/sine/value', 'value');
  await plot(page, 'left/sine', 'latest.value');
  await eventually('points come', async () => (await points(page)).every((n) => n > 20));
  left.kill('SIGKILL');
  await page.locator('[data-process=left][data-standing=lost]').waitFor();
  const why = page.locator('[data-curve] .refusal');
  const words = 'left/sine: its process does not answer';
  await eventually('both plots say why they stand still', async () => (await why.allInnerTexts()).filter((t) => t === words).length === 2);
  await shot(page, 'plot-lost');
  await world.host('left', ['--gcm', gcm.addr]);
  await page.locator('[data-process=left][data-standing=attached]').waitFor();
  if ((await state(gcm.addr, 'left/sine')) !== 'ACTIVE') await start(gcm.addr, 'left/sine');
  await go_on(page, 'both go on');
  await eventually('nothing is complained of any more', async () => (await why.count()) === 0);
}

export async function the_log_shows_what_hosts_say(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const page = await world.viewer(host.addr);
  await page.getByRole('button', { name: 'Log' }).click();
  const lines = page.locator('[data-list=log] .list > div');
  await eventually('lines are shown', async () => (await lines.count()) > 0);
  // And what happens while somebody looks.
  await create(host.addr, 'fixture-chaos/chaos', 'host/chaos', { panic_in: 'step' }, { model: 'periodic', rate_hz: 10 });
  await start(host.addr, 'host/chaos');
  await lines.filter({ has: page.locator('b', { hasText: 'host/chaos' }) }).filter({ hasText: 'chaos in step' }).first().waitFor();
  await shot(page, 'log');
}
