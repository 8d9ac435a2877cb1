/// The graph in the browser: what there is, live, and what is drawn into it.
import { cut, moved, onScreen, twoThenThreeHundred, watched } from './drawing.mjs';
import { box, connect, create, eventually, grpcurl, handle, holds, is, menu, reveal, settled, shot, start, state, twoProcesses } from './world.mjs';

export async function two_processes_are_drawn_with_ports_states_and_health(world) {
  const { gcm } = await twoProcesses(world);
  const page = await world.viewer(gcm.addr);
  await box(page, 'left/sine').waitFor();
  await settled(page);
  is(await page.locator('[data-process]').evaluateAll((all) => all.map((e) => e.dataset.process).sort()), ['left', 'right'], 'processes');
  is(await box(page, 'left/sine').locator('[data-state]').innerText(), 'ACTIVE', 'state');
  // A machine with other work may let a step be late.
  await eventually('health is shown', async () => ['OK', 'OVERRUN'].includes(await box(page, 'left/sine').locator('[data-health]').getAttribute('data-health')));
  holds(/step|overrun|nothing to report/.test(await box(page, 'left/sine').locator('[data-health]').getAttribute('title')), 'with its reason');
  for (const port of ['left/sine/value', 'left/sine/signal', 'right/echo/sample', 'right/echo/peer']) await page.locator(`[data-port="${port}"]`).waitFor();
  const colour = (port) => page.locator(`[data-path="${port.slice(0, port.lastIndexOf('/'))}"] [data-handleid="${port.slice(port.lastIndexOf('/') + 1)}"]`).evaluate((e) => e.style.getPropertyValue('--port'));
  is(await colour('left/sine/value'), await colour('right/echo/sample'), 'ports of one type have one colour');
  holds((await colour('right/echo/frame')) !== (await colour('right/echo/sample')), 'ports of two types have two colours');
  const edge = page.locator('[data-connection="left/sine/value → right/echo/sample"]');
  await eventually('figures stand on the edge', async () => /\d+\/s/.test(await edge.innerText()) && /p99/.test(await edge.innerText()));
  await shot(page, 'graph');
}

export async function a_component_in_fault_says_why_wherever_it_is_shown_until_it_is_reset(world) {
  const host = await world.host();
  await create(host.addr, 'fixture-chaos/chaos', 'host/chaos', { panic_in: 'step', good_steps: 3 }, { model: 'periodic', rate_hz: 10 });
  const page = await world.viewer(host.addr);
  await settled(page);
  const card = box(page, 'host/chaos');
  const tally = page.locator('.tally');
  is([await card.locator('.why').count(), /FAULT/.test(await tally.innerText()), /FAULT/.test(await page.title())], [0, false, false], 'said of a FAULT before there is one');
  await start(host.addr, 'host/chaos');
  await card.locator('[data-state]', { hasText: /^FAULT$/ }).waitFor();
  const { fault } = (await grpcurl(host.addr, 'GcmService/GetState', { path: 'host/chaos' })).component;
  holds(fault.includes('chaos in step'), `why: ${fault}`);
  is([await card.locator('.why').innerText(), await card.locator('.why').getAttribute('title')], [fault, fault], 'why, on the card');
  const dot = card.locator('[data-health]');
  holds((await dot.getAttribute('title')).includes(fault), `why, at the dot: ${await dot.getAttribute('title')}`);
  holds((await dot.getAttribute('class')).includes('bad'), 'the dot is red');
  holds((await card.getAttribute('aria-label')).includes('FAULT'), 'who hears the page is told');
  await tally.filter({ hasText: '1 in FAULT' }).waitFor();
  holds((await page.title()).startsWith('(1 FAULT)'), `the window's title: ${await page.title()}`);
  await card.locator('header').click();
  await page.locator('.inspector dt:text-is("why") + dd').filter({ hasText: fault }).waitFor();
  await shot(page, 'fault');
  // Its state does not allow Start, and says what it allows.
  await menu(page, 'host/chaos', 'Start');
  await page.locator('[data-note].bad', { hasText: /FAULT.*Reset/ }).waitFor();
  await menu(page, 'host/chaos', 'Reset');
  await card.locator('[data-state]', { hasText: /^READY$/ }).waitFor();
  is(await state(host.addr, 'host/chaos'), 'READY', 'state');
  await card.locator('.why').waitFor({ state: 'detached' });
  await eventually('nobody speaks of a FAULT any more', async () => !/chaos in step/.test(await dot.getAttribute('title')) && !/FAULT/.test(await tally.innerText()) && !/FAULT/.test(await page.title()));
  await shot(page, 'fault-reset');
}

export async function a_step_that_takes_too_long_is_seen_at_the_component_with_its_reason(world) {
  const host = await world.host();
  await create(host.addr, 'fixture-chaos/chaos', 'host/late', { slow_step_ms: 120 }, { model: 'periodic', rate_hz: 10 });
  await start(host.addr, 'host/late');
  const page = await world.viewer(host.addr);
  await settled(page);
  const dot = box(page, 'host/late').locator('[data-health=OVERRUN]');
  await dot.waitFor();
  holds((await dot.getAttribute('title')).includes('its step takes longer than its period'), `why: ${await dot.getAttribute('title')}`);
  await box(page, 'host/late').locator('footer', { hasText: /[1-9]\d* overruns/ }).waitFor();
  await shot(page, 'overrun');
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/late' });
  await box(page, 'host/late').locator('[data-health=OK]').waitFor();
}

export async function connections_made_by_grpcurl_are_on_the_screen_each_time(world) {
  const { host, page, connected } = await watched(world);
  for (let round = 0; round < 20; round += 1) {
    await connected();
    is(await page.locator('[data-connection]').count(), 1, 'connections on the screen');
    await cut(host, page);
  }
}

export async function a_refusal_is_shown_before_the_drop_and_what_fits_is_connected_and_cut(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'echo', 'host/echo');
  const page = await world.viewer(host.addr);
  await box(page, 'host/echo').waitFor();
  await settled(page);
  const drag = async (from, to) => {
    const [a, b] = [await handle(page, from), await handle(page, to)];
    await page.mouse.move(a.x, a.y);
    await page.mouse.down();
    await page.mouse.move((a.x + b.x) / 2, (a.y + b.y) / 2, { steps: 4 });
    await page.mouse.move(b.x, b.y, { steps: 4 });
  };
  await drag('host/sine/value', 'host/echo/frame');
  const verdict = page.locator('[data-verdict]');
  // On the way there the pointer comes past other ports, which are refused, too.
  await eventually('the refusal is shown', async () => {
    if ((await verdict.count()) > 0) return true;
    // The card moved under the pointer, as what its component offers came in.
    await page.mouse.up();
    await drag('host/sine/value', 'host/echo/frame');
    return (await verdict.count()) > 0;
  });
  await eventually('it is that of the port', async () => (await verdict.getAttribute('class'))?.includes('bad') && (await verdict.innerText()).includes('host/echo/frame'));
  const said = await verdict.innerText();
  holds(/frame|type|Scalar/i.test(said), `the server's reason: ${said}`);
  holds(await page.locator('[data-port="host/echo/frame"]').evaluate((e) => e.classList.contains('grey')), 'what cannot fit is greyed');
  await shot(page, 'refused-before-the-drop');
  await page.mouse.up();
  is((await grpcurl(host.addr, 'GcmService/List', {})).connections ?? [], [], 'nothing was connected');

  await drag('host/sine/value', 'host/echo/sample');
  await page.locator('[data-verdict]:not(.bad)', { hasText: 'can be connected' }).waitFor();
  await shot(page, 'fits-before-the-drop');
  await page.mouse.up();
  const edge = page.locator('[data-connection="host/sine/value → host/echo/sample"]');
  await edge.waitFor({ state: 'attached' });
  is((await grpcurl(host.addr, 'GcmService/List', {})).connections.length, 1, 'connections');

  // Cut by selecting the wire and the Delete key.
  await page.locator('.svelte-flow__edge').first().focus();
  await page.keyboard.press('Enter');
  await shot(page, 'cutting');
  await page.keyboard.press('Delete');
  await edge.waitFor({ state: 'detached' });
  await eventually('it is cut', async () => !(await grpcurl(host.addr, 'GcmService/List', {})).connections);
}

export async function a_connection_is_made_by_keys_alone_and_what_does_not_fit_says_why(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'sine', 'host/other');
  await create(host.addr, 'echo', 'host/echo');
  const page = await world.viewer(host.addr);
  await box(page, 'host/echo').waitFor();
  await settled(page);
  const focused = () => page.evaluate(() => document.activeElement.dataset.to ?? document.activeElement.innerText);
  const until = async (key, there) => eventually(`${key} leads there`, async () => there(await focused()) || (await page.keyboard.press(key), false));
  const open = async () => {
    await page.locator('.svelte-flow__node-component[data-id="host/echo"]').focus();
    await page.keyboard.press('Shift+F10');
    await page.getByRole('menuitem', { name: /^Start/ }).waitFor();
    await until('ArrowDown', (text) => text.startsWith('Connect to…'));
    await page.keyboard.press('Enter');
    await page.locator('[data-connect="host/echo"]').waitFor();
  };
  const to = (path) => page.locator(`[data-to="${path}"]`);
  await open();
  // The choice of the port has the keyboard.
  const port = page.getByLabel('Port');
  for (const wanted of ['sample', 'frame']) {
    await eventually(`${wanted} is chosen`, async () => (await port.inputValue()) === wanted || (await page.keyboard.press('ArrowDown'), false));
  }
  // It takes frames: numbers are refused, and say why.
  await to('host/sine/value').filter({ hasText: 'it takes' }).waitFor();
  is(await to('host/sine/value').getAttribute('aria-disabled'), 'true', 'what does not fit');
  await shot(page, 'connect-refused');
  await eventually('sample is chosen again', async () => (await port.inputValue()) === 'sample' || (await page.keyboard.press('ArrowUp'), false));
  await to('host/sine/value').filter({ hasNotText: 'checking' }).waitFor();
  is(await to('host/sine/value').getAttribute('aria-disabled'), 'false', 'what fits');
  await shot(page, 'connect');
  await until('Tab', (path) => path === 'host/sine/value');
  await page.keyboard.press('Enter');
  await page.locator('[data-connect]').waitFor({ state: 'detached' });
  await page.locator('[data-connection="host/sine/value → host/echo/sample"]').waitFor({ state: 'attached' });
  is((await grpcurl(host.addr, 'GcmService/List', {})).connections.map((c) => [c.client, c.server]), [['host/echo/sample', 'host/sine/value']], 'connections');
  // It is taken now: the server says so, and Enter does nothing.
  await open();
  await to('host/other/value').filter({ hasText: /already|host\/sine\/value/ }).waitFor();
  await until('Tab', (path) => path === 'host/other/value');
  await page.keyboard.press('Enter');
  await shot(page, 'connect-taken');
  await page.getByLabel('Find').fill('nobody');
  await page.getByText('under that name').waitFor();
  // The first takes away what was typed.
  await page.keyboard.press('Escape');
  await page.keyboard.press('Escape');
  await page.locator('[data-connect]').waitFor({ state: 'detached' });
  is((await grpcurl(host.addr, 'GcmService/List', {})).connections.length, 1, 'connections');
  // What is free stands before what is taken, and that before what cannot fit.
  await create(host.addr, 'echo', 'host/free');
  await menu(page, 'host/other', 'Connect to');
  const order = () => page.locator('[data-connect] [data-to]').evaluateAll((all) => all.map((e) => e.dataset.to));
  await to('host/free/frame').waitFor();
  is((await order()).filter((path) => /sample|frame$/.test(path)), ['host/free/sample', 'host/echo/sample', 'host/echo/frame', 'host/free/frame'], 'in order');
}

export async function a_wire_shows_what_is_dropped_and_that_nothing_flows_any_more(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'echo', 'host/slow', undefined, { model: 'periodic', rate_hz: 10 });
  await connect(host.addr, 'host/slow/sample', 'host/sine/value');
  await start(host.addr, 'host/slow', 'host/sine');
  const page = await world.viewer(host.addr);
  await settled(page);
  const edge = page.locator('[data-connection="host/sine/value → host/slow/sample"]');
  await edge.filter({ hasText: /[1-9].* dropped/ }).waitFor();
  await page.locator('.dropping[data-connection]').waitFor();
  await edge.filter({ hasText: /[1-9].*\/s/ }).waitFor();
  await shot(page, 'dropping');
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/sine' });
  await page.locator('.stalled[data-connection]', { hasText: 'stalled' }).waitFor();
  await shot(page, 'stalled');
  await grpcurl(host.addr, 'GcmService/Resume', { path: 'host/sine' });
  await page.locator('[data-connection]:not(.stalled)', { hasText: '/s' }).waitFor();
}

export async function a_source_that_gives_when_it_has_something_is_at_rest_and_one_with_a_period_is_stalled(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  for (const name of ['echo', 'last']) await create(host.addr, 'echo', `host/${name}`);
  await connect(host.addr, 'host/echo/sample', 'host/sine/value');
  await connect(host.addr, 'host/last/sample', 'host/echo/sample_out');
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  const line = (from, to) => page.locator(`[data-connection="host/${from} → host/${to}/sample"]`);
  for (const one of [line('sine/value', 'echo'), line('echo/sample_out', 'last')]) await one.filter({ hasText: /[1-9].*\/s/ }).waitFor();
  await grpcurl(host.addr, 'GcmService/Stop', { path: 'host/sine' });
  await line('sine/value', 'echo').and(page.locator('.stalled')).filter({ hasText: 'stalled' }).waitFor();
  // It steps when a sample comes: that none comes is no fault of this line.
  await line('echo/sample_out', 'last').and(page.locator('.resting:not(.stalled)')).filter({ hasText: 'at rest' }).waitFor();
  await line('echo/sample_out', 'last').click();
  await page.locator('.inspector dt:text-is("rate") + dd:not(.bad)', { hasText: '0/s, at rest' }).waitFor();
  await shot(page, 'at-rest');
  await grpcurl(host.addr, 'GcmService/Resume', { path: 'host/sine' });
  for (const one of [line('sine/value', 'echo'), line('echo/sample_out', 'last')]) await one.and(page.locator(':not(.stalled):not(.resting)')).filter({ hasText: /[1-9].*\/s/ }).waitFor();
}

export async function a_line_tells_the_carrier_depth_and_latency_that_list_has_and_a_dash_where_none_is_measured(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  for (const name of ['echo', 'asked']) await create(host.addr, 'echo', `host/${name}`);
  await connect(host.addr, 'host/echo/sample', 'host/sine/value');
  await connect(host.addr, 'host/echo/peer', 'host/asked/ctl');
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  const row = (name) => page.locator(`.inspector dt:text-is("${name}") + dd`);
  for (const [client, latency] of [['host/echo/sample', /^p50 \S+ .s, p99 /], ['host/echo/peer', /^–$/]]) {
    const listed = async () => (await grpcurl(host.addr, 'GcmService/List', {})).connections.find((c) => c.client === client);
    const { carrier, depth } = await eventually('List has a carrier', async () => { const c = await listed(); return c.carrier && c; }, listed);
    await page.locator(`.svelte-flow__edge[aria-label$="to ${client}"]`).focus();
    await page.keyboard.press('Enter');
    await row('client').filter({ hasText: client }).waitFor();
    for (const [name, value] of [['carrier', carrier], ['depth', depth]]) await row(name).filter({ hasText: new RegExp(`^${value}$`) }).waitFor();
    await row('latency').filter({ hasText: latency }).waitFor();
  }
  await shot(page, 'line-details');
}

export async function a_killed_process_is_shown_lost_and_healed_without_a_reload(world) {
  const { gcm, right } = await twoProcesses(world);
  const page = await world.viewer(gcm.addr);
  await page.evaluate(() => (window.same = true));
  await page.locator('[data-process=right][data-standing=attached]').waitFor();
  await settled(page);
  const edge = page.locator('[data-connection="left/sine/value → right/echo/sample"]');
  await edge.filter({ hasText: /[1-9].*\/s/ }).waitFor();
  right.kill('SIGKILL');
  await page.locator('[data-process=right][data-standing=lost]').waitFor();
  await box(page, 'right/echo').locator('[data-health=LOST]').waitFor();
  await page.locator('.stalled[data-connection]').waitFor();
  await shot(page, 'process-lost');
  await world.host('right', ['--gcm', gcm.addr]);
  await page.locator('[data-process=right][data-standing=attached]').waitFor();
  await eventually('its component is whole again', async () => (await box(page, 'right/echo').locator('[data-health]').getAttribute('data-health')) !== 'LOST');
  // No actuator: it goes on as it was.
  await box(page, 'right/echo').locator('[data-state]', { hasText: /^ACTIVE$/ }).waitFor();
  is(await state(gcm.addr, 'right/echo'), 'ACTIVE', 'state');
  // What was seen before it was lost counts no more after so many answers: the line would be stalled.
  for (let n = 0; n < 4; n += 1) await page.waitForResponse((r) => r.url().endsWith('GcmService/List'));
  await page.locator('[data-connection]:not(.stalled)').filter({ hasText: /[1-9].*\/s/ }).waitFor();
  holds(await page.evaluate(() => window.same === true), 'the page was not loaded again');
  await shot(page, 'process-healed');
}

export async function the_page_says_that_the_gcm_is_gone_and_goes_on_when_it_is_back(world) {
  const gcm = await world.gcm();
  await world.host('left', ['--gcm', gcm.addr]);
  await create(gcm.addr, 'sine', 'left/sine');
  await start(gcm.addr, 'left/sine');
  const page = await world.viewer(gcm.addr);
  await box(page, 'left/sine').waitFor();
  gcm.kill('SIGKILL');
  await gcm.ended;
  await page.locator('[data-banner]', { hasText: 'does not answer' }).waitFor();
  await shot(page, 'gcm-gone');
  await world.gcm(gcm.addr);
  await page.locator('[data-banner]').waitFor({ state: 'detached' });
  await eventually('its component is there again', async () => (await box(page, 'left/sine').locator('[data-state]').innerText()) === 'ACTIVE');
  await create(gcm.addr, 'sine', 'left/second');
  await box(page, 'left/second').waitFor();
}

export async function three_hundred_components_are_drawn_and_can_be_worked_with(world) {
  const { host, page } = await twoThenThreeHundred(world, async () => {});
  await shot(page, 'three-hundred');
  await onScreen(page);
  is(await page.locator('[data-path]').count(), 300, 'components on the screen');
  const view = () => page.locator('.svelte-flow__viewport').evaluate((e) => e.style.transform);
  const before = await view();
  await moved(page);
  await eventually('all of it is moved', async () => (await view()) !== before);
  await reveal(page, 'host/e77');
  await box(page, 'host/e77').waitFor();
  await page.locator('.inspector', { hasText: 'host/e77' }).waitFor();
  await eventually('it is in the middle and can be read', async () => {
    const b = await box(page, 'host/e77').boundingBox();
    return b && b.width > 140 && b.x > 200 && b.x + b.width < 1130 && b.y > 100 && b.y + b.height < 850;
  });
  await shot(page, 'three-hundred-found');
  is(await state(host.addr, 'host/e77'), 'READY', 'state');
}

export async function taps_are_out_of_the_way_until_somebody_wants_them(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  await create(host.addr, 'recorder/recorder', 'host/log');
  const page = await world.viewer(host.addr);
  await page.locator('[data-port="host/sine/value"]').waitFor();
  await settled(page);
  const taps = () => page.locator('[data-path="host/sine"] [data-port*="/tap_"]').evaluateAll((all) => all.map((e) => e.dataset.port.slice('host/sine/'.length)));
  is(await taps(), [], 'taps that nobody asked for');
  const low = async () => (await box(page, 'host/sine').boundingBox()).height;
  const before = await low();
  await connect(host.addr, 'host/log/in_1', 'host/sine/tap_rows');
  await eventually('the tap that is connected is drawn', async () => (await taps()).join() === 'tap_rows');
  await page.locator('[data-connection="host/sine/tap_rows → host/log/in_1"]').waitFor({ state: 'attached' });
  await page.keyboard.press('t');
  await eventually('all are drawn', async () => (await taps()).join() === 'tap_rows,tap_events');
  await settled(page);
  holds((await low()) > before, 'with room for them');
  await shot(page, 'taps');
  await page.getByRole('button', { name: 'Taps' }).click();
  await eventually('only what is connected is drawn', async () => (await taps()).join() === 'tap_rows');
  await grpcurl(host.addr, 'GcmService/Disconnect', { client: 'host/log/in_1', server: 'host/sine/tap_rows' });
  await eventually('nothing is', async () => (await taps()).length === 0);
}

export async function outputs_come_first_and_the_interface_system_last_on_the_card_and_in_its_details(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  const page = await world.viewer(host.addr);
  await page.locator('[data-port="host/sine/system"]').waitFor();
  await settled(page);
  await page.keyboard.press('t');
  await page.locator('[data-port="host/sine/tap_rows"]').waitFor();
  const drawn = await page.locator('[data-path="host/sine"] .port.right').evaluateAll((all) => all.map((e) => e.dataset.port.split('/')[2]));
  is(drawn, ['value', 'tap_rows', 'tap_events', 'signal', 'system'], 'ports on the card');
  await box(page, 'host/sine').locator('header').click();
  await page.getByRole('tab', { name: 'Interfaces' }).click();
  await page.locator('[data-interface=system]').waitFor();
  const told = await page.locator('.inspector section h2').evaluateAll((all) => all.map((e) => e.innerText.split(/\s/)[0]));
  is(told.filter((name) => name !== 'State'), drawn, 'ports in the details');
}

export async function what_is_skipped_is_grey_and_what_is_dropped_is_amber(world) {
  const host = await world.host();
  await create(host.addr, 'sine', 'host/sine');
  for (const name of ['newest', 'slow']) await create(host.addr, 'echo', `host/${name}`, undefined, { model: 'periodic', rate_hz: 10 });
  await connect(host.addr, 'host/slow/sample', 'host/sine/value');
  await grpcurl(host.addr, 'GcmService/Connect', { client: 'host/newest/sample', server: 'host/sine/value', options: { queue: { fifo: 0 } } });
  await start(host.addr, 'host/**');
  const page = await world.viewer(host.addr);
  await settled(page);
  const edge = (to) => page.locator(`[data-connection="host/sine/value → host/${to}/sample"]`);
  const colour = (of) => of.evaluate((e) => getComputedStyle(e).color);
  const named = (name) => page.evaluate((name) => { const e = document.createElement('i'); e.style.color = `var(${name})`; document.body.append(e); const { color } = getComputedStyle(e); e.remove(); return color; }, name);
  const [grey, amber] = [await named('--faint'), await named('--warn')];
  await edge('slow').locator('em').waitFor();
  is(await colour(edge('slow').locator('em')), amber, 'dropped, at the line');
  is(await edge('newest').locator('em').count(), 0, 'losses at a line that takes only the newest');
  for (const [to, row, wanted] of [['slow', 'dropped', amber], ['newest', 'skipped', grey]]) {
    await edge(to).click();
    const figure = page.locator(`.inspector dt:text-is("${row}") + dd`, { hasText: /^[1-9]/ });
    await figure.waitFor();
    is(await colour(figure), wanted, `${row}, in the details`);
  }
  await shot(page, 'skipped');
}
