/// What streams: plots, pictures, events, the log, and how many windows may look at once.
import { eventRows, followAll, go_on, interfacesOf, latest, manyMakers, numbered, plot, points } from './following.mjs';
import { box, create, eventually, grpcurl, holds, is, reaches, reveal, settled, shot, start, state } from './world.mjs';

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
      await reveal(page, `host/s${n}`);
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
  await reaches('all six have points', () => points(first), 41);
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
  is(await page.locator('[data-curve] .value').allInnerTexts(), ['31.000 mm', '31.000 mm', '31.000 mm'], 'what people read');
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
  const shown = page.locator('[data-curve] .value');
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
  await reaches('points come', async () => (await points(page))[0], 101);
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
  // The rate at each of them, and how late it comes where there is room for that, too.
  const saying = async (what) => (await wires.allInnerTexts()).filter((t) => what.test(t)).length;
  await eventually('streams say what flows', async () => (await saying(/\d\/s/)) > 12 && (await saying(/\d\/s[^]*p99/)) > 5, async () => [await saying(/\d\/s/), await saying(/p99/)]);
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
  await reveal(page, 'host/pip');
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
  const stale = page.locator('[data-stale]');
  is(await stale.count(), 0, 'marks of a live picture');
  await grpcurl(demo.addr, 'GcmService/Stop', { path: 'host/camera' });
  await eventually('a picture that stands still is marked', async () => (await stale.count()) === 1 && /no picture for [1-9]/.test(await stale.innerText()));
  await grpcurl(demo.addr, 'GcmService/Resume', { path: 'host/camera' });
  await eventually('the next one is not', async () => (await stale.count()) === 0);
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
  for (const path of makers) await create(host.addr, 'fixture-torture/server', path, undefined, { rate_hz: 20 });
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  // The list keeps the newest 200 only, so the page itself notes the first and the last number of each event
  // whenever the list changes.
  await page.evaluate(() => {
    window.heard = {};
    const read = () => {
      for (const row of document.querySelectorAll('[data-list=events] .list > div')) {
        const [path, text] = [row.querySelector('b')?.textContent, row.querySelector('span')?.textContent.replace(/ \(\d+ skipped before\)$/, '')];
        if (!path || !text?.startsWith('{')) continue;
        const { number } = JSON.parse(text);
        const had = (window.heard[path] ??= { first: number, last: number });
        had.last = Math.max(had.last, number);
      }
    };
    new MutationObserver(read).observe(document.body, { subtree: true, childList: true, characterData: true });
    window.read = () => (read(), { heard: window.heard, total: Number(document.querySelector('[data-list=events]').dataset.total) });
  });
  const heard = async (path) => (await page.evaluate(() => window.heard))[path] ?? { first: 0, last: -1 };
  const more = async (path, what) => {
    for (const [of, shown] of Object.entries(numbered(await eventRows(page)))) {
      holds(shown.every((n, i) => i === 0 || n > shown[i - 1]), `each once, in order, ${of}: ${shown}`);
    }
    const { last } = await heard(path);
    await reaches(what, async () => (await heard(path)).last, last + 10);
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
  await reaches('a curve beside the list', async () => (await points(page))[0], 21);
  // An item that came twice or too late would begin it anew.
  const drawn = (await points(page))[0];
  await page.getByRole('button', { name: 'Events' }).click();
  await more(events[2], 'the third goes on beside its curve');
  await interfacesOf(page, makers[1]);
  await plot(page, events[1], 'number');
  await reaches('a second curve', async () => (await points(page))[1], 21);
  holds((await points(page))[0] > drawn, `the first goes on: ${drawn} points, then ${(await points(page))[0]}`);
  await page.getByRole('button', { name: 'Events' }).click();
  await more(events[2], 'the third goes on');
  // As many came as lie between the first and the last of each: none is missing, and none came twice.
  const { heard: all, total } = await page.evaluate(() => window.read());
  const sent = events.map((path) => all[path].last - all[path].first + 1).reduce((a, b) => a + b);
  is(total, sent, `events listed, of ${JSON.stringify(all)}`);
  is(await page.locator('[data-list=events]').getAttribute('data-skipped'), '0', 'skipped');
}

export async function more_events_than_can_be_read_are_listed_in_order_and_the_page_answers(world) {
  const { host, page, makers } = await manyMakers(world);
  await followAll(page, makers);
  const list = page.locator('[data-list=events]');
  const total = async () => Number(await list.getAttribute('data-total'));
  const seen = async () => (await total()) + Number(await list.getAttribute('data-skipped'));
  await reaches('events come', seen, 20_001);
  const [shown, older] = [await total(), numbered(await eventRows(page))];
  await reaches('forty thousand more', seen, (await seen()) + 40_001);
  const rows = await list.locator('.list > div').count();
  holds(rows > 0 && rows <= 200, `events are listed, and the list stays short: ${rows} rows`);
  holds(shown > 0 && (await total()) > shown, `some were really sent, not only counted: ${shown}, then ${await total()}`);
  const newer = numbered(await eventRows(page));
  holds(Object.keys(older).some((path) => newer[path]?.at(-1) > older[path].at(-1)), `the newest are listed: ${JSON.stringify(older)}, then ${JSON.stringify(newer)}`);
  for (const [path, numbers] of Object.entries(newer)) holds(makers.includes(path.split('/').slice(0, 2).join('/')) && numbers.every((n, i) => n > (numbers[i - 1] ?? 0)), `in order, ${path}: ${numbers}`);
  // The page answers while they come: it goes back to the first of them, and stops it.
  await reveal(page, 'host/e0');
  await box(page, 'host/e0').locator('header').click({ button: 'right' });
  await page.getByRole('menuitem', { name: /^Stop/ }).click();
  await eventually('it stops', async () => (await state(host.addr, 'host/e0')) === 'STOPPED');
  await shot(page, 'events');
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
  await reaches('points come', async () => (await points(page))[0], 21);
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
  await reaches('points come', () => points(page), 21);
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
